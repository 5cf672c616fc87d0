"""Draw a motion from a sentence: what stage 1 of a run starts from.

    python -m hoi.runner.sample "a person kicks" -o kick.npz
    python -m hoi.runner.sample "a person kicks" -o kick.mcap --person woman

The .npz holds, as AMASS does, `poses` (T, 72) axis-angle of the 24 SMPL joints [rad], `trans` (T, 3) [m] and
`mocap_framerate`, besides `joints` (T, 24, 3) and `rest_joints` (24, 3) of the prior's own skeleton [m], `prompt` and
`seed`; Z up, starting at the origin facing +Y. `trans` is the world position of the pelvis *joint*: an SMPL layer whose
pelvis rests at J0 wants trans - J0.

The .mcap is a record with a person and no object, which `analysis.strip`, `hoi.render.video` and `hoi.record.read`
take. Exit codes: 0 done; 2 bad input; 3 the disk is full; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.data import Body, Motion, Plan, Plane, Run, Scene, State, Step
from hoi.errors import InputError, RunError
from hoi.files import whole_file
from hoi.terminal.program import program

if TYPE_CHECKING:
    from hoi.method.hmsd import ScoreDistillation
    from hoi.stages.motion.hmsd import HMSD

SUFFIXES = (".npz", ".mcap")
MOST_FRAMES = 4000
"""The denoiser has places for some thousand tokens."""
VIEWING_POINTS = 6000
FPS = 20.0
"""Of a scene whose prior is not loaded yet [1/s]."""


@dataclass(frozen=True)
class Drawing:
    """What a motion was drawn with."""

    scene: Scene
    distillation: ScoreDistillation
    settings: HMSD


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.runner.sample",
        description="Draw a motion from a sentence: an .npz as in AMASS, or a record with a person and no object.",
        epilog='example: python -m hoi.runner.sample "a person kicks" -o kick.mcap --person woman',
    )
    parser.add_argument("prompt")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".npz as in AMASS, or .mcap to look at")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--guidance", type=float, help="scale of the text (default: that of a run)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--prior", type=Path, help="a trained folder or an STMC checkpoint; default: the one shipped")
    parser.add_argument(
        "--clip", type=Path, help="for STMC, a Hugging Face folder of CLIP ViT-B/32; default: its clip/"
    )
    parser.add_argument("--person", default="man", help="who moves: one of the people in the package")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    return parser


def drawn(
    prompt: str,
    body: str | Body,
    seed: int,
    frames: int,
    checkpoint: str | Path | None = None,
    guidance: float | None = None,
    device: str = "cpu",
    clip: Path | None = None,
) -> tuple[Motion, Drawing]:
    """The motion that stage 1 of a run with this prompt, person and seed starts from; see `hoi.api.sample_motion`."""
    from hoi.body.people import load_person
    from hoi.config.compose import config_of
    from hoi.method.hmsd import sample_motions
    from hoi.stages.motion.hmsd import HMSD

    if not 3 <= frames <= MOST_FRAMES:
        raise InputError(f"frames {frames}: must be at least 3, and at most {MOST_FRAMES}")
    settings = config_of("stage/motion=hmsd").stage.motion
    assert isinstance(settings, HMSD)
    settings = replace(settings, checkpoint=None if checkpoint is None else str(checkpoint))
    if guidance is not None:
        settings = replace(settings, sample_guidance=guidance)
    person = load_person(body, seed=seed) if isinstance(body, str) else body
    ground, gravity = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), np.array([0.0, 0.0, -9.81])
    scene = Scene("sample", person, None, prompt, frames, FPS, gravity, (ground,))
    distillation = settings.prior(scene, device, False, clip)
    scene = replace(scene, fps=distillation.prior.fps)
    (motion,) = sample_motions(distillation, settings.sampling, frames, distillation.prior.fps, [seed])
    return motion, Drawing(scene, distillation, settings)


def sample(options: argparse.Namespace) -> None:
    """Draw and write.

    Raises:
        InputError: an option is out of range, the prior cannot be loaded, or the file not written.
        RunError: the disk is full.
    """
    import torch

    from hoi import record
    from hoi.config.validate import LARGEST
    from hoi.motion.familiarity import sentence_check
    from hoi.runner.jobs import viewing_points

    started = time.perf_counter()
    if options.out.suffix not in SUFFIXES:
        raise InputError(f"--out {options.out}: must end in {' or '.join(SUFFIXES)}")
    if not 3 <= options.frames <= MOST_FRAMES:
        raise InputError(f"--frames {options.frames}: must be at least 3, and at most {MOST_FRAMES}")
    if not 0 <= options.seed <= LARGEST:
        raise InputError(f"--seed must be in [0, {LARGEST}], got {options.seed}")
    try:
        options.prompt.encode()
    except UnicodeEncodeError:
        raise InputError(f"prompt: {options.prompt!r} holds bytes that are no text in UTF-8") from None
    if options.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: no CUDA device found")
    if (said := sentence_check(options.prompt, None if options.prior is None else str(options.prior))) is not None:
        print(f"sentence: {' '.join(said)}", flush=True)
    given = (options.prompt, options.person, options.seed, options.frames, options.prior, options.guidance)
    try:
        motion, drawing = drawn(*given, options.device, options.clip)
    except RunError as error:
        guidance = "" if options.guidance is None else f" {options.guidance:g}"
        raise InputError(f"--guidance{guidance}: the motion is not finite; a smaller one gives one that is") from error
    if options.out.suffix == ".npz":
        _write_npz(options, drawing)
    else:
        run = run_of(motion, drawing, options.seed, time.perf_counter() - started)
        points = viewing_points(drawing.scene, run.state, VIEWING_POINTS)
        record.write(run, options.out, *points, plan_text=f"motion  {run.plan.steps[0].reason}\n")


def run_of(motion: Motion, drawing: Drawing, seed: int, seconds: float) -> Run:
    """A record's content: a person on the ground, and no object."""
    prior, settings = drawing.distillation.prior, drawing.settings
    steps = min(settings.sample_steps or prior.timesteps, prior.timesteps)
    said = f"{prior.source}: {steps} steps of {settings.sampler.value} sampling, guidance {settings.sample_guidance:g}"
    facts = {"seed": str(seed), "scene": "sample", "experiment": "sample", "ablation": "full", "config_hash": ""}
    result = {"status": "done", "outcome": "a motion without an object", "variant": "sample", "seconds": repr(seconds)}
    return Run(
        config_yaml="",
        provenance=facts,
        result=result,
        plan=Plan("sample", (Step("motion", "sample", said),), (), ()),
        reports=(),
        history=(),
        scene=drawing.scene,
        state=State(motion=motion),
    )


def _write_npz(options: argparse.Namespace, drawing: Drawing) -> None:
    """On the prior's own skeleton."""
    import roma

    from hoi.body.kinematics import forward_kinematics, local_rotations
    from hoi.method.hmsd import sample_features
    from hoi.motion.features import decode

    prior = drawing.distillation.prior
    (features,) = sample_features(drawing.distillation, drawing.settings.sampling, options.frames, [options.seed]).cpu()
    translation, *turns = decode(features)
    local, rest_joints = local_rotations(*turns), prior.rest_joints.cpu()
    _, joints = forward_kinematics(local, translation, rest_joints)
    with whole_file(options.out) as part, part.open("wb") as file:
        np.savez(
            file,
            poses=roma.rotmat_to_rotvec(local).flatten(1).numpy(),
            trans=translation.numpy(),
            mocap_framerate=np.array(prior.fps),
            joints=joints.numpy(),
            rest_joints=rest_joints.numpy(),
            prompt=np.array(options.prompt),
            seed=np.array(options.seed),
        )


def main() -> int:
    try:
        sample(parser().parse_args())
    except (InputError, RunError) as error:
        print(f"sample: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    return 0


if __name__ == "__main__":
    program(main)
