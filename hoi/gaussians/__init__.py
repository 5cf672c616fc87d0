"""3D Gaussian clouds: their algebra (`cloud`), and the files they come in and go to, a module a format."""

from hoi.gaussians.cloud import (
    MOST_STRETCH,
    SH_C0,
    areas,
    colours,
    covariances,
    deform,
    fibonacci_sphere,
    higher_harmonics,
    limited,
    rotate_sh,
    rotation_matrices,
    select,
    sh_basis,
    sh_degree,
    sh_from_colours,
    stretch,
    transform,
)
from hoi.gaussians.files import load_clean, read_file, read_gaussians
from hoi.gaussians.found import CloudFile
from hoi.gaussians.ply import write_ply
from hoi.gaussians.splat import write_splat
from hoi.gaussians.spz import write_spz

__all__ = [
    "MOST_STRETCH",
    "SH_C0",
    "CloudFile",
    "areas",
    "colours",
    "covariances",
    "deform",
    "fibonacci_sphere",
    "higher_harmonics",
    "limited",
    "load_clean",
    "read_file",
    "read_gaussians",
    "rotate_sh",
    "rotation_matrices",
    "select",
    "sh_basis",
    "sh_degree",
    "sh_from_colours",
    "stretch",
    "transform",
    "write_ply",
    "write_splat",
    "write_spz",
]
