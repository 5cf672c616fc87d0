"""What of a run can be seen."""

from pathlib import Path

from hoi.data import Run, Scene
from hoi.errors import InputError


def scene_of(run: Run, path: Path | None = None) -> Scene:
    """The scene of a run that shows a person, an object or both.

    Args:
        path: of its record, for the error.

    Raises:
        InputError: it has neither a motion nor a trajectory, or they differ in length.
    """
    name, motion, trajectory = path or "the run", run.state.motion, run.state.trajectory
    if run.scene is None or (motion is None and trajectory is None):
        raise InputError(f"{name} has neither a motion nor a trajectory to show (status {run.result.get('status')})")
    if motion is not None and trajectory is not None and len(motion) != len(trajectory.positions):
        raise InputError(
            f"{name} has {len(motion)} frames of motion, {len(trajectory.positions)} of the trajectory; they must agree"
        )
    return run.scene
