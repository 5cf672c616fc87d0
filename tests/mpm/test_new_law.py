"""A law that is dropped into the package works: in the configuration, the plan, the solver, against its reference."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SIMULATED = """
import mpm_reference as reference
import numpy as np
from mpm_bodies import DX, RUBBER, shaken
from dataclasses import replace
from hoi.mpm.solver import ground_plane, simulate
material = replace(RUBBER, model="saint_venant")
start, volumes = shaken(material)
expected = start
for _ in range(10):
    expected = reference.step(
        expected, volumes, material, dx=DX, dt=2e-4, gravity=(0, 0, -9.81), planes=[ground_plane(0.4)]
    )
final = simulate(start, volumes, material, dx=DX, dt=2e-4, times=[2e-3], precision="float64").final
for name in ("positions", "velocities", "deformation_gradient"):
    np.testing.assert_allclose(getattr(final, name), getattr(expected, name), rtol=0, atol=1e-11)
assert abs(final.deformation_gradient - start.deformation_gradient).max() > 1e-3
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A checkout with one more file: the law of docs/examples."""
    shutil.copytree(
        ROOT / "hoi", tmp_path / "hoi", copy_function=os.symlink, ignore=shutil.ignore_patterns("__pycache__")
    )
    (tmp_path / "conf").symlink_to(ROOT / "conf")
    shutil.copy(ROOT / "docs" / "examples" / "saint_venant.py", tmp_path / "hoi" / "mpm" / "laws")
    return tmp_path


def python(package: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(map(str, (package, ROOT / "tests", ROOT / "tests" / "mpm")))
    return subprocess.run(
        [sys.executable, *arguments], cwd=package, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True
    )


def test_a_new_law_is_one_file(package: Path) -> None:
    plan = python(package, "-m", "hoi.run", "plan_only=true", "material=rubber", "material.model=saint_venant")
    assert plan.returncode == 0, plan.stderr
    assert "cfl" in plan.stdout
    other = python(package, "-m", "hoi.run", "plan_only=true", "material.model=jelly")
    assert other.returncode == 2
    assert (
        "[fixed_corotated, neo_hookean, von_mises, viscoplastic, drucker_prager, snow, fluid, saint_venant]"
        in other.stderr
    )
    simulated = python(package, "-c", SIMULATED)
    assert simulated.returncode == 0, simulated.stderr


def test_knowing_the_laws_imports_nothing_heavy() -> None:
    heavy = ["taichi", "quadrants", "torch", "scipy"]
    code = f"import sys, hoi.mpm.laws, hoi.mpm.stability; print([m for m in {heavy} if m in sys.modules])"
    assert python(ROOT, "-c", code).stdout == "[]\n"
