"""The method, stage by stage (paper, Method), over a plan; and its record."""

import math
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.config import (
    Approach,
    Config,
    ContactModel,
    Device,
    HMSDConf,
    ImpulseConf,
    RenderBackend,
    RenderConf,
    VideoConf,
    WindowConf,
)
from hoi.data import Array, Motion, Plan, Run, Scene, StageReport, State
from hoi.errors import InputError, RunError, under
from hoi.gaussians import colours
from hoi.method import movers
from hoi.method.contact import find_contact
from hoi.method.coordination import REACHED, coordinate, meet
from hoi.method.limb_collider import limb_collider
from hoi.method.scene import build_scene
from hoi.plan import format_plan, uses_prior
from hoi.record import Footage, write
from hoi.runner.progress import Stage, Stages, shared_stage

if TYPE_CHECKING:
    from hoi.render.encode import Video

FAILURES = (RunError, MemoryError, torch.OutOfMemoryError)


def agents(
    config: Config,
    plan: Plan,
    scenes: Sequence[Scene],
    seeds: Sequence[int],
    move: movers.Mover,
    device: str,
    stages: Sequence[Stages],
) -> Iterator[list[State]]:
    """Yields the states after each stage: object alone, human alone, human meets object.

    One scene, one seed, one state a run: the runs share the object's free motion and move their persons as one batch.
    """
    conf = config.stage
    motions = [stand_motion(scene.body, scene.frames, scene.fps) for scene in scenes]

    # Agent Motion Synthesis: the object's free motion ...
    with shared_stage(stages, "free motion", config.scene.frames - 1) as (stage, *others):
        trajectory, restarts = movers.free_motion(
            scenes[0], move if plan.keeps("free_motion") else movers.at_rest, stage
        )
        for other in others:
            other.numbers.update(stage.numbers)
            other.notes.extend(stage.notes)
    yield (states := [State(motion, trajectory, restarts) for motion in motions])

    # ... and the human's, distilled from the motion prior.
    distillation = None
    if isinstance(conf.motion, HMSDConf):
        from hoi.method.synthesis import load_distillation, synthesise

        with shared_stage(stages, "motion", conf.motion.iterations) as each:
            if uses_prior(config):
                stand = config.scene.approach is Approach.stand
                distillation = load_distillation(scenes[0], conf.motion, device, stand)
            motions = synthesise(scenes[0], distillation, conf.motion, seeds, device, each)
        yield (states := with_motions(states, motions))

    # Physically-Aware Interaction Synthesis: windowed attraction.
    met = [meet(scene, motion, trajectory, config) for scene, motion in zip(scenes, motions, strict=True)]
    motions, targets = [motion for motion, _ in met], [target for _, target in met]
    states = [replace(state, target=target) for state, target in zip(states, targets, strict=True)]
    if plan.keeps("coordinate"):
        with shared_stage(stages, "coordinate", conf.coordinate.iterations) as each:
            motions = coordinate(scenes, motions, trajectory, targets, distillation, config, seeds, device, each)
    yield with_motions(states, motions)


def with_motions(states: Sequence[State], motions: Sequence[Motion]) -> list[State]:
    return [replace(state, motion=motion) for state, motion in zip(states, motions, strict=True)]


def interaction(
    config: Config, plan: Plan, scene: Scene, state: State, move: movers.Mover, device: str, stages: Stages
) -> Iterator[State]:
    """Yields the state of a run after each further stage: the object answers, the contact looks right."""
    motion, trajectory, contact = state.motion, state.trajectory, config.stage.contact
    assert motion is not None and trajectory is not None

    # Contact detection and re-simulation.
    if isinstance(contact, ImpulseConf):
        with stages.stage("contact", 1):
            search = find_contact(
                scene.body,
                motion,
                joint_paths(scene.body, motion),
                trajectory,
                len(scene.thing.cloud),
                mass=float(scene.thing.masses.sum()),
                restitution=scene.thing.material.restitution,
                tau=contact.tau,
                distance=contact.distance,
                between_frames=contact.between_frames,
            )
        yield (state := replace(state, contact=search))
        if (push := search.push) is not None:
            with stages.stage("resimulate", scene.frames - int(push.frame)) as stage:
                if contact.model is ContactModel.collider:
                    collider, notes = limb_collider(scene, motion, trajectory, push, contact)
                    stage.notes.extend(notes)
                    trajectory, pushed = movers.push(scene, trajectory, state.restarts, push, collider, move, stage)
                    contacts = tuple(pushed if each is push else each for each in search.contacts)
                    state = replace(state, contact=replace(search, contacts=contacts))
                else:
                    trajectory = movers.resimulate(scene, trajectory, state.restarts, push, move, stage)
            yield (state := replace(state, trajectory=trajectory))

    # Video-SDS for Contact Fidelity: theta of the frames around contact; the object's trajectory is held fixed.
    if plan.keeps("refine") and isinstance(config.stage.refine, WindowConf):
        from hoi.method.refine_stage import refine

        with stages.stage("refine", config.stage.refine.iterations) as stage:
            motion = refine(scene, state, config, device, stage)
        yield replace(state, motion=motion)


