"""Strike after strike: what has been stays, what comes is where the object will be."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies import HAND, carried, cloud_of, fist

from hoi.body.kinematics import rotation_from_6d
from hoi.data import Act, Contact, ContactSearch, Material, Motion, ObjectTrajectory, Push, Scene, SceneObject, Target
from hoi.gaussians import fibonacci_sphere
from hoi.method.approach import delay_in, retimed
from hoi.method.contact import find_contact
from hoi.method.sequence import SETTLING, bent, joined, merged, placed_next

FPS = 20.0
RADIUS, LIMB_RADIUS = 0.11, 0.05


def wandering(frames: int, seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    still = carried([0, 0, 1], [0.3, 1, 0], frames, FPS)
    pose = np.cumsum(0.02 * rng.normal(size=(frames, 23, 3)), axis=0)
    return replace(still, body_pose=pose.astype(np.float32), translation=still.translation.astype(np.float32))


def there_and_back(frames: int, strikes: tuple[int, ...], reach: float = 0.2) -> Motion:
    """A fist that is at y = -0.16 in the frames of its strikes, and `reach` farther back between them."""
    y = np.full(frames, -0.16 - reach)
    for frame in strikes:
        y[frame - 2 : frame + 3] = -0.16 - reach * np.array([1, 0.5, 0, 0.5, 1])
    return replace(carried([0, 0, 1], [0, 0, 0], frames, FPS), translation=np.stack([0 * y, y, 0 * y + 1], -1))


def a_ball(frames: int, com: np.ndarray | None = None) -> tuple[SceneObject, ObjectTrajectory]:
    com = np.tile([0.0, 0, 1], (frames, 1)) if com is None else com
    means, zero = RADIUS * fibonacci_sphere(1500), np.zeros(3)
    material = Material("ball", "neo_hookean", 1e5, 0.3, 1.0, 0.6, 0.5)
    volumes = np.full(len(means), 0.43 / len(means))
    thing = SceneObject("ball", cloud_of(means, 0.005), means, volumes, material, zero, zero, 2 * RADIUS)
    velocity = np.gradient(com, axis=0) * FPS
    return thing, ObjectTrajectory(com[:, None] + means, com, velocity, np.zeros((frames, 3)))


def search(motion: Motion, **how) -> ContactSearch:
    thing, trajectory = a_ball(len(motion))
    scene = Scene("s", fist(300, LIMB_RADIUS), thing, "", len(motion), FPS, np.zeros(3))
    return find_contact(scene, motion, trajectory, tau=0.05, distance=0.01, between_frames=True, **how)


def test_the_search_goes_on_after_a_contact():
    """The same limb strikes again only once it has let go; what lies behind `until` is left to a later search."""
    motion = there_and_back(40, (10, 25))
    first = search(motion).push
    assert first is not None and 8 < first.frame <= 10
    second = search(motion, last=first).push
    assert second is not None and 23 < second.frame <= 25
    assert search(motion, last=second).push is None
    assert search(motion, last=first, until=20.0).push is None
    assert search(motion, until=first.frame).push is None


def test_a_limb_that_stays_in_touch_does_not_strike_again():
    y = np.minimum(-0.4 + 0.03 * np.arange(30), -0.12)
    motion = replace(carried([0, 0, 1], [0, 0, 0], 30, FPS), translation=np.stack([0 * y, y, 0 * y + 1], -1))
    first = search(motion).push
    assert first is not None and search(motion, last=first).push is None


def test_all_contacts_are_kept():
    motion = there_and_back(40, (10, 25))
    first = search(motion)
    second = search(motion, last=first.push)
    whole = merged(merged(None, first), second)
    assert whole.contacts == (*first.contacts, *second.contacts) and whole.push is first.push
    assert whole.smallest_gap == first.smallest_gap
    pushes = (Push(0.5, 0.6, np.ones(3)), Push(1.3, 1.4, np.ones(3)))
    assert merged(replace(first, pushes=pushes), second).pushes == pushes
    new = replace(second, pushes=(Push(1.25, 1.5, np.ones(3)),))
    assert merged(replace(first, pushes=pushes), new).pushes == (pushes[0], *new.pushes)


def test_given_are_those_with_an_impulse():
    (contact,) = search(there_and_back(40, (10,))).contacts
    struck = replace(contact, impulse=np.array([0.0, 1, 0]))
    found = ContactSearch((struck, contact, replace(struck, v_in=-1.0)), 0.0, 0.0, HAND)
    assert found.given == (struck,)


def test_bent_turns_and_moves_all_that_follows():
    motion = wandering(60, 0)
    moved = bent(motion, 20, 40, np.pi / 2, np.array([1.0, 2, 0]))
    np.testing.assert_array_equal(moved.translation[:20], motion.translation[:20])
    np.testing.assert_allclose(moved.orientation[:20], motion.orientation[:20], atol=1e-6)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    steps = np.diff(motion.translation[40:], axis=0) @ turn.T
    np.testing.assert_allclose(np.diff(moved.translation[40:], axis=0), steps, atol=1e-5)
    roots = [rotation_from_6d(torch.as_tensor(m.orientation[50], dtype=torch.float64)).numpy() for m in (motion, moved)]
    np.testing.assert_allclose(roots[1], turn @ roots[0], atol=1e-6)
    still = bent(carried([0, 0, 1], [0, 0, 0], 60, FPS), 20, 40, 0.0, np.array([1.0, 2, 0]))
    np.testing.assert_allclose(still.translation[-1], [1, 2, 1])
    assert np.linalg.norm(np.diff(still.translation, n=2, axis=0), axis=1).max() * FPS**2 < 14  # no jerks: 5.8 d / t^2


def test_joined_keeps_what_has_been_to_the_bit():
    before, after = wandering(60, 0), wandering(60, 1)
    made = joined(before, after, 20)
    over = 20 + int(SETTLING * FPS)
    for name in ("translation", "orientation", "body_pose"):
        np.testing.assert_array_equal(getattr(made, name)[:21], getattr(before, name)[:21])
        np.testing.assert_allclose(getattr(made, name)[over:], getattr(after, name)[over:], atol=1e-5)
    same = joined(before, before, 20)
    np.testing.assert_allclose(same.body_pose, before.body_pose, atol=1e-6)


@pytest.mark.parametrize("to", [18, 25, 30, 34])
def test_retimed_moves_the_strike_and_keeps_its_speed(to):
    y = np.cumsum(np.exp(-0.5 * ((np.arange(60) - 25.5) / 2) ** 2))  # fastest from frame 25 to 26
    motion = replace(carried([0, 0, 1], [0, 0, 0], 60, FPS), translation=np.stack([0 * y, y, 0 * y], -1))
    moved = retimed(motion, 5, 25, to)
    speed = np.diff(moved.translation[:, 1])
    assert abs(int(speed.argmax()) - to) <= 1
    assert speed.max() == pytest.approx(np.diff(y).max(), rel=0.15)
    np.testing.assert_allclose(moved.translation[:6], motion.translation[:6], atol=1e-12)
    np.testing.assert_allclose(moved.translation[-1], motion.translation[-1], atol=1e-12)
    steady = retimed(carried([0, 0, 1], [0, 1, 0], 60, FPS), 5, 25, to)
    assert (np.diff(steady.translation[:, 1]) > 0).all()  # never backwards
    assert retimed(motion, 5, 25, 25) is motion


def test_a_strike_waits_in_its_act_for_the_object():
    heights = np.linspace(3.0, 0.0, 60)  # at 1 m at frame 39
    target = Target(HAND, 20, "")
    assert target.frame + delay_in(Act("", 0, 3, strikes="left_hand"), 1.0, heights, target, FPS) in (37, 38, 39)
    assert target.frame + delay_in(Act("", 0, 1.5, strikes="left_hand"), 1.0, heights, target, FPS) == 29
    assert target.frame + delay_in(Act("", 0, 3, strikes="left_hand", at=1.2), 1.0, heights, target, FPS) == 24


@pytest.mark.parametrize("at", [[0.0, 0.6, 1.0], [0.5, 0.3, 1.0], [-0.4, 0.2, 1.0]])
def test_the_next_strike_is_placed_at_the_object(at):
    """The fist's skin then meets the ball's, whichever way that is; until `since` nothing changes."""
    frames = 60
    motion = there_and_back(frames, (10, 40))
    thing, trajectory = a_ball(frames, np.tile(at, (frames, 1)))
    scene = Scene("s", fist(300, LIMB_RADIUS), thing, "", frames, FPS, np.zeros(3))
    act = Act("", 1.0, 3.0, strikes="left_hand")
    placed, target = placed_next(scene, motion, trajectory, Target(HAND, 39, ""), act, 14, moves=True)
    meeting = target.meeting_frame(frames)
    gap = np.linalg.norm(placed.translation[meeting] - at) - RADIUS - LIMB_RADIUS
    assert abs(gap) < 0.02
    np.testing.assert_array_equal(placed.translation[:14], motion.translation[:14])
    stays, _ = placed_next(scene, motion, trajectory, Target(HAND, 39, ""), act, 14, moves=False)
    np.testing.assert_allclose(stays.translation[:, 0], 0.0)


@pytest.mark.parametrize("way", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
def test_sent_the_other_side_is_met(way):
    frames = 60
    motion = there_and_back(frames, (10, 40))
    thing, trajectory = a_ball(frames, np.tile([0.0, 0.3, 1.0 + 0.16 * way[2]], (frames, 1)))
    scene = Scene("s", fist(300, LIMB_RADIUS), thing, "", frames, FPS, np.zeros(3))
    target = Target(HAND, 39, "", way=way)
    placed, target = placed_next(scene, motion, trajectory, target, Act("", 1, 3, strikes="left_hand"), 14, moves=True)
    meeting = target.meeting_frame(frames)
    apart = trajectory.com[meeting] - placed.translation[meeting]
    np.testing.assert_allclose(apart, (RADIUS + LIMB_RADIUS) * np.array(way), atol=0.02)


def contact_now(frame: float) -> Contact:
    zero = np.zeros(3)
    return Contact(frame, HAND, 1.0, zero, zero, zero, zero, 1.0, zero, zero, 0.0)


def test_what_pushes_together_is_named_without_what_comes_later():
    from hoi.body.parts import struck_together

    found = ContactSearch((contact_now(10.0), replace(contact_now(10.5), joint=23), replace(contact_now(30), joint=11)),
                          0.0, 0.0, HAND)  # fmt: skip
    assert struck_together(found) == "left_hand and right_hand"
