"""What a constitutive law is to the rest of the package: the contract that each file in `hoi/mpm/laws` fulfils.

A law gives the Kirchhoff stress tau = J sigma [Pa] of the elastic deformation gradient F, and if it flows, a return map
from the trial F that a step leads to, to the one that the material can bear. It stands twice in its file, in NumPy
float64 to be read and tested, and as functions for the kernels, which a test compares. In the formulas there mu, lambda
are the Lame parameters, J = det F, F = R S = V R the polar decomposition, b = F F^T, eps = log V = log(b)/2 the Hencky
strain and e its deviator. All solids agree with linear elasticity for small strain.

What is left behind by the flow is one number a particle, `hardening`, 0 at first; what it means depends on the law.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from hoi.data import Array, Material


class Lame(NamedTuple):
    """The numbers of a law that takes no more than elasticity."""

    mu: float
    """[Pa]."""
    lam: float
    """[Pa]."""


class Elastic(Protocol):
    """The numbers of any law: these two come first."""

    @property
    def mu(self) -> float:
        """[Pa], 0 for a fluid."""
        ...

    @property
    def lam(self) -> float:
        """[Pa], the bulk modulus for a fluid."""
        ...


MU, LAM = 0, 1
"""Their places in a kernel's `p`."""
PARAMETERS = 8
"""Numbers of a law at most."""


def lame(material: Material) -> Lame:
    """mu and lambda [Pa] of a solid, from Young's modulus and Poisson's ratio."""
    e, nu = material.youngs_modulus, material.poisson_ratio
    return Lame(e / (2 * (1 + nu)), e * nu / ((1 + nu) * (1 - 2 * nu)))


class Kernels(NamedTuple):
    """A law for the kernels: functions of the kernel compiler (`hoi.compute.ti.func`).

    F is 3x3 and elastic, j its determinant, > 0; c the velocity gradient [1/s], 3x3; p a vector of `PARAMETERS`
    numbers, those of the law and then zeros.
    """

    stress: Callable[..., Any]
    """(F, j, c, p, hardening, tolerance) -> tau [Pa], 3x3; tolerance: machine epsilon."""
    stiffness: Callable[..., Any]
    """(F, j, p, hardening) -> an upper bound B_c [Pa] of rho_0 c^2 for every wave in the deformed state.

    c is in present lengths: rho_0 c^2 is the greatest eigenvalue of Q with a . Q a = d^2/ds^2 psi((I + s a n^T) F)
    at s = 0, over unit normals n. With t = a . n and the eigenvalues of b at most B, each law says how it comes to its
    bound, which at rest is lambda + 2 mu for nu >= 0.
    """
    return_map: Callable[..., Any] | None = None
    """(trial F, hardening, p, dt) -> (F, hardening) after a step of dt [s]; of a law that flows."""
    stress_columns: Callable[..., Any] | None = None
    """`stress` once more, for speed: (f0, f1, f2, j, p) -> the columns of tau from those of F, vectors of 4."""


@dataclass(frozen=True)
class Law:
    """A constitutive law. In NumPy p are its numbers, F is (..., 3, 3), hardening (...)."""

    energy_density: Callable[[Any, Array, Array], Array]
    """(p, F, hardening) -> psi [J/m^3], shape (...)."""
    kirchhoff_stress: Callable[[Any, Array, Array, Array], Array]
    """(p, F, velocity gradient [1/s] (..., 3, 3), hardening) -> tau [Pa], shape (..., 3, 3)."""
    kernels: Callable[[], Kernels]
    """Makes the functions for the kernels; nothing before it imports the kernel compiler."""
    return_map: Callable[[Any, Array, Array, float], tuple[Array, Array]] | None = None
    """(p, trial F, hardening, dt) -> (F, hardening); None: the law does not flow."""
    parameters: Callable[[Material], tuple[float, ...]] = lame
    """The numbers that the law works with, a tuple with names of which the first two are those of `Elastic`."""
    clamped: Callable[[Any, Array, Array], NDArray[Any]] | None = None
    """(p, F, hardening) -> whether a particle is at a bound of the method's, not the material's, shape (...)."""
    uses: frozenset[str] = frozenset()
    """Fields of Material that it takes beside elasticity, density, restitution and ground friction."""
    keeps_total: bool = False
    """Whether the body has a shape that it flows away from, so that its total F is tracked beside the elastic one."""
    rigid: bool = True
    """Whether the body may move as one piece where nothing touches it."""
    shears: bool = True
    """Whether it bears shear at rest; if not its mu is 0, and its waves need lambda > 0."""
    seeps: bool = False
    """Whether nothing holds its parts together, so that it would sink into the half cell above a plane's nodes."""
    viscous: bool = False
    """Whether `viscosity` acts explicitly, in the stress, so that it limits the time step."""
    springs: bool = False
    """Whether it rebounds as `restitution` says (`hoi.mpm.damping`); else its flow alone takes energy."""
    order: int = 100
    """Where it stands in lists; laws of one order by name."""

    @property
    def flows(self) -> bool:
        """Whether it has a return map."""
        return self.return_map is not None
