"""Several bodies: alone as long as they are, together where they may touch."""

import numpy as np
from bodies import ground
from mpm_bodies import DX, block
from mpm_meetings import STIFF, ball, together, walk

GRAVITY = np.array([0, 0, -9.81])
FLOOR = ground(0.4)


def test_two_balls_fly_meet_and_fly_apart() -> None:
    """Only the meeting is simulated; momentum stays."""
    (a, volumes), (b, _) = ball(0.1, [0, 0, 0]), ball(0.1, [1.0, 0.02, 0])
    both = together(walk(a, volumes, [2.0, 0, 0], end=0.6), walk(b, volumes, [-2.0, 0, 0], end=0.6))
    phases = []
    for time in np.arange(1, 13) * 0.05:
        states = both.advance(float(time))
        phases.append(states[0][1])
        total = sum(state.velocities.mean(axis=0) for state, _ in states)
        np.testing.assert_allclose(total, 0, atol=1e-4)
    assert phases[0] == phases[-1] == "flight" and "mpm" in phases
    assert states[0][0].velocities[:, 0].mean() < -1
    assert all(tally.seconds["mpm"] < 0.3 for tally in both.finish())


def test_bystanders_cost_no_step_and_change_no_bit() -> None:
    """A block that lands beside ten boxes at rest does what it does alone."""
    x, volumes = block((0.2, 0.2, 0.1), DX / 2, lowest=0.02)
    options = {"planes": (FLOOR,), "gravity": GRAVITY, "material": STIFF}
    alone = walk(x, volumes, [0.1, 0, 0], end=0.2, **options)
    others = [
        walk(x + np.array([1.0 + i, 0, -0.02]), volumes, [0, 0, 0], end=0.2, held=True, **options) for i in range(10)
    ]
    beside = together(walk(x, volumes, [0.1, 0, 0], end=0.2, **options), *others)
    for time in (0.05, 0.1, 0.2):
        (state, phase), *rest = beside.advance(time)
        expected, expected_phase = alone.advance(time)
        assert phase == expected_phase
        np.testing.assert_array_equal(state.positions, expected.positions)
        assert {phase for _, phase in rest} == {"rest"}
    first, *tallies = beside.finish()
    assert first.steps == alone.finish().steps > 0
    assert not any(tally.steps for tally in tallies)


def test_what_rests_is_woken_by_what_comes_near_and_by_what_it_lies_on() -> None:
    """A ball rolls into the lower of two boxes at rest on each other; a third box out of the way stays."""
    (x, volumes), (a, of_a) = block((0.2, 0.2, 0.2), DX / 2), ball(0.1, [-0.35, 0.1, 0.1])
    options = {"planes": (FLOOR,), "gravity": GRAVITY, "material": STIFF, "end": 0.3}
    boxes = [walk(x + shift, volumes, [0, 0, 0], held=True, **options) for shift in ([0, 0, 0], [0, 0, 0.2], [0, 2, 0])]
    scene = together(walk(a, of_a, [3.0, 0, 0], **options), *boxes)
    states = scene.advance(0.3)
    assert states[1][0].positions[:, 0].mean() > 0.11
    assert [box.tally.changes > 0 for box in boxes] == [True, True, False]
    assert boxes[1].simulation.steps > 0 and states[3][1] == "rest"
