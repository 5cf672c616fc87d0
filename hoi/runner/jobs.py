"""Runs of the method: what they share, what came of each, and its record."""

import math
import os
import re
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from omegaconf import OmegaConf

from hoi.body.parts import is_with, struck_together, struck_with
from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.body.skinning import posed_means
from hoi.config import Config, Device
from hoi.data import Array, Plan, Run, Scene, SceneObject, StageReport, State
from hoi.errors import InputError, RunError
from hoi.gaussians import colours
from hoi.method.attraction import REACHED, Batch
from hoi.method.optimization import RECALLED, Walk, computed_anew
from hoi.plan import format_plan
from hoi.record import Footage, write
from hoi.record.schemas import as_recorded
from hoi.reports import Bar, Stages, no_bar
from hoi.runner.provenance import provenance
from hoi.runner.scene import build_scene
from hoi.runner.shelf import Shelf

if TYPE_CHECKING:
    from hoi.render.encode import Video

LATE = 0.25
"""A contact so much before or after t* is that of another strike [s]."""


@dataclass(frozen=True)
class Job:
    """One run to do, and what its record says of it."""

    config: Config
    path: Path | None
    """Of the record; the video goes beside it, as .mp4. None: the run is not recorded."""
    config_yaml: str
    provenance: dict[str, str]
    tells: bool = True
    """Whether stderr is told what came of it."""


def run(
    jobs: Sequence[Job], plan: Plan, bar: Bar = no_bar, thing: SceneObject | None = None, shelf: Shelf | None = None
) -> list[Run]:
    """Walk the method with each job. The jobs differ in nothing but seed and path; those with a path are recorded.

    Args:
        bar: shows how a stage goes on.
        thing: the object, in place of the one that the config names.
        shelf: where what they have in common with other runs is found and kept.

    Raises:
        InputError: the config asks for what this machine has not, or a file turned out to be unusable.
        RunError: a run failed.

    Whatever ends a run once its stages have begun, also an InputError or a fault of ours: what it had is recorded at
    `run.failed.mcap` beside its path, and the others are done.
    """
    with torch_threads(jobs[0].config.threads):
        return _run(jobs, plan, bar, thing, shelf)


def begin(jobs: Sequence[Job], plan: Plan, bar: Bar, thing: SceneObject | None, shelf: Shelf | None) -> Walk:
    """The walk of the jobs, not begun. What `thing` is no key of the config says: nothing of it is shared."""
    config = jobs[0].config
    device, threads = pick_device(config.device), config.threads or os.cpu_count() or 1
    config.render.check_machine()
    seeds = [job.config.seed for job in jobs]
    scenes = [build_scene(job.config, plan, thing=thing) for job in jobs]
    move = config.stage.object.mover(config.object.size, threads, device)
    recall = computed_anew if shelf is None or thing is not None else shelf.recall(config, plan, seeds)
    stages, states = [Stages(bar) for _ in jobs], [State() for _ in jobs]
    return Walk(config, plan, Batch(scenes, seeds, device), move, stages, states, recall=recall)


def rehearse(config: Config, plan: Plan, bar: Bar, shelf: Shelf, overrides: list[str]) -> Iterator[Run]:
    """One run as far as it has come: with the person's motion, then with the object's answer too. Nothing is written.

    Args:
        shelf: where what it shares with others is found and kept.
        overrides: the command line of the config, for its record.

    Raises:
        InputError, RunError: as `run`.
    """
    started = time.perf_counter()
    text = OmegaConf.to_yaml(OmegaConf.structured(config), resolve=True)
    job = Job(config, None, text, provenance(OmegaConf.structured(config), overrides))
    with torch_threads(config.threads):
        walk = begin([job], plan, bar, None, shelf)
        walk.synthesise()
        walk.coordinate()
        yield so_far(walk, 0, job, result("going on", "", walk, 0, time.perf_counter() - started))
        walk.interact(0)
        said = outcome(config, plan, walk.states[0], walk.stages[0].reports)
        yield so_far(walk, 0, job, result("done", said, walk, 0, time.perf_counter() - started))


