"""The laws' stresses backwards: against central differences of the NumPy laws, also where stretches coincide."""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false

import numpy as np
import pytest
from mpm_examples import EXAMPLES, deformations, stretched

from hoi.compute import start_compiler, ti
from hoi.gradient.laws import BACKWARDS
from hoi.mpm.law import Lame, lame
from hoi.mpm.laws import LAWS


def backwards(model: str, f: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    start_compiler("float64", 1, "cpu")
    law, count = BACKWARDS[model], len(f)
    fs, ts, out = (ti.ndarray(ti.f64, (count, 3, 3)) for _ in range(3))
    numbers, p = ti.ndarray(ti.f64, (count, 2)), lame(EXAMPLES[model])

    @ti.kernel
    def all_of(
        fs: ti.types.ndarray(), ts: ti.types.ndarray(), out: ti.types.ndarray(), numbers: ti.types.ndarray(),
        mu: float, lam: float,
    ):  # fmt: skip
        for i in range(fs.shape[0]):
            f, t = ti.Matrix.zero(float, 3, 3), ti.Matrix.zero(float, 3, 3)
            for a, b in ti.static(ti.ndrange(3, 3)):
                f[a, b], t[a, b] = fs[i, a, b], ts[i, a, b]
            p = ti.Vector([mu, lam, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            _, half = law.stress(f, f.determinant(), p, 1e-16)
            back, on_mu, on_lam = law.backwards(t, f, f.determinant(), half, p)
            for a, b in ti.static(ti.ndrange(3, 3)):
                out[i, a, b] = back[a, b]
            numbers[i, 0], numbers[i, 1] = on_mu, on_lam

    fs.from_numpy(f)
    ts.from_numpy(t)
    all_of(fs, ts, out, numbers, p.mu, p.lam)
    return out.to_numpy(), numbers.to_numpy()


@pytest.mark.parametrize("model", BACKWARDS)
def test_against_central_differences(model) -> None:
    f = np.concatenate([deformations(20, 0.3), stretched([[1, 1, 1], [2, 2, 0.5], [0.4, 0.4, 0.4], [3, 1, 1]])])
    rng = np.random.default_rng(2)
    t, way, p = rng.normal(size=f.shape), rng.normal(size=f.shape), lame(EXAMPLES[model])

    def stress(f: np.ndarray, mu: float = p.mu, lam: float = p.lam) -> np.ndarray:
        return (t * LAWS[model].kirchhoff_stress(Lame(mu, lam), f, 0 * f, np.zeros(len(f)))).sum((1, 2))

    ours, numbers = backwards(model, f, t)
    h = 1e-6
    expected = (stress(f + h * way) - stress(f - h * way)) / (2 * h)
    np.testing.assert_allclose((ours * way).sum((1, 2)), expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_allclose(numbers[:, 0], (stress(f, mu=p.mu + 1) - stress(f, mu=p.mu - 1)) / 2, atol=1e-8)
    np.testing.assert_allclose(numbers[:, 1], (stress(f, lam=p.lam + 1) - stress(f, lam=p.lam - 1)) / 2, atol=1e-8)
