"""Stage 3 of the method (paper, Video-SDS for Contact Fidelity), whatever its loss."""

import torch

from hoi.config import Config, ImpulseConf, RefineWhen, VideoSDSConf, WindowConf
from hoi.data import Motion, Scene, State
from hoi.errors import RefineStopped
from hoi.method.attraction import meeting_frame
from hoi.refine.fidelity import Fidelity
from hoi.refine.geometric import Geometry, minimise
from hoi.refine.meeting import meet
from hoi.refine.window import Window, WindowedPose, window_around
from hoi.runner.progress import Stage

D_CONTACT = 0.01
"""d_contact where no contact is looked for [m]."""


def refine(scene: Scene, state: State, config: Config, device: str, stage: Stage) -> Motion:
    """The motion with theta refined around contact; the motion as it was, where that is not needed or does not succeed.

    `stage` is told how deep the limb is in the object, how much of it touches and how far it is off, before and after
    (see `hoi.refine.fidelity.Fidelity`), or why nothing was done.
    """
    conf, motion, trajectory = config.stage.refine, state.motion, state.trajectory
    assert isinstance(conf, WindowConf) and motion is not None and trajectory is not None
    window = contact_window(state, conf.half_width, scene.frames)
    if window is None:
        stage.notes.append("no contact: nothing to refine")
        return motion
    meeting = meet(scene, motion, trajectory, window)
    if meeting is None:
        stage.notes.append(f"the limb is not near the object at frame {window.t_c:.2f}: nothing to refine")
        return motion
    contact = config.stage.contact
    distance = contact.distance if isinstance(contact, ImpulseConf) else D_CONTACT
    before = meeting.fidelity(motion, distance)
    tell(stage, before, "before")
    if conf.when is RefineWhen.needed and before.penetration <= conf.tolerance:
        deep = f"{before.penetration:.4f} m deep in the object, no more than {conf.tolerance:g} m"
        stage.notes.append(f"not needed: the limb is {deep}")
        return motion
    try:
        if isinstance(conf, VideoSDSConf):
            from hoi.method.video_sds import video_sds

            best = before, motion

            def enough(tried: Motion) -> bool:
                nonlocal best
                found = meeting.fidelity(tried, distance)
                best = min(best, (found, tried), key=lambda each: each[0].miss)
                return found.penetration <= conf.tolerance

            if conf.when is RefineWhen.needed:
                video_sds(scene, motion, trajectory, window, config, device, stage, enough)
                kept, refined = best
                if kept.penetration > conf.tolerance:
                    found = f"{kept.penetration:.4f} m deep, {kept.gap:.4f} m apart at t_c"
                    stage.notes.append(f"not out and touching: the nearest to it is kept, {found}")
            else:
                refined = video_sds(scene, motion, trajectory, window, config, device, stage)
        else:
            pose = WindowedPose(motion, window, device)
            minimise(pose, Geometry(meeting, conf, device), conf, stage)
            refined = pose.motion()
    except (RefineStopped, MemoryError, torch.OutOfMemoryError) as error:
        reason = str(error) if isinstance(error, RefineStopped) else f"out of memory: {error}"
        stage.numbers["stopped"] = 1.0
        stage.notes.append(f"stopped, the motion from before is kept: {reason}")
        return motion
    tell(stage, meeting.fidelity(refined, distance), "after")
    return refined


def contact_window(state: State, half_width: float, frames: int) -> Window | None:
    """Around the contact that pushes the object; None where none was found.

    Where none was looked for, around the frame in which the joint should meet the object: t*, or the one after it.
    """
    if state.contact is None:
        target = state.target
        return target and window_around(meeting_frame(frames, target), target.joint, half_width, frames)
    push = state.contact.push
    return push and window_around(push.frame, push.joint, half_width, frames, push)


def tell(stage: Stage, fidelity: Fidelity, when: str) -> None:
    """Put the fidelity in the stage's numbers."""
    stage.numbers[f"penetration_{when}"] = fidelity.penetration
    stage.numbers[f"touching_{when}"] = fidelity.touching
    stage.numbers[f"gap_{when}"] = fidelity.gap
