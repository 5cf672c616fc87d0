"""The method, stage by stage (paper, Method), over a plan; and its record."""

import math
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hoi import movers
from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.collision import limb_collider
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
)
from hoi.contact import find_contact
from hoi.coordination import REACHED, coordinate, find_target
from hoi.data import Array, Plan, Run, Scene, StageReport, State
from hoi.errors import InputError, RunError
from hoi.gaussians import colours
from hoi.plan import format_plan, uses_prior
from hoi.progress import Stage, Stages
from hoi.record import Footage, write
from hoi.scene import build_scene

if TYPE_CHECKING:
    from hoi.render.encode import Video


def method(config: Config, plan: Plan, scene: Scene, device: str, stages: Stages) -> Iterator[State]:
    """Yields the state after each stage: object alone, human alone, human meets object, object answers."""
    move = movers.mover(config, device)
    motion = stand_motion(scene.body, scene.frames, scene.fps)

    # Agent Motion Synthesis: the object's free motion ...
    with stages.stage("free motion", scene.frames - 1) as stage:
        trajectory, states = movers.free_motion(scene, move if plan.keeps("free_motion") else movers.at_rest, stage)
    yield (state := State(motion=motion, trajectory=trajectory))

    # ... and the human's, distilled from the motion prior.
    distillation = None
    if isinstance(config.stage.motion, HMSDConf):
        from hoi.motion.synthesis import load_distillation, synthesise

        with stages.stage("motion", config.stage.motion.iterations) as stage:
            if uses_prior(config):
                stand = config.scene.approach is Approach.stand
                distillation = load_distillation(scene, config.stage.motion, device, stand)
            motion = synthesise(scene, distillation, config.stage.motion, config.seed, device, stage)
        yield (state := replace(state, motion=motion))

    # Physically-Aware Interaction Synthesis: windowed attraction ...
    target = find_target(scene, motion, config)
    if plan.keeps("coordinate"):
        with stages.stage("coordinate", config.stage.coordinate.iterations) as stage:
            motion = coordinate(scene, motion, trajectory, target, distillation, config, device, stage)
    yield (state := replace(state, motion=motion, target=target))

    # ... contact detection and re-simulation.
    contact = config.stage.contact
    if isinstance(contact, ImpulseConf):
        with stages.stage("contact", 1):
            search = find_contact(
                scene.body,
                motion,
                joint_paths(scene.body, motion),
                trajectory,
                len(scene.object.cloud),
                mass=float(scene.object.masses.sum()),
                restitution=scene.object.material.restitution,
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
                    trajectory, pushed = movers.push(scene, trajectory, states, push, collider, move, stage)
                    contacts = tuple(pushed if each is push else each for each in search.contacts)
                    state = replace(state, contact=replace(search, contacts=contacts))
                else:
                    trajectory = movers.resimulate(scene, trajectory, states, push, move, stage)
            yield replace(state, trajectory=trajectory)


def run(config: Config, plan: Plan, path: Path, config_yaml: str, provenance: dict[str, str]) -> Run:
    """Walk the method, record it at `path`, and put its video beside it as .mp4.

    Raises:
        InputError: the config asks for what this machine has not.
        RunError: the run failed; what it had is recorded at `run.failed.mcap` beside `path`.
    """
    started = time.perf_counter()
    device = pick_device(config.device)
    torch.set_num_threads(config.threads or torch.get_num_threads())
    check_renderer(config.render)
    scene = build_scene(config)
    stages = Stages()
    finished = Run(config_yaml, provenance, {}, plan, (), (), scene, State())
    video = footage = None
    failure: RunError | None = None
    try:
        for state in method(config, plan, scene, device, stages):
            finished = replace(finished, state=state)
        if isinstance(config.render, VideoConf):
            with stages.stage("render", scene.frames) as stage:
                video, footage = draw(finished, config.render, device, stage)
    except (RunError, MemoryError, torch.OutOfMemoryError) as error:
        failure = error if isinstance(error, RunError) else RunError(f"out of memory: {error}; use smaller budgets")
    result = {
        "status": "failed" if failure else "done",
        "outcome": str(failure) if failure else outcome(config, finished.state, stages.reports),
        "variant": plan.variant,
        "device": device,
        "seconds": repr(time.perf_counter() - started),
        "peak_memory_mb": repr(peak_memory_mb()),
    }
    finished = replace(finished, result=result, reports=tuple(stages.reports), history=tuple(stages.history))
    if failure:
        path = path.with_name("run.failed.mcap")
    else:
        path.with_suffix(".mp4").unlink(missing_ok=True)  # of a run that this one replaces
    points = viewing_points(scene, finished.state, config.human_points)
    write(finished, path, *points, plan_text=format_plan(plan), footage=None if failure else footage)
    if video is not None and not failure:
        from hoi.render.encode import write_mp4

        write_mp4(video, path.with_suffix(".mp4"))
    for line in (*scene.object.notes, summary(result)):
        print(line, file=sys.stderr)
    if failure:
        raise failure
    return finished


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

        try:
            load_gsplat()
        except InputError as error:
            raise InputError(f"render.{error}") from None


def outcome(config: Config, state: State, reports: Sequence[StageReport]) -> str:
    """What happened, in one sentence."""
    gap = next((r.numbers["reach_gap"] for r in reports if "reach_gap" in r.numbers), 0.0)
    if gap <= REACHED or state.target is None:
        return struck(config, state)
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
