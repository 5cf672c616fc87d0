"""Compose, choose the clip, replay it, record it."""

import hashlib
import sys
import time
from dataclasses import replace
from pathlib import Path

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, Ablation, Config, register
from hoi.config.compose import one_line
from hoi.config.validate import to_config, with_materials
from hoi.data import Plan, Run, Step
from hoi.errors import InputError, RunError
from hoi.motion.text import default_cache, minilm
from hoi.plan import make_plan
from hoi.reports import Stages
from hoi.runner.arguments import arguments
from hoi.runner.execute import RECORD, already_there
from hoi.runner.jobs import outcome, peak_memory_mb, pick_device, record, torch_threads
from hoi.runner.provenance import provenance
from hoi.runner.scene import build_scene
from hoi.terminal.progress import bar

from .clips import Clip, clips_of, nearest, shipped_clips, with_mirrored
from .replay import replayed

VARIANT, EXPERIMENT = "kinematic replay", "baseline"
OUT = "runs/${scene.name}/baseline/kinematic_replay/s${seed}"


def execute(composed: DictConfig, overrides: list[str], folder: Path | None) -> Path:
    """The baseline's record for a composed config.

    Args:
        folder: of the clips; None takes the shipped ones.

    Returns:
        the record.

    Raises:
        InputError: bad input, before anything is written.
        RunError: the run failed.
    """
    started = time.perf_counter()
    composed = with_materials(composed)
    composed.experiment = EXPERIMENT
    config = to_config(composed)
    if config.ablation is not Ablation.full or config.stage.contact.name == "none":
        raise InputError(f"ablation={config.ablation.value}: the baseline has no parts to leave out; say ablation=full")
    clips = with_mirrored(shipped_clips() if folder is None else clips_of(folder))
    clip, caption, likeness = nearest(config.scene.motion_prompt, clips, minilm(default_cache()))
    facts = provenance(composed, overrides) | {"ablation": "", "clip": clip.name, "clip_caption": caption}
    facts["config_hash"] = hashlib.sha256("\n".join([facts["config_hash"], VARIANT, clip.name]).encode()).hexdigest()
    path = Path(config.out) / RECORD
    if already_there(config, path, facts["config_hash"]):
        print(f"{path}: already computed with this config (overwrite=true computes it again)")
        return path
    path.parent.mkdir(parents=True, exist_ok=True)

    stages, device = Stages(bar), pick_device(config.device)
    scene, plan = build_scene(config), plan_of(config, clip, caption, likeness)
    video = footage = None
    with torch_threads(config.threads):
        with stages.stage("motion", 1) as stage:
            whole = clip.load(scene.body, scene.fps)
            stage.numbers["likeness"] = likeness
            stage.notes.append(f"{clip.name}: {caption!r}")
        state = replayed(config, scene, whole, stages)
        run = Run(OmegaConf.to_yaml(composed, resolve=True), facts, {}, plan, (), (), scene, state)
        if plan.keeps("render"):
            with stages.stage("render", scene.frames) as stage:
                video, footage = config.render.draw(run, device, stage)
    result = {
        "status": "done",
        "outcome": outcome(config, plan, state, stages.reports),
        "variant": VARIANT,
        "device": device,
        "seconds": repr(time.perf_counter() - started),
        "peak_memory_mb": repr(peak_memory_mb()),
    }
    run = replace(run, result=result, reports=tuple(stages.reports), history=tuple(stages.history))
    record(run, path, config.human_points, video, footage)
    return path


def plan_of(config: Config, clip: Clip, caption: str, likeness: float) -> Plan:
    """What is done, for the record and its table."""
    steps = [
        Step("motion", "motion capture", f"{clip.name}: {caption!r} is nearest to the prompt, cosine {likeness:.3f}"),
        Step("free_motion", "closed form", "free fall or a straight line until something touches the object"),
        Step("contact", "distance", "the test of all runs; the object takes the velocity of what touched it"),
    ]
    if backend := make_plan(config).implementation("render"):
        steps.append(Step("render", backend, "asked for"))
    return Plan(VARIANT, tuple(steps), (), ())


def compose_and_execute(folder: Path | None) -> int:
    """All jobs of the command line, each whether or not another fails; the exit code."""
    register()
    code = 0

    def job(composed: DictConfig) -> None:
        nonlocal code
        from hydra.core.hydra_config import HydraConfig

        try:
            print(f"recorded {execute(composed, list(HydraConfig.get().overrides.task), folder)}")
        except (InputError, RunError) as error:
            print(f"baseline: {error}", file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 3)

    try:
        sys.argv[1:] = arguments(sys.argv[1:])
        hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)()
    except (InputError, HydraException, OmegaConfBaseException) as error:
        print(f"baseline: {one_line(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        print(f"baseline: {error.filename}: {error.strerror}", file=sys.stderr)
        code = 2
    return code
