"""The time step's limit, and the extreme list: every case ends in a result or a named error, never in a silent NaN."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, RUBBER, block
from mpm_examples import EXAMPLES

from hoi.data import Material, ObjectState
from hoi.errors import InputError, RunError
from hoi.mpm.solver import simulate
from hoi.mpm.stability import (
    DEFAULT_FRACTION,
    STABLE_CFL,
    STABLE_DIFFUSION,
    cfl_number,
    choose_time_step,
    stable_step,
    time_step_limit,
)
from hoi.mpm.state import energies, initial_state

PAPER = Material("paper", "fixed_corotated", 1e7, 0.45, 1000.0, 0.6, 0.5)


def cube(lowest: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    return block((0.15, 0.15, 0.15), DX / 2, lowest)


def shaking(material: Material, cfl: float, steps: int) -> tuple[float, float]:
    """Energy before and after `steps` steps at this CFL number of a cube with random velocities of 1e-3 c."""
    x, volumes = cube()
    dt = cfl / cfl_number(material, DX, 1.0) / 1.01  # room for those velocities
    start = initial_state(x, volumes, [0, 0, 0])
    noise = 1e-3 * DX * cfl / dt * np.random.default_rng(0).normal(size=x.shape)
    start = replace(start, velocities=noise)
    result = simulate(start, volumes, material, dx=DX, dt=dt, times=[steps * dt], gravity=(0, 0, 0), planes=())
    return energies(start, volumes, material, DX, np.zeros(3)).sum(), result.energy[-1].sum()


def test_paper_setting_is_allowed() -> None:
    """E = 1e7, 64 cells over 2 m, dt = 4e-5: CFL 0.25 at 1000 kg/m^3, 0.56 at 200, both below the limit."""
    light = replace(PAPER, density=200.0)
    assert cfl_number(PAPER, 2 / 64, 4e-5) == pytest.approx(0.25, abs=0.005)
    assert cfl_number(light, 2 / 64, 4e-5) == pytest.approx(0.56, abs=0.005)
    for material in (PAPER, light):
        assert choose_time_step(material, 2 / 64, 10.0, dt=4e-5) == 4e-5


def test_chosen_step_is_a_share_of_the_limit() -> None:
    assert choose_time_step(PAPER, DX, 5.0) == DEFAULT_FRACTION * time_step_limit(PAPER, DX, 5.0)
    assert cfl_number(PAPER, DX, time_step_limit(PAPER, DX, 5.0), 5.0) == pytest.approx(STABLE_CFL)


def test_of_several_materials_the_stiffest_counts() -> None:
    limits = [time_step_limit(material, DX, 5.0) for material in (RUBBER, PAPER)]
    assert time_step_limit([RUBBER, PAPER], DX, 5.0) == min(limits) < max(limits)
    assert cfl_number([RUBBER, PAPER], DX, 1e-4) == cfl_number(PAPER, DX, 1e-4)
    with pytest.raises(InputError, match="for paper"):
        choose_time_step([RUBBER, PAPER], DX, 5.0, dt=1.1 * limits[1])


def test_viscosity_limits_the_step() -> None:
    """Alone by STABLE_DIFFUSION rho dx^2 / viscosity, without it by the waves, and below both with both."""
    syrup = replace(EXAMPLES["fluid"], viscosity=1e3)
    by_viscosity, by_waves = STABLE_DIFFUSION * DX**2 * syrup.density / syrup.viscosity, STABLE_CFL * DX / 3.0
    assert stable_step(DX, 1e-6, 1.0) == pytest.approx(by_viscosity, rel=1e-5)
    assert stable_step(DX, 3.0) == pytest.approx(by_waves)
    both = stable_step(DX, 3.0, 1.0)
    assert (both / by_waves) ** 2 + both / by_viscosity == pytest.approx(1)
    with pytest.raises(InputError, match=r"for fluid \(wave speed 8 m/s, viscosity 1000 Pa s\)"):
        choose_time_step(syrup, DX, 0.0, dt=by_viscosity)
    assert time_step_limit(replace(EXAMPLES["viscoplastic"], viscosity=1e3), DX) > 2 * by_viscosity


@pytest.mark.parametrize("viscosity", [10.0, 1e3])
def test_viscous_limit_is_stable(viscosity: float) -> None:
    """At the limit itself a shaken cube of a fluid calms down."""
    fluid = replace(EXAMPLES["fluid"], viscosity=viscosity)
    limit = time_step_limit(fluid, DX, 0.01)
    before, after = shaking(fluid, limit * cfl_number(fluid, DX, 1.0), 400)
    assert 0 <= after < before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dt": 4e-5, "dx": 0.007}, r"^dt must be at most 2.\d+e-05 s for paper \(wave speed 195 m/s\)"),
        ({"dt": 0.0}, "^dt must be positive"),
        ({"dt": float("nan")}, "^dt must be positive"),
        ({"dx": 0.0}, "mpm dx must be positive"),
        ({"speed": float("inf")}, "mpm speed must be"),
        ({"fraction": 1.5}, "fraction"),
    ],
)
def test_bad_steps_are_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        choose_time_step(**{"material": PAPER, "dx": DX, "speed": 0.0} | arguments)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.45, 0.499])
@pytest.mark.parametrize("youngs_modulus", [1e3, 1e9])
def test_limit_is_stable(poisson_ratio: float, youngs_modulus: float) -> None:
    """At the limit itself the energy of a shaken cube does not grow in 400 steps."""
    material = replace(RUBBER, poisson_ratio=poisson_ratio, youngs_modulus=youngs_modulus)
    before, after = shaking(material, STABLE_CFL, 400)
    assert 0 < after < before


def test_a_fixed_step_that_becomes_too_long_is_found() -> None:
    """A body in free fall outruns the step that was stable at rest: an error that names time, step and limit."""
    x, volumes = cube()
    start = initial_state(x, volumes, [0, 0, 0])
    dt = 0.99 * time_step_limit(PAPER, DX)
    with pytest.raises(RunError, match=r"t = \S+ s, step \d+: dt \S+ s is above the limit, which has fallen to"):
        simulate(start, volumes, PAPER, dx=DX, dt=dt, times=[0.1], gravity=(0, 0, -1e4), planes=())


def test_a_step_above_the_limit_is_refused() -> None:
    x, volumes = cube()
    dt = 1.1 * time_step_limit(PAPER, DX)
    with pytest.raises(InputError, match=r"^dt must be at most"):
        simulate(initial_state(x, volumes, [0, 0, 0]), volumes, PAPER, dx=DX, dt=dt, times=[0.1])


@pytest.mark.parametrize("density", [0.1, 1e4])
def test_extreme_densities_run(density: float) -> None:
    x, volumes = cube(0.0)
    material = replace(RUBBER, density=density)
    dt = choose_time_step(material, DX, 5.0)
    result = simulate(initial_state(x, volumes, [0, 0, -2]), volumes, material, dx=DX, dt=dt, times=[100 * dt])
    assert np.isfinite(result.energy).all()


@pytest.mark.parametrize("positions", [[[0, 0, 0.3]], [[0.1, 0.2, 0.3]] * 5, [[0, 0, 0]]])
def test_few_particles(positions: list[list[float]]) -> None:
    """One particle, or several in one place, fly and land like any other body."""
    x = np.array(positions, dtype=float)
    start = initial_state(x, np.ones(len(x)), [1, 0, 0])
    result = simulate(start, np.full(len(x), 1e-5), RUBBER, dx=DX, dt=5e-4, times=[0.02, 0.5])
    assert result.states[-1].positions[:, 2].min() > -0.5 * DX
    if x[0, 2] > 0:
        assert result.com[0, 2] == pytest.approx(0.3 - 9.81 * 0.02**2 / 2, abs=1e-6)


def test_impact_faster_than_the_waves() -> None:
    """Thrown at the ground at twice the wave speed: a result without NaN, or a named divergence."""
    x, volumes = cube(0.1)
    speed = 2 * RUBBER_SPEED
    start = initial_state(x, volumes, [0, 0, -speed])
    dt = choose_time_step(RUBBER, DX, speed)
    try:
        result = simulate(start, volumes, RUBBER, dx=DX, dt=dt, times=[200 * dt])
    except RunError as error:
        assert "diverged" in str(error)
    else:
        assert np.isfinite(result.energy).all()


RUBBER_SPEED = cfl_number(RUBBER, 1.0, 1.0)


def test_body_in_pieces_is_an_error_not_a_huge_grid() -> None:
    x = np.array([[0, 0, 1], [1e3, 1e3, 1e3]], dtype=float)
    with pytest.raises(RunError, match="the object spans"):
        simulate(initial_state(x, np.ones(2), [0, 0, 0]), np.full(2, 1e-5), RUBBER, dx=DX, dt=1e-3, times=[0.1])


@pytest.mark.parametrize("field", ["positions", "velocities", "affine", "deformation_gradient"])
def test_nan_input_is_refused(field: str) -> None:
    x, volumes = cube()
    start = initial_state(x, volumes, [0, 0, 0])
    getattr(start, field)[3] = np.nan
    with pytest.raises(InputError, match=f"object state {field} must be finite, got .* for particle 3"):
        simulate(start, volumes, RUBBER, dx=DX, dt=1e-4, times=[0.1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": []}, "times"),
        ({"times": [0.2, 0.1]}, "times"),
        ({"times": [-0.1]}, "times"),
        ({"dt": 0.0}, "dt must be positive"),
        ({"dx": float("nan")}, "dx must be positive"),
        ({"gravity": (0, 0)}, "gravity"),
        ({"precision": "float16"}, "precision"),
        ({"threads": 0}, "threads"),
        ({"device": "tpu"}, "device"),
        ({"volumes": np.zeros(216)}, "volumes"),
        ({"state": ObjectState(*(np.zeros((0, 3)),) * 2, *(np.zeros((0, 3, 3)),) * 2)}, "no particles"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], message: str) -> None:
    x, volumes = cube()
    arguments = {"state": initial_state(x, volumes, [0, 0, 0]), "volumes": volumes, "material": RUBBER}
    arguments |= {"dx": DX, "dt": 1e-4, "times": [0.1]} | change
    with pytest.raises(InputError, match=message):
        simulate(**arguments)  # pyright: ignore[reportArgumentType]


def test_inverted_input_is_refused() -> None:
    x, volumes = cube()
    start = initial_state(x, volumes, [0, 0, 0])
    start.deformation_gradient[0] *= -1
    with pytest.raises(InputError, match="det F > 0"):
        simulate(start, volumes, RUBBER, dx=DX, dt=1e-4, times=[0.1])


def test_times_of_any_spacing_are_met_exactly() -> None:
    """0, a fraction of a frame, less than a step, then a frame: the steps fit the intervals."""
    x, volumes = cube()
    times = [0.0, 0.0123, 0.01231, 0.05]
    start = initial_state(x, volumes, [1, 0, 0])
    result = simulate(start, volumes, RUBBER, dx=DX, dt=1e-3, times=times, gravity=(0, 0, 0), precision="float64")
    assert result.steps == 13 + 1 + 38
    np.testing.assert_allclose(result.com[:, 0] - result.com[0, 0], times, atol=1e-12)
