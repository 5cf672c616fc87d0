"""Gradients through the MPM against central differences of the solver itself, in float64."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpm_bodies import DX, block

from hoi.data import Material, ObjectState, Plane
from hoi.errors import InputError, RunError
from hoi.gradient.backwards import Cotangent, Gradient, Recording, _Backwards, differentiate
from hoi.mpm.collider import Collider
from hoi.mpm.phases import reach_of
from hoi.mpm.solver import Simulation, ground_plane, simulate
from hoi.mpm.state import initial_state, kick

X, VOLUMES = block((0.1, 0.1, 0.1), 0.025)
RNG = np.random.default_rng(1)
X = X + 1e-3 * RNG.normal(size=X.shape)
TIMES = (0.5, 1.0)
WEIGHTS = [
    (RNG.normal(size=X.shape), RNG.normal(size=X.shape), 0.01 * RNG.normal(size=(len(X), 3, 3)),
     RNG.normal(size=(len(X), 3, 3))) for _ in TIMES
]  # fmt: skip
STRAIN = 0.02 * RNG.normal(size=(len(X), 3, 3))
"""It vibrates from the start: a play has kinks where nothing is strained."""
ALONG = RNG.normal(size=X.shape)

FLIGHT: dict[str, Any] = {"planes": ()}
BOUNCE: dict[str, Any] = {"height": 0.01}
PRESS: dict[str, Any] = {"height": -0.01, "velocity": (0.4, 0.1, 0.0), "gravity": (0.0, 0.0, -300.0)}
CORNER: dict[str, Any] = {
    "height": 0.0,
    "planes": [
        Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "coulomb", 0.3),
        Plane(np.array([0.1, 0.0, 0.0]), np.array([-0.8, 0.0, 0.6]), "slip"),
        Plane(np.array([0.0, 0.0, -0.02]), np.array([0.0, 0.6, 0.8]), "stick"),
    ],
}
OPENS_AND_CLOSES: dict[str, Any] = {"height": 0.03, "velocity": (0.3, 0.1, -2.0), "until": 0.14, "dt": 5e-4}


def setup(
    *, model: str = "neo_hookean", rebound: float | None = 0.6, height: float = 0.2, until: float = 0.02,
    velocity: Sequence[float] = (0.5, 0.2, -2.0), dt: float = 2e-4, **settings: object,
) -> tuple[ObjectState, Material, float, dict[str, Any]]:  # fmt: skip
    positions = X + np.array([0, 0, height])
    state = initial_state(positions, VOLUMES, velocity, (1.0, 2.0, 3.0))
    state = replace(state, deformation_gradient=state.deformation_gradient + STRAIN)
    material = Material("m", model, 1e5, 0.3, 1000.0, 0.6, 0.4)
    rebounds = None if rebound is None else [rebound]
    return state, material, until, {"dx": DX, "dt": dt, "rebound": rebounds, "precision": "float64", **settings}


def value_of(states: tuple[ObjectState, ...]) -> tuple[float, list[Cotangent]]:
    """A number to which all of each state counts."""
    value = 0.0
    for state, weights in zip(states, WEIGHTS, strict=True):
        parts = (state.positions, state.velocities, state.affine, state.deformation_gradient)
        value += sum(float((w * part).sum()) for w, part in zip(weights, parts, strict=True))
    return value, [Cotangent(*weights) for weights in WEIGHTS]


def differences(case: dict[str, Any], step: float = 1.0) -> dict[str, tuple[float, float]]:
    """Of each cause: what the gradient says, and central differences with `step` times the usual steps."""
    state, material, until, settings = setup(**case)
    times = [until * share for share in TIMES]

    def value(state: ObjectState = state, material: Material = material, **changed: object) -> float:
        return value_of(simulate(state, VOLUMES, material, times=times, **{**settings, **changed}).states)[0]

    def central(h: float, of) -> float:
        h *= step
        return (of(h) - of(-h)) / (2 * h)

    _, g = differentiate(value_of, state, VOLUMES, material, times=times, **settings)
    own, centre, unit = g.materials[0], VOLUMES @ state.positions / VOLUMES.sum(), np.eye(3)
    gravity = np.array(settings.get("gravity", (0, 0, -9.81)))
    found = {
        "positions": ((g.positions * ALONG).sum(),
                      central(1e-7, lambda h: value(replace(state, positions=state.positions + h * ALONG)))),
        "deformation": ((g.deformation_gradient * WEIGHTS[0][3]).sum(), central(1e-6, lambda h: value(
            replace(state, deformation_gradient=state.deformation_gradient + h * WEIGHTS[0][3])))),
        "E": (own.youngs_modulus,
              central(0.1, lambda h: value(material=replace(material, youngs_modulus=1e5 + h)))),
        "nu": (own.poisson_ratio, central(1e-6, lambda h: value(material=replace(material, poisson_ratio=0.3 + h)))),
        "density": (own.density, central(1e-2, lambda h: value(material=replace(material, density=1000 + h)))),
        "gravity": (g.gravity @ [1, 2, 3], central(1e-4, lambda h: value(gravity=gravity + h * np.array([1, 2, 3])))),
    }  # fmt: skip
    for axis in range(3):
        found[f"velocity {axis}"] = (
            g.velocity[axis], central(1e-6, lambda h, axis=axis: value(kick(state, h * unit[axis]))))  # fmt: skip
        found[f"spin {axis}"] = (g.spin()[axis], central(
            1e-5, lambda h, axis=axis: value(kick(state, np.zeros(3), h * unit[axis], centre))))  # fmt: skip
    if settings["rebound"]:
        found["rebound"] = (own.rebound, central(1e-6, lambda h: value(rebound=[0.6 + h])))
    if "planes" not in case:
        found["friction"] = (g.friction[0], central(1e-7, lambda h: value(planes=[ground_plane(0.4 + h)])))
    return found


def check(found: dict[str, tuple[float, float]], share: float) -> None:
    for name, (ours, theirs) in found.items():
        assert ours == pytest.approx(theirs, rel=share, abs=1e-9), name


@pytest.mark.parametrize("case", [FLIGHT, BOUNCE, PRESS, CORNER], ids=["flight", "bounce", "press", "corner"])
@pytest.mark.parametrize("model", ["neo_hookean", "fixed_corotated"])
def test_central_differences(case, model) -> None:
    check(differences({**case, "model": model, "rebound": None}), 1e-5)


@pytest.mark.parametrize("case", [FLIGHT, BOUNCE, PRESS], ids=["flight", "bounce", "press"])
def test_of_a_solid_that_loses_energy(case) -> None:
    """A play meets its bounds at all times, here 64 of them within the differences' step now and then."""
    check(differences(case, 0.1), 2e-4)


