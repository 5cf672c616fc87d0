"""Either compiler of the kernels: which one is taken, and that both move a body the same."""

import os
import subprocess
import sys
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from mpm_bodies import DX, block
from mpm_examples import EXAMPLES

from hoi import compute
from hoi.data import ObjectState
from hoi.errors import InputError
from hoi.mpm.state import initial_state

FIELDS = ("positions", "velocities", "deformation_gradient", "hardening")


def test_which_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HOI_COMPILER", raising=False)
    for version, expected in (((3, 11), "taichi"), ((3, 13), "taichi"), ((3, 14), "quadrants")):
        monkeypatch.setattr(sys, "version_info", version)
        assert compute.compiler() == expected
    monkeypatch.setenv("HOI_COMPILER", "quadrants")
    assert compute.compiler() == "quadrants"
    monkeypatch.setenv("HOI_COMPILER", "warp")
    with pytest.raises(InputError, match="HOI_COMPILER must be taichi or quadrants, got 'warp'"):
        compute.compiler()


def test_an_array_of_an_ended_program_frees_nothing_of_the_next() -> None:
    """Addresses come back: the end of an old array must not end the new one that lies there."""
    compute.start_compiler("float32", 1, "cpu")
    ti = compute.ti
    old = [ti.Vector.ndarray(4, ti.f32, 100) for _ in range(300)]
    compute.start_compiler("float64", 1, "cpu")
    new = [ti.Vector.ndarray(4, ti.f64, 100) for _ in range(300)]
    assert {array.arr for array in old} == {None}
    del old
    new += [ti.Vector.ndarray(4, ti.f64, 100) for _ in range(300)]
    for number, array in enumerate(new):
        array.fill(float(number))
    assert all((array.to_numpy() == number).all() for number, array in enumerate(new))


def thrown(model: str, precision: Any) -> ObjectState:
    """A small block of that law after 50 steps, thrown onto the ground."""
    from hoi.mpm.solver import simulate

    material = EXAMPLES[model]
    x, volumes = block((0.15, 0.15, 0.1), DX / 2)
    start = initial_state(x, volumes * material.density, [1, 0.3, -3], [3, 10, -5])
    return simulate(start, volumes, material, dx=DX, dt=2e-4, times=[50 * 2e-4], precision=precision).final


@pytest.mark.parametrize(
    ("model", "precision", "tolerance"), [("fixed_corotated", "float32", 1e-5), ("von_mises", "float64", 1e-11)]
)
def test_both_compilers_move_a_body_alike(model: str, precision: str, tolerance: float, tmp_path) -> None:
    """To round-off, not to the bit: each contracts and orders sums in its own way."""
    if missing := [name for name in ("taichi", "quadrants") if find_spec(name) is None]:
        pytest.skip(f"{missing[0]} is not installed")
    states = []
    for name in ("taichi", "quadrants"):
        path = tmp_path / f"{name}.npz"
        code = (
            "import sys; import numpy as np; sys.path[:0] = sys.argv[4:]\n"
            "from test_compiler import FIELDS, thrown; state = thrown(*sys.argv[1:3])\n"
            "arrays = {name: getattr(state, name) for name in FIELDS if getattr(state, name) is not None}\n"
            f"assert {name!r} in sys.modules; np.savez(sys.argv[3], **arrays)"
        )
        arguments = [sys.executable, "-c", code, model, precision, str(path), *sys.path]
        ended = subprocess.run(arguments, env=os.environ | {"HOI_COMPILER": name}, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        assert not ended.stdout, "no banner"
        states.append(np.load(path))
    assert set(states[0]) == set(states[1]) >= {"positions", "deformation_gradient"}
    for field in states[0]:
        np.testing.assert_allclose(*(state[field] for state in states), atol=tolerance * np.abs(states[0][field]).max())
