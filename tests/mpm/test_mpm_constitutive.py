"""The constitutive models in Taichi against those in NumPy, and their stiffness against numerical acoustic tensors."""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportOptionalOperand=false

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpm_examples import EXAMPLES, deformations, rotations, stretched

from hoi.compute import start_compiler, ti
from hoi.data import Material
from hoi.mpm import materials
from hoi.mpm.kernels import functions, stiffness
from hoi.mpm.law import PARAMETERS
from hoi.mpm.laws import LAWS

DT = 1e-3


@pytest.fixture(scope="module", params=["float64", "float32"])
def precision(request: pytest.FixtureRequest) -> str:
    """Of the module's scope, so that Taichi is started twice only."""
    return request.param


@ti.func
def load(array: ti.template(), p):
    m = ti.Matrix.zero(float, 3, 3)
    for i, j in ti.static(ti.ndrange(3, 3)):
        m[i, j] = array[p, 3 * i + j]
    return m


@ti.func
def store(array: ti.template(), p, m):
    for i, j in ti.static(ti.ndrange(3, 3)):
        array[p, 3 * i + j] = m[i, j]


@ti.kernel
def evaluate(
    model: ti.template(), f: ti.types.ndarray(), c: ti.types.ndarray(), numbers: ti.types.ndarray(),
    tau: ti.types.ndarray(), returned: ti.types.ndarray(), hardening: ti.types.ndarray(), m: ti.types.ndarray(),
    dt: float, tolerance: float,
):  # fmt: skip
    """Stress and stiffness of each F, with the hardening before the return map, and the return map of F as a trial."""
    ti.loop_config(serialize=True)
    for i in range(f.shape[0]):
        p = ti.Vector([numbers[k] for k in range(PARAMETERS)])
        deformation = load(f, i)
        j = deformation.determinant()
        if j > 0.0:
            store(tau, i, ti.static(functions(model)).stress(deformation, j, load(c, i), p, hardening[i], tolerance))
            m[i] = stiffness(model, deformation, j, p, hardening[i])
        if ti.static(LAWS[model].flows):
            elastic, hard = ti.static(functions(model)).return_map(deformation, hardening[i], p, dt)
            store(returned, i, elastic)
            hardening[i] = hard


class Evaluated:
    """What the kernel makes of F (N, 3, 3), C (N, 3, 3) and hardening (N,); inputs as rounded to the precision."""

    def __init__(self, material: Material, precision: Any, f: Any, c: Any = 0.0, hardening: Any = 0.0) -> None:
        start_compiler(precision, 1, "cpu")
        self.f = np.asarray(f, dtype=precision)
        self.c = np.broadcast_to(np.asarray(c, dtype=precision), self.f.shape)
        self.before = np.broadcast_to(np.asarray(hardening, dtype=precision), len(self.f))
        f_rows, c_rows = (np.ascontiguousarray(a.reshape(len(self.f), 9)) for a in (self.f, self.c))
        tau, returned = np.zeros_like(f_rows), f_rows.copy()
        self.hardening, self.stiffness = self.before.copy(), np.zeros(len(self.f), dtype=precision)
        numbers = np.zeros(PARAMETERS, dtype=precision)
        given = materials.parameters(material)
        numbers[: len(given)] = given
        epsilon = float(np.finfo(precision).eps)
        evaluate(
            material.model, f_rows, c_rows, numbers, tau, returned, self.hardening, self.stiffness, DT, epsilon
        )  # fmt: skip
        self.tau, self.returned = tau.reshape(-1, 3, 3), returned.reshape(-1, 3, 3)


def relative(actual: np.ndarray, expected: np.ndarray, scale: float) -> float:
    """Largest difference of any matrix, relative to its largest entry or to `scale`, whichever is larger."""
    size = np.maximum(np.abs(expected).reshape(len(expected), -1).max(1), scale)
    return (np.abs(actual - expected).reshape(len(expected), -1).max(1) / size).max()


def trials() -> np.ndarray:
    """Rest, small and large strain, equal and almost equal singular values, flattened and drawn out, (N, 3, 3)."""
    singular = [[1.3, 1.3, 0.7], [0.7, 0.7, 0.7], [1, 1, 1.0001], [1, 1 + 1e-6, 1 - 1e-6], [2, 1, 0.3], [0.2, 0.2, 3]]
    sets = [np.eye(3)[None], rotations(5), stretched(singular * 3)]
    return np.concatenate(sets + [deformations(100, strain, seed=3) for strain in (1e-4, 1e-2, 0.1, 0.4)])