def test_across_a_contact_that_closes_and_opens() -> None:
    state, material, until, settings = setup(**OPENS_AND_CLOSES)
    run = Simulation(state, VOLUMES, material, **settings)
    reached = []
    while run.time < until:
        run.step_towards(until, 0.005)
        reached.append(run.state().positions[:, 2].min())
    free = reach_of(run.planes[0], DX)
    assert reached[0] > free and min(reached) < 0 and reached[-1] > free, "it must come and go"
    check(differences(OPENS_AND_CLOSES, 0.1), 1e-3)


def test_cubic_splines() -> None:
    check(differences({**BOUNCE, "spline": "cubic"}), 1e-5)


def gradient_of(case: dict[str, Any], **settings: object) -> Gradient:
    state, material, until, usual = setup(**case)
    times = [until * share for share in TIMES]
    return differentiate(value_of, state, VOLUMES, material, times=times, **{**usual, **settings})[1]


@pytest.mark.parametrize("case", [FLIGHT, BOUNCE, PRESS, OPENS_AND_CLOSES])
def test_float32_agrees_with_float64(case) -> None:
    exact, single = gradient_of(case), gradient_of(case, precision="float32")
    for name in ("positions", "velocities", "affine", "deformation_gradient", "friction", "gravity"):
        theirs = np.array(getattr(exact, name))
        assert np.linalg.norm(np.array(getattr(single, name)) - theirs) <= 1e-2 * np.linalg.norm(theirs), name
    if case is not FLIGHT:  # of what does not strain, E is worth nothing but round-off
        for name in ("youngs_modulus", "poisson_ratio", "density", "rebound"):
            assert getattr(single.materials[0], name) == pytest.approx(getattr(exact.materials[0], name), rel=1e-2)