@dataclass(frozen=True)
class Job:
    """One run to do, and what its record says of it."""

    config: Config
    path: Path
    """Of the record; the video goes beside it, as .mp4."""
    config_yaml: str
    provenance: dict[str, str]


def run(jobs: Sequence[Job], plan: Plan) -> list[Run]:
    """Walk the method with each job, and record it. The jobs differ in nothing but seed and path.

    Raises:
        InputError: the config asks for what this machine has not.
        RunError: a run failed; what it had is recorded at `run.failed.mcap` beside its path. The others are done.
    """
    started = time.perf_counter()
    config = jobs[0].config
    device = pick_device(config.device)
    torch.set_num_threads(config.threads or torch.get_num_threads())
    check_renderer(config.render)
    scenes = [build_scene(job.config) for job in jobs]
    move = movers.mover(config, device)
    stages = [Stages() for _ in jobs]
    states, failure = [State() for _ in jobs], None
    try:
        seeds = [job.config.seed for job in jobs]
        for reached in agents(config, plan, scenes, seeds, move, device, stages):
            states = reached
    except FAILURES as error:
        failure = run_error(error)
    shared = (time.perf_counter() - started) / len(jobs)

    runs, failures = [], []
    for job, scene, state, own in zip(jobs, scenes, states, stages, strict=True):
        so_far = Run(job.config_yaml, job.provenance, {}, plan, (), (), scene, state)
        finished, failed = finish(so_far, job, move, device, own, failure, shared)
        runs.append(finished)
        if failed is not None:
            failures.append((job.config.seed, failed))
    if len(jobs) > 1 and failures:
        what = "; ".join(f"seed {seed}: {failed}" for seed, failed in failures)
        raise RunError(f"{len(failures)} of {len(jobs)} runs failed: {what}")
    for _, failed in failures:
        raise failed
    return runs


def finish(
    run: Run, job: Job, move: movers.Mover, device: str, stages: Stages, failure: RunError | None, shared: float
) -> tuple[Run, RunError | None]:
    """The rest of a run, unless what it shares with others has ended in `failure` already; and its record.

    Args:
        shared: its part of the time that the runs have taken together [s].

    Returns:
        the run, and why it failed, if it did.
    """
    started = time.perf_counter()
    config, scene = job.config, run.scene
    assert scene is not None
    video = footage = None
    try:
        if failure is None:
            for state in interaction(config, run.plan, scene, run.state, move, device, stages):
                run = replace(run, state=state)
            if isinstance(config.render, VideoConf):
                with stages.stage("render", scene.frames) as stage:
                    video, footage = draw(run, config.render, device, stage)
    except FAILURES as error:
        failure, video, footage = run_error(error), None, None
    result = {
        "status": "failed" if failure else "done",
        "outcome": str(failure) if failure else outcome(config, run.state, stages.reports),
        "variant": run.plan.variant,
        "device": device,
        "seconds": repr(shared + time.perf_counter() - started),
        "peak_memory_mb": repr(peak_memory_mb()),
    }
    run = replace(
        run,
        result=result,
        reports=tuple(stages.reports),
        history=tuple(stages.history),
        state=replace(run.state, restarts=()),
    )
    record(run, job, video, footage)
    return run, failure