def _run(jobs: Sequence[Job], plan: Plan, bar: Bar, thing: SceneObject | None, shelf: Shelf | None) -> list[Run]:
    started = time.perf_counter()
    walk, failure = begin(jobs, plan, bar, thing, shelf), None
    try:
        walk.synthesise()
        walk.coordinate()
    except Exception as error:
        failure = ending(error)
    shared = (time.perf_counter() - started) / len(jobs)

    runs, failures = [], []
    for number, job in enumerate(jobs):
        finished, failed = finish(walk, number, job, failure, shared)
        runs.append(finished)
        if failed is not None:
            failures.append((job.config.seed, failed))
    kinds = {type(failed) for _, failed in failures}
    if len(jobs) > 1 and kinds and kinds <= {InputError, RunError}:
        what = "; ".join(f"seed {seed}: {failed}" for seed, failed in failures)
        kind = InputError if kinds == {InputError} else RunError
        raise kind(f"{len(failures)} of {len(jobs)} runs failed: {what}")
    for _, failed in failures:
        raise failed
    return runs


def finish(walk: Walk, number: int, job: Job, failure: Exception | None, shared: float) -> tuple[Run, Exception | None]:
    """The rest of a run, unless what it shares with others has ended in `failure` already; and its record.

    Args:
        shared: its part of the time that the runs have taken together [s].

    Returns:
        the run, and why it failed, if it did.
    """
    started = time.perf_counter()
    config, scene, stages = job.config, walk.batch.scenes[number], walk.stages[number]
    video = footage = None
    try:
        if failure is None:
            walk.interact(number)
            if walk.plan.keeps("render"):
                with stages.stage("render", scene.frames) as stage:
                    video, footage = config.render.draw(so_far(walk, number, job, {}), walk.batch.device, stage)
    except Exception as error:
        failure, video, footage = ending(error), None, None
    said = told(failure) if failure else outcome(config, walk.plan, walk.states[number], stages.reports)
    seconds = shared + time.perf_counter() - started
    finished = so_far(walk, number, job, result("failed" if failure else "done", said, walk, number, seconds))
    if job.path is not None:
        record(finished, job.path, config.human_points, video, footage)
        if job.tells:
            print(*scene.thing.notes, summary(finished.result), sep="\n", file=sys.stderr)
    return finished, failure


def so_far(walk: Walk, number: int, job: Job, result: dict[str, str]) -> Run:
    """A run of the walk, as far as it has come; its object as a record keeps it, so that what is shown is recorded."""
    stages, state = walk.stages[number], walk.states[number]
    if state.trajectory is not None:
        state = replace(state, trajectory=as_recorded(state.trajectory))
    return Run(
        job.config_yaml, job.provenance, result, walk.plan, tuple(stages.reports), tuple(stages.history),
        walk.batch.scenes[number], state,
    )  # fmt: skip


def result(status: str, said: str, walk: Walk, number: int, seconds: float) -> dict[str, str]:
    """What a record says came of a run of the walk, `seconds` after its begin; what it recalled counts as computed."""
    seconds += sum(report.seconds for report in walk.stages[number].reports if RECALLED in report.notes)
    return {
        "status": status,
        "outcome": said,
        "variant": walk.plan.variant,
        "device": walk.batch.device,
        "seconds": repr(seconds),
        "peak_memory_mb": repr(peak_memory_mb()),
    }


def record(run: Run, path: Path, human_points: int, video: "Video | None", footage: Footage | None) -> None:
    """Write the video and the record, `run.failed.mcap` of a run that failed.

    The record comes last: where it is, the run is finished, and its video there.
    """
    failed = run.result["status"] == "failed"
    path = path.with_name("run.failed.mcap") if failed else path
    if not failed:
        path.with_suffix(".mp4").unlink(missing_ok=True)  # of a run that this one replaces
    assert run.scene is not None
    if video is not None:
        from hoi.render.encode import write_mp4

        write_mp4(video, path.with_suffix(".mp4"))
    points = viewing_points(run.scene, run.state, human_points)
    write(run, path, *points, plan_text=format_plan(run.plan), footage=footage)


def ending(error: Exception) -> Exception:
    """What ended a run; of a lack of memory the remedy."""
    if isinstance(error, (MemoryError, torch.OutOfMemoryError)):
        return RunError(f"out of memory: {error}; use smaller budgets")
    return error


def told(failure: Exception) -> str:
    """Why a run failed, in one line; with its kind where that is a fault of ours."""
    said = "; ".join(str(failure).splitlines())
    return said if isinstance(failure, (InputError, RunError)) else f"{type(failure).__name__}: {said}"


def outcome(config: Config, plan: Plan, state: State, reports: Sequence[StageReport]) -> str:
    """What happened, in one sentence."""
    stopped = next((f"; stage 3 {r.notes[-1]}" for r in reports if "stopped" in r.numbers), "")
    return f"{reached(config, plan, state, reports)}{missed(state, config.scene.fps)}{stopped}"