def test_it_is_the_solver_bit_by_bit() -> None:
    """Recorded or not, the steps are the same."""
    state, material, until, settings = setup(**BOUNCE)
    run, plain = Recording(state, VOLUMES, material, **settings), Simulation(state, VOLUMES, material, **settings)
    run.advance(until / 2)
    run.backwards([(until / 2, Cotangent(positions=np.ones_like(X)))])  # it can go on after that
    run.advance(until)
    plain.advance(until / 2)
    plain.advance(until)
    for name in ("positions", "velocities", "affine", "deformation_gradient", "play"):
        np.testing.assert_array_equal(getattr(run.state(), name), getattr(plain.state(), name))
    one, two = (run.backwards([(until, Cotangent(positions=X))]) for _ in range(2))
    np.testing.assert_array_equal(one.positions, two.positions)
    assert np.linalg.norm(one.positions) > 0


@pytest.mark.parametrize("case", [FLIGHT, BOUNCE, PRESS], ids=["flight", "bounce", "press"])
def test_steps_taken_again_from_a_checkpoint_are_the_same_to_the_bit(case: dict[str, Any]) -> None:
    """What goes backwards are the steps of the run: each stretch ends where the next one starts."""
    state, material, until, settings = setup(**case)
    run = Recording(state, VOLUMES, material, **settings)
    run.advance(until)
    last = [array.to_numpy() for array in (run.x, run.v, run.c, run.f, run.play)]
    parts, back = run._parts(), _Backwards(run)
    ends = [*(run.checkpoints[start] for start, _ in parts[1:]), last]
    for (start, launches), end in zip(parts, ends, strict=True):
        back.replay(run.checkpoints[start], launches)
        for again, once in zip(back.state, end, strict=True):
            np.testing.assert_array_equal(again.to_numpy(), once)
    assert any((now != then).any() for now, then in zip(last, run.checkpoints[0], strict=True)), "it moved"


def test_two_materials_each_get_their_own() -> None:
    """What both are worth together is what one material is; and each agrees with central differences."""
    state, material, until, settings = setup(**BOUNCE)
    settings = {**settings, "region": (X[:, 2] > 0.05).astype(np.int32), "rebound": [0.6, 0.8]}
    times = [until * share for share in TIMES]
    other = replace(material, youngs_modulus=6e4, density=700.0)
    _, g = differentiate(value_of, state, VOLUMES, [material, other], times=times, **settings)

    def value(h: float, field: str) -> float:
        changed = replace(other, **{field: getattr(other, field) + h})
        return value_of(simulate(state, VOLUMES, [material, changed], times=times, **settings).states)[0]

    for field, h in (("youngs_modulus", 0.1), ("density", 1e-2), ("poisson_ratio", 1e-6)):
        expected = (value(h, field) - value(-h, field)) / (2 * h)
        assert getattr(g.materials[1], field) == pytest.approx(expected, rel=1e-5)
        assert abs(getattr(g.materials[0], field)) > 0


def test_duration_stretches_all_steps() -> None:
    state, material, until, settings = setup(**BOUNCE)
    times = np.array([until * share for share in TIMES])
    _, g = differentiate(value_of, state, VOLUMES, material, times=times, **settings)

    def value(share: float) -> float:
        stretched = {**settings, "dt": settings["dt"] * share}
        return value_of(simulate(state, VOLUMES, material, times=times * share, **stretched).states)[0]

    h = 1e-6
    assert g.duration == pytest.approx((value(1 + h) - value(1 - h)) / (2 * h * until), rel=1e-5)