def record(run: Run, job: Job, video: "Video | None", footage: Footage | None) -> None:
    """Write the video and the record, `run.failed.mcap` of a run that failed; say what came of it.

    The record comes last: where it is, the run is finished, and its video there.
    """
    failed = run.result["status"] == "failed"
    path = job.path.with_name("run.failed.mcap") if failed else job.path
    if not failed:
        path.with_suffix(".mp4").unlink(missing_ok=True)  # of a run that this one replaces
    assert run.scene is not None
    if video is not None:
        from hoi.render.encode import write_mp4

        write_mp4(video, path.with_suffix(".mp4"))
    points = viewing_points(run.scene, run.state, job.config.human_points)
    write(run, path, *points, plan_text=format_plan(run.plan), footage=footage)
    for line in (*run.scene.thing.notes, summary(run.result)):
        print(line, file=sys.stderr)


def run_error(error: Exception) -> RunError:
    """What ended a run, as one line with a remedy."""
    return error if isinstance(error, RunError) else RunError(f"out of memory: {error}; use smaller budgets")


def draw(run: Run, conf: VideoConf, device: str, stage: Stage) -> tuple["Video", Footage]:
    """The video of a run, and what of it belongs in the record.

    Raises:
        RunError: the run cannot be drawn.
    """
    started = time.perf_counter()
    from hoi.render.encode import encode
    from hoi.render.film import cameras_of, film
    from hoi.render.replay import replay

    def counted(pictures: Iterator[Any]) -> Iterator[Any]:
        for picture in pictures:
            yield picture
            stage.advance()

    try:
        shown = replay(run, device)
        cameras = cameras_of(shown, conf.view.value, conf.width, conf.height)
        pictures = film(shown, cameras, sh_degree=conf.sh_degree, backend=conf.backend.value, device=device)
        video = encode(counted(pictures), shown.fps)
    except InputError as error:  # what was put in has been checked: it is the run that cannot be drawn
        raise RunError(f"render: {error}; render=none runs without a video") from error
    stage.numbers["frames_per_second"] = len(video) / (time.perf_counter() - started)
    return video, Footage(video.units, tuple(cameras))


def check_renderer(conf: RenderConf) -> None:
    """Find out now, and not when all is computed, whether the pictures can be drawn.

    Raises:
        InputError: the backend cannot run here.
    """
    if isinstance(conf, VideoConf) and conf.backend is RenderBackend.gsplat:
        from hoi.render.gsplat_backend import load_gsplat

        with under("render"):
            load_gsplat()


def outcome(config: Config, state: State, reports: Sequence[StageReport]) -> str:
    """What happened, in one sentence."""
    stopped = next((f"; stage 3 {r.notes[-1]}" for r in reports if "stopped" in r.numbers), "")
    return f"{reached(config, state, reports)}{stopped}"


def reached(config: Config, state: State, reports: Sequence[StageReport]) -> str:
    """What touched the object, and whether the limb got there."""
    gap = next((r.numbers["reach_gap"] for r in reports if "reach_gap" in r.numbers), 0.0)
    push = state.contact.push if state.contact else None
    if gap <= REACHED or state.target is None:
        return struck(config, state)
    if push is not None and any({push.joint, state.target.joint} <= set(limb) for limb in LIMBS.values()):
        return struck(config, state)  # a little later than it should have
    joint, frame = JOINT_NAMES[state.target.joint], state.target.frame
    return f"{struck(config, state)}; {joint} could not reach the object: {gap:.3f} m short at frame {frame}"


def struck(config: Config, state: State) -> str:
    """What touched the object, and what came of it."""
    search = state.contact
    if search is None:
        return "no contact looked for"
    push = search.push
    if push is None:
        separating = " (touched while separating)" if search.contacts else ""
        joint = JOINT_NAMES[search.smallest_gap_joint]
        where = f"{search.smallest_gap:.3f} m at frame {search.smallest_gap_frame:.2f} ({joint})"
        return f"no contact{separating}: smallest gap {where}"
    expected = push.joint in LIMBS[config.scene.expected_limb]
    limb = "as expected" if expected else f"{config.scene.expected_limb} was expected"
    speed = float(np.linalg.norm(push.v_post))
    what = f"contact by {JOINT_NAMES[push.joint]} ({limb}) at frame {push.frame:.2f}, v_post {speed:.2f} m/s"
    contact = config.stage.contact
    if not isinstance(contact, ImpulseConf) or contact.model is ContactModel.impulse or state.trajectory is None:
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


def peak_memory_mb() -> float:
    """Highest resident memory of this process so far [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3
