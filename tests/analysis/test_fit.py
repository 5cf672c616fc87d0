"""A material found again from a motion made with hidden values, with noise; and what a motion cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from analysis import fit as fitting
from analysis.fit import Clip, fit, words
from hoi.data import Material
from hoi.errors import InputError
from hoi.mpm.solver import ground_plane

HIDDEN = Material("hidden", "neo_hookean", 2e5, 0.3, 150.0, 0.75, 0.25)
GUESS = replace(HIDDEN, name="guess", youngs_modulus=5e5, poisson_ratio=0.25, restitution=0.6, ground_friction=0.4)
VELOCITY, SPIN = np.array([2.0, 0.5, -1.0]), np.array([1.0, -3.0, 2.0])


def clip(height: float, frames: int, noise: float = 0.001) -> Clip:
    rng = np.random.default_rng(0)
    rest = rng.uniform(-1, 1, (1200, 3))
    rest = 0.11 * rest[(rest**2).sum(axis=1) < 1][:400]
    start = Clip(np.tile(rest + np.array([0, 0, height]), (frames, 1, 1)), rest, 4 / 3 * np.pi * 0.11**3, 30.0,
                 np.array([0, 0, -9.81]), (ground_plane(0.4),), cells=8)  # fmt: skip
    seen, _ = fitting.moved(start, HIDDEN, VELOCITY, SPIN, np.eye(3))
    return replace(start, observed=seen + noise * rng.normal(size=seen.shape))


def test_hidden_values_are_found_with_their_errors() -> None:
    found = fit(clip(0.35, 24), GUESS, starts=(1.0,))
    print(words(found))
    assert found.values["youngs_modulus"] == pytest.approx(HIDDEN.youngs_modulus, rel=0.2)
    assert found.values["restitution"] == pytest.approx(HIDDEN.restitution, abs=0.03)
    assert found.values["ground_friction"] == pytest.approx(HIDDEN.ground_friction, abs=0.05)
    np.testing.assert_allclose(found.velocity, VELOCITY, atol=0.01 * float(np.linalg.norm(VELOCITY)))
    assert found.told("restitution") and found.told("ground_friction") and found.touches


def test_a_free_flight_says_nothing_of_what_it_is_made_of() -> None:
    found = fit(clip(3.0, 12), GUESS, starts=(1.0,))
    assert not found.touches and not any(found.told(name) for name in fitting.NAMES)
    assert found.material == GUESS
    assert words(found)[0] == "youngs_modulus: this motion cannot tell: nothing touches the object"
    np.testing.assert_allclose(found.velocity, VELOCITY, atol=0.01 * float(np.linalg.norm(VELOCITY)))


def test_the_material_is_a_config_that_composes(tmp_path, composed) -> None:
    errors = dict.fromkeys(fitting.NAMES, 0.01)
    values = {name: getattr(HIDDEN, name) for name in fitting.NAMES}
    found = fitting.Fit(HIDDEN, values, errors, VELOCITY, np.zeros(3), SPIN, 0.001, True)
    (tmp_path / "material").mkdir()
    (tmp_path / "material" / "hidden.yaml").write_text(fitting.yaml_of(found, "run.mcap"))
    config = composed(f"hydra.searchpath=[{tmp_path}]", "material=hidden")
    assert config.material.youngs_modulus == HIDDEN.youngs_modulus and config.material.model == HIDDEN.model


def test_what_cannot_be_fitted_is_said() -> None:
    with pytest.raises(InputError, match="3 frames or more"):
        fit(replace(clip(3.0, 3), observed=np.zeros((2, 400, 3))), GUESS)
    with pytest.raises(InputError, match="an elastic solid that springs back, got 'fluid'"):
        fit(clip(3.0, 3), replace(GUESS, model="fluid"))