def test_an_impulse_is_a_kick_at_a_point() -> None:
    """Of the rigid body: its momentum and angular momentum change by the impulse and its moment."""
    g = gradient_of(FLIGHT)
    point = g.state.positions[5]
    expected = g.velocity / g.masses.sum()
    np.testing.assert_allclose(g.impulse(VOLUMES @ g.state.positions / VOLUMES.sum()), expected, rtol=1e-12)
    assert np.linalg.norm(g.impulse(point) - expected) > 1e-3 * np.linalg.norm(expected)


def test_memory_grows_as_the_root_of_the_steps() -> None:
    """States of the particles kept at once, over 128 to 2048 steps: four times the steps, about twice the states."""
    state, material, _, settings = setup(**FLIGHT)
    kept = {}
    for steps in (128, 512, 2048):
        run = Recording(state, VOLUMES, material, **settings)
        run.advance(steps * settings["dt"])
        assert run.steps == steps
        kept[steps] = run.states_kept
        assert kept[steps] <= 3 * np.sqrt(steps) + 33
    assert kept[2048] < 2.5 * kept[512]


@pytest.mark.parametrize(("change", "says"), [
    ({"youngs_modulus": 1e12}, "stiff"), ({"velocity": (0.0, 0.0, -300.0)}, "fast"), ({"together": True}, "together"),
])  # fmt: skip
def test_extremes_are_finite_or_refused_in_one_line(change, says) -> None:
    state, material, until, settings = setup(height=0.0, velocity=change.get("velocity", (0.0, 0.0, -1.0)))
    if "together" in change:
        together = state.positions.copy()
        together[1] = together[0] + 1e-12
        state = replace(state, positions=together)
    material = replace(material, youngs_modulus=change.get("youngs_modulus", 1e5))
    settings["dt"] = None
    until = 0.02 if "together" in change else 2e-5
    try:
        _, g = differentiate(lambda s: (0.0, [Cotangent(positions=s[0].positions)]), state, VOLUMES, material,
                             times=[until], **{**settings, "precision": "float32"})  # fmt: skip
    except (InputError, RunError) as error:
        assert "\n" not in str(error), says
    else:
        for array in (g.positions, g.velocities, g.affine, g.deformation_gradient):
            assert np.isfinite(array).all(), says


def test_what_cannot_be_taken_backwards_is_said() -> None:
    state, material, until, settings = setup()
    with pytest.raises(InputError, match="model of a gradient must be one of fixed_corotated, neo_hookean"):
        Recording(state, VOLUMES, replace(material, model="fluid"), **settings)
    with pytest.raises(InputError, match="threads must be 1"):
        Recording(state, VOLUMES, material, **settings, threads=2)
    ends = np.zeros((2, 1, 3))
    collider = Collider(np.array([0.0, 1.0]), ends, ends + 1, np.ones(1), 0.5)
    with pytest.raises(InputError, match="give the blow as an impulse"):
        Recording(state, VOLUMES, material, **settings, collider=collider)
    run = Recording(state, VOLUMES, material, **settings)
    run.advance(until)
    with pytest.raises(InputError, match=r"times that the simulation was advanced to, got 0.013 s"):
        run.backwards([(0.013, Cotangent())])
    with pytest.raises(InputError, match=r"positions must have shape \(64, 3\), got \(3,\)"):
        run.backwards([(until, Cotangent(positions=np.zeros(3)))])


def test_a_gradient_that_is_not_finite_is_refused() -> None:
    state, material, until, settings = setup()
    run = Recording(state, VOLUMES, material, **{**settings, "precision": "float32"})
    run.advance(until)
    with pytest.raises(RunError, match="not finite"):
        run.backwards([(until, Cotangent(positions=np.full_like(X, np.inf)))])