@pytest.mark.parametrize("model", EXAMPLES)
def test_taichi_equals_numpy(model: str, precision: str) -> None:
    """Stress and return map of the same F: to 1e-12 in float64, and to rounding in float32.

    Rounding is amplified where singular values are far apart, in 0.2, 0.2, 3 by 225, and by the modulus of a fluid.
    """
    material, rng = EXAMPLES[model], np.random.default_rng(0)
    f = trials()
    result = Evaluated(material, precision, f, rng.normal(size=f.shape), 0.02 * rng.random(len(f)))
    exact = [a.astype(np.float64) for a in (result.f, result.c, result.before)]
    modulus = sum(materials.lame_parameters(material))
    epsilon = np.finfo(precision).eps
    tau = materials.kirchhoff_stress(material, *exact)
    assert relative(result.tau, tau, modulus) < 500 * epsilon
    returned, hardening = materials.return_map(material, exact[0], exact[2], DT)
    assert relative(result.returned, returned, 1.0) < 2000 * epsilon
    assert np.abs(result.hardening - hardening).max() < 5000 * epsilon


@pytest.mark.parametrize("model", sorted(model for model, law in LAWS.items() if law.flows))
def test_inside_out_is_turned_right(model: str, precision: str) -> None:
    """det F <= 0, singular and mirrored: as NumPy, and with det F > 0."""
    material = EXAMPLES[model]
    singular = [[1.1, 0.9, -0.5], [1.2, 1.0, 0.0], [1.0, 0.05, -0.02], [1.3, 1.1, -1.0], [1.0, 1e-4, 1e-4]]
    result = Evaluated(material, precision, stretched(singular * 4))
    returned, hardening = materials.return_map(material, result.f.astype(np.float64), 0.0, DT)
    tolerance = 1e-6 if precision == "float64" else 1e-3
    np.testing.assert_allclose(result.returned, returned, atol=tolerance)
    np.testing.assert_allclose(result.hardening, hardening, atol=20 * tolerance)
    assert (np.linalg.det(result.returned) > 0).all()


def test_fluid_at_rest_does_not_creep(precision: str) -> None:
    """J of a fluid that does not move is the same after 300 return maps."""
    result = Evaluated(EXAMPLES["fluid"], precision, np.cbrt(np.linspace(0.7, 1.3, 301))[:, None, None] * np.eye(3))
    first = last = result.returned
    for _ in range(300):
        last = Evaluated(EXAMPLES["fluid"], precision, last).returned
    np.testing.assert_array_equal(last, first)


def acoustic_tensors(material: Material, f: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Q with a . Q a = d^2/ds^2 psi((I + s a n^T) F) of each F (N, 3, 3) and n (M, 3), shape (N, M, 3, 3).

    Q a = d/ds [tau((I + s a n^T) F) (I + s a n^T)^-T] n at s = 0, by central differences.
    """
    h, q = 1e-5, np.zeros((len(f), len(normals), 3, 3))
    for k in range(3):
        for sign in (1, -1):
            step = np.eye(3) + sign * h * np.eye(3)[k][:, None] * normals[:, None, :]  # (M, 3, 3)
            tau = materials.kirchhoff_stress(material, step @ f[:, None])
            traction = np.einsum("nmij,mkj,mk->nmi", tau, np.linalg.inv(step), normals)
            q[..., k] += sign * traction / (2 * h)
    return q


@pytest.mark.parametrize("model", EXAMPLES)
def test_stiffness_bounds_every_wave(precision: str, model: str) -> None:
    """M less |tau| is at least the greatest eigenvalue of Q over n, not far above it, and lambda + 2 mu at rest."""
    material = replace(EXAMPLES[model], poisson_ratio={"float64": 0.49, "float32": 0.3}[precision])
    mu, lam = materials.lame_parameters(material)
    rng = np.random.default_rng(1)
    axes = [[1.0, 1.0, 1.0], [0.8, 0.8, 0.8], [1.3, 1.3, 1.3], [0.6, 1, 1], [1.6, 1, 1], [2, 0.5, 1], [1.3, 1.3, 0.5]]
    # The bound needs no more than isotropy, so that diagonal F do, and normals along their axes are tried too.
    diagonal = np.concatenate([axes, np.exp(rng.uniform(-0.7, 0.7, size=(60, 3)))])
    f = np.concatenate([diagonal[:, None] * np.eye(3), deformations(40, 0.1), deformations(40, 0.4)])
    normals = np.concatenate([np.eye(3), rng.normal(size=(60, 3))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    q = acoustic_tensors(material, f, normals)
    greatest = np.linalg.eigvalsh(0.5 * (q + np.swapaxes(q, -1, -2)))[..., -1].max(1)
    result = Evaluated(material, precision, f)
    bound = result.stiffness - np.linalg.norm(result.tau, axis=(1, 2))
    assert bound[0] == pytest.approx(lam + 2 * mu, rel=1e-6)
    assert (bound >= greatest - 1e-5 * result.stiffness).all()
    moderate = slice(len(diagonal), len(diagonal) + 40)  # strain of 0.1
    stiff = greatest[moderate] > 0  # water under tension has no stiffness
    assert (bound[moderate] / np.maximum(greatest[moderate], 1e-300))[stiff].max() < 1.5
