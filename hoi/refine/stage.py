"""Stage 3, whatever its loss: whether there is something to refine, and what came of it."""

from collections.abc import Callable

import torch

from hoi.data import Motion, Scene, State
from hoi.errors import RefineStopped
from hoi.refine.fidelity import Fidelity
from hoi.refine.meeting import Meeting, meet
from hoi.refine.window import Window, window_around
from hoi.reports import Stage


def refined(
    scene: Scene,
    state: State,
    window: Window | None,
    distance: float,
    improve: Callable[[Meeting], Motion],
    stage: Stage,
    needed_above: float | None = None,
) -> Motion:
    """The motion with theta improved around contact; as it was, where that is not needed or does not succeed.

    `stage` is told how deep the limb is in the object, how much of it touches and how far it is off, before and after
    (see `hoi.refine.fidelity.Fidelity`), or why nothing was done.

    Args:
        window: around the contact, see `contact_window`; None where there is nothing to refine.
        distance: d_contact [m].
        improve: makes a better motion of what meets in the window; may raise RefineStopped.
        needed_above: penetration up to which nothing is done, if the gap is no wider than d_contact [m]; None: whatever
            they are, something is.
    """
    motion, trajectory = state.motion, state.trajectory
    assert motion is not None and trajectory is not None
    if window is None:
        stage.notes.append("no contact: nothing to refine")
        return motion
    meeting = meet(scene, motion, trajectory, window)
    if meeting is None:
        stage.notes.append(f"the limb is not near the object at frame {window.t_c:.2f}: nothing to refine")
        return motion
    before = meeting.fidelity(motion, distance)
    tell(stage, before, "before")
    if needed_above is not None and good(before, distance, needed_above):
        deep = f"{before.penetration:.4f} m deep in the object, no more than {needed_above:g} m"
        stage.notes.append(f"not needed: the limb is {deep}, and {before.gap:.4f} m apart at t_c")
        return motion
    try:
        improved = improve(meeting)
    except (RefineStopped, MemoryError, torch.OutOfMemoryError) as error:
        reason = str(error) if isinstance(error, RefineStopped) else f"out of memory: {error}"
        stage.numbers["stopped"] = 1.0
        stage.notes.append(f"stopped, the motion from before is kept: {reason}")
        return motion
    tell(stage, meeting.fidelity(improved, distance), "after")
    return improved


def good(found: Fidelity, distance: float, tolerance: float) -> bool:
    """Whether a limb is no deeper in the object than `tolerance` and no farther off than d_contact = `distance` [m]."""
    return found.penetration <= tolerance and found.gap <= distance


class Nearest:
    """Of the motions that it is shown, keeps one that is good, else the nearest to touch; says when one is good."""

    def __init__(self, meeting: Meeting, distance: float, tolerance: float) -> None:
        self._meeting, self._distance, self._tolerance = meeting, distance, tolerance
        self._best = meeting.fidelity(meeting.motion, distance), meeting.motion

    def __call__(self, tried: Motion) -> bool:
        found = self._meeting.fidelity(tried, self._distance)
        self._best = min(self._best, (found, tried), key=self._rank)
        return self._is_good(found)

    def _is_good(self, found: Fidelity) -> bool:
        return good(found, self._distance, self._tolerance)

    def _rank(self, each: tuple[Fidelity, Motion]) -> tuple[bool, float]:
        return not self._is_good(each[0]), each[0].miss

    def kept(self, stage: Stage) -> Motion:
        found, motion = self._best
        if not self._is_good(found):
            how = f"{found.penetration:.4f} m deep, {found.gap:.4f} m apart at t_c"
            stage.notes.append(f"not out and touching: the nearest to it is kept, {how}")
        return motion


def contact_window(
    state: State, half_width: float, frames: int, *, whole_body: bool = False, tapered: bool = True
) -> Window | None:
    """Around the contact that pushes the object; None where none was found. See `hoi.refine.window.Window`.

    Where none was looked for, around the frame in which the joint should meet the object: t*, or the one after it.
    """
    if state.contact is None:
        meeting, push = state.target and (state.target.meeting_frame(frames), state.target.joint), None
    else:
        push = state.contact.push
        meeting = push and (push.frame, push.joint)
    if meeting is None:
        return None
    return window_around(*meeting, half_width, frames, push, whole_body=whole_body, tapered=tapered)


def tell(stage: Stage, fidelity: Fidelity, when: str) -> None:
    """Put the fidelity in the stage's numbers."""
    stage.numbers[f"penetration_{when}"] = fidelity.penetration
    stage.numbers[f"touching_{when}"] = fidelity.touching
    stage.numbers[f"gap_{when}"] = fidelity.gap