def missed(state: State, fps: float) -> str:
    """Which strikes after the first did not meet the object, where contacts were looked for."""
    given = () if state.contact is None else state.contact.given
    said = ""
    for target in state.later if state.contact is not None else ():
        limbs = [set(limb) for limb in LIMBS.values() if target.joint in limb]
        near = [each for each in given if abs(each.frame - target.frame) <= LATE * fps]
        if not any(each.joint in limb for each in near for limb in limbs):
            said += f"; {JOINT_NAMES[target.joint]} did not meet the object at frame {target.frame}"
    return said


def reached(config: Config, plan: Plan, state: State, reports: Sequence[StageReport]) -> str:
    """What touched the object, and whether the limb got there."""
    gap = next((r.numbers["reach_gap"] for r in reports if "reach_gap" in r.numbers), 0.0)
    push = state.contact.push if state.contact else None
    if gap <= REACHED or state.target is None:
        return struck(config, plan, state)
    if push is not None and any({push.joint, state.target.joint} <= set(limb) for limb in LIMBS.values()):
        return struck(config, plan, state)  # a little later than it should have
    joint, frame = JOINT_NAMES[state.target.joint], state.target.frame
    return f"{struck(config, plan, state)}; {joint} could not reach the object: {gap:.3f} m short at frame {frame}"


def struck(config: Config, plan: Plan, state: State) -> str:
    """What touched the object, and what came of it."""
    search = state.contact
    if search is None:
        return "no contact looked for"
    push = search.push
    if push is None:
        separating = " (touched while separating)" if search.contacts else ""
        joint = search.smallest_gap_part or JOINT_NAMES[search.smallest_gap_joint]
        where = f"{search.smallest_gap:.3f} m at frame {search.smallest_gap_frame:.2f} ({joint})"
        return f"no contact{separating}: smallest gap {where}"
    wanted = config.scene.expected_limb
    if wanted not in LIMBS:
        limb = "no limb was named"
    else:
        limb = "as expected" if is_with(wanted, push.joint, push.part) else f"{wanted} was expected"
    speed = float(np.linalg.norm(push.v_post))
    what = f"contact by {struck_together(search)} ({limb}) at frame {push.frame:.2f}, v_post {speed:.2f} m/s"
    later = [
        f"{struck_with(each)} at frame {each.frame:.2f}, v_post {float(np.linalg.norm(each.v_post)):.2f} m/s"
        for each in search.given[1:]
    ]
    what = "; then ".join([what, *later])
    if plan.implementation("contact") != "collider" or state.trajectory is None or later:
        return what
    left = push.frame + push.duration * config.scene.fps
    after = state.trajectory.com_velocity[min(math.ceil(left), len(state.trajectory.com_velocity) - 1)]
    return f"{what}; pushed for {1000 * push.duration:.0f} ms, it then went at {np.linalg.norm(after):.2f} m/s"


def summary(result: dict[str, str]) -> str:
    seconds, memory = float(result["seconds"]), float(result["peak_memory_mb"])
    return f"{result['variant']}: {result['outcome']}; {seconds:.1f} s, {memory:.0f} MB"


def viewing_points(scene: Scene, state: State, count: int) -> tuple[Array | None, Array | None]:
    """A decimated posed person for the viewers: points (T, M, 3) [m], colours (M, 3) in [0, 1]; None without motion."""
    if state.motion is None:
        return None, None
    chosen = np.linspace(0, len(scene.body.cloud) - 1, min(count, len(scene.body.cloud))).astype(int)
    return posed_means(scene.body, state.motion, subset=chosen), colours(scene.body.cloud)[chosen]


def pick_device(wanted: Device) -> str:
    """ "cpu" or "cuda", for torch and Taichi alike.

    Raises:
        InputError: cuda was asked for and there is none.
    """
    if wanted is Device.cpu:
        return "cpu"
    if torch.cuda.is_available():
        return "cuda"
    if wanted is Device.cuda:
        raise InputError("device=cuda: no CUDA device found; use device=auto or device=cpu")
    return "cpu"


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """PyTorch works with so many threads in here; None leaves it as it is."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


PROCESS = Path("/proc/self")


def peak_memory_mb() -> float:
    """Highest resident memory of this process, where the system can tell since `forget_peak_memory` [MB]."""
    if (status := PROCESS / "status").exists():
        found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text())
        if found is not None:
            return int(found[1]) * 1.024e-3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def forget_peak_memory() -> None:
    """The next run's peak is its own, where the system lets us."""
    with suppress(OSError):
        (PROCESS / "clear_refs").write_text("5")
