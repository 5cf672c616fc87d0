"""One output of another system -> one record."""

import argparse
import hashlib
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from omegaconf import DictConfig, OmegaConf

from hoi.body.skeleton import JOINT_COUNT
from hoi.config import CONF, Ablation, Config
from hoi.config.compose import composed as composed_of
from hoi.config.validate import to_config
from hoi.data import Array, Body, ContactSearch, GaussianCloud, ObjectTrajectory, Plan, Run, Scene, State, Step
from hoi.errors import InputError
from hoi.plan import format_plan, material_of
from hoi.record import write
from hoi.render.encode import write_mp4
from hoi.runner.provenance import provenance
from hoi.runner.scene import planes_of

from . import meshes
from .contact import centre_of_mass_path, find_contact, velocity
from .points import SKIN_POINTS, in_our_world, object_of, tracked_points, triangle_areas
from .videos import read_video

EXPERIMENT = "baseline"
PHASE = "ingested"


@dataclass(frozen=True)
class Meshes:
    """What the physical metrics need."""

    scene: Scene
    state: State
    skin: Array
    """(T, M, 3) [m]."""
    skin_colours: Array
    """(M, 3)."""


def ingest(options: argparse.Namespace) -> Path:
    """Write the record.

    Returns:
        its path.

    Raises:
        InputError: one line: a bad option, or a file that is broken or not of its kind.
        RunError: the disk is full or broken.
    """
    _check(options)
    composed = _scene_config(options.scene)
    slug = re.sub(r"[^a-z0-9]+", "_", options.system.lower()).strip("_")
    path = options.out or Path("runs") / composed.scene.name / EXPERIMENT / slug / f"s{options.seed}" / "run.mcap"
    if path.exists() and not options.overwrite:
        raise InputError(f"{path} is there already; choose another -o or say --overwrite")
    fps = options.fps or float(composed.scene.fps)
    video = footage = None
    if options.video is not None:
        video, footage = read_video(options.video, None if options.person else options.fps)
    for name in ("motion_prompt", "scene_prompt") if options.prompt else ():
        composed.scene[name] = options.prompt
    if options.person is not None:
        person, thing = _meshes(options, fps)
        frames, rate = len(person.vertices), person.fps or thing.fps or fps
    else:
        assert video is not None  # by `_check`
        person = thing = None
        frames, rate = len(video), float(video.fps)
    composed.scene.fps, composed.scene.frames, composed.seed = rate, frames, options.seed
    composed.scene.contact_frame = min(composed.scene.contact_frame, max(frames - 2, 0))
    composed.experiment, composed.out = EXPERIMENT, str(path.parent)
    config = to_config(composed)
    found = _physical(config, person, thing, options) if person is not None and thing is not None else None

    inputs = {name: getattr(options, name) for name in ("video", "person", "object")}
    facts = provenance(composed, []) | {"ablation": "", "overrides": ""}
    facts |= {f"sha256.ingest.{name}": _digest(file) for name, file in inputs.items() if file is not None}
    told = [facts["config_hash"], options.system, *(facts.get(f"sha256.ingest.{name}", "") for name in inputs)]
    facts["config_hash"] = hashlib.sha256("\n".join(told).encode()).hexdigest()
    result = {
        "status": "done",
        "outcome": _outcome(found, options),
        "variant": options.system,
        "device": "",
        "seconds": repr(math.nan if options.seconds is None else options.seconds),
        "peak_memory_mb": repr(math.nan),
    }
    plan = Plan(options.system, (Step("ingest", PHASE, _outcome(found, options)),), (), ())
    run = Run(OmegaConf.to_yaml(composed, resolve=True), facts, result, plan, (), (), None, State())
    points = colours = None
    if found is not None:
        run = replace(run, scene=found.scene, state=found.state)
        points, colours = found.skin, found.skin_colours
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {path.parent}: {error.strerror}") from error
    write(run, path, points, colours, plan_text=format_plan(plan), footage=footage)
    if video is not None:
        write_mp4(video, path.with_suffix(".mp4"))
    return path


def _check(options: argparse.Namespace) -> None:
    """What can be seen to be wrong before anything is read."""
    taken = {ablation.value for ablation in Ablation}
    if (
        not re.search("[a-z0-9]", options.system.lower())
        or not options.system.isprintable()
        or len(options.system) > 60
    ):
        raise InputError(f"--system {options.system[:80]!r}: a name of up to 60 characters with a letter or digit")
    if options.system.lower() in taken:
        raise InputError(f"--system {options.system}: that is the name of a variant of our own")
    if (options.person is None) != (options.object is None):
        raise InputError("--person and --object go together")
    if options.person is None and options.video is None:
        raise InputError("give --video FILE.mp4, or --person and --object, or all three")
    for name in ("fps", "scale", "distance"):
        value = getattr(options, name)
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"--{name} {value:g}: more than 0 is allowed")
    if options.fps is not None and not 0.1 <= options.fps <= 1000:
        raise InputError(f"--fps {options.fps:g}: 0.1 to 1000 are allowed")
    if options.seconds is not None and not (math.isfinite(options.seconds) and options.seconds >= 0):
        raise InputError(f"--seconds {options.seconds:g}: 0 or more is allowed")
    if options.ground is not None and not math.isfinite(options.ground):
        raise InputError(f"--ground {options.ground:g}: a height in metres is allowed")
    if options.seed < 0:
        raise InputError(f"--seed {options.seed}: 0 or more is allowed")
    if options.prompt is not None and not options.prompt.strip():
        raise InputError("--prompt: is empty")
    if options.out is not None and options.out.suffix != ".mcap":
        raise InputError(f"-o {options.out}: a .mcap file is allowed")


def _scene_config(name: str) -> DictConfig:
    """The config of a scene, composed as `hoi.run` does."""
    known = sorted(file.stem for file in (CONF / "scene").glob("*.yaml"))
    if name not in known:
        raise InputError(f"--scene {name}: allowed are {', '.join(known)}")
    return composed_of(f"scene={name}", "render=none")


def _meshes(options: argparse.Namespace, fps: float) -> tuple[meshes.MeshSequence, meshes.MeshSequence]:
    """Person and object in our world: as many frames of both, the ground at z = 0."""
    person, thing = (
        in_our_world(meshes.read(path, node, fps), options.scale, options.up)
        for path, node in ((options.person, options.person_node), (options.object, options.object_node))
    )
    if options.fps is not None:
        person, thing = replace(person, fps=options.fps), replace(thing, fps=options.fps)
    if person.fps is None and thing.fps is None:
        raise InputError(f"--fps: neither {options.person} nor {options.object} says how many frames a second it has")
    if None not in (person.fps, thing.fps) and person.fps != thing.fps:
        raise InputError(f"{options.person} has {person.fps:g} frames a second, {options.object} {thing.fps:g}")
    if len(person.vertices) != len(thing.vertices):
        both = f"{options.person} has {len(person.vertices)} frames, {options.object} {len(thing.vertices)}"
        raise InputError(f"{both}; they must have as many")
    ground = options.ground
    if ground is None:
        ground = min(float(mesh.vertices[0, :, 2].min()) for mesh in (person, thing))
    down = np.array([0.0, 0.0, ground])
    return replace(person, vertices=person.vertices - down), replace(thing, vertices=thing.vertices - down)


def _physical(
    config: Config, person: meshes.MeshSequence, thing: meshes.MeshSequence, options: argparse.Namespace
) -> Meshes:
    scene_conf, contact = config.scene, config.stage.contact
    skin, colours = tracked_points(person, SKIN_POINTS, config.seed)
    seen, positions = object_of(thing, config.object.name, material_of(config.material), config.seed)
    com = centre_of_mass_path(thing.vertices, thing.faces, triangle_areas(thing))
    mass = float(seen.masses.sum())
    search: ContactSearch | None = None
    if options.contact:
        search = find_contact(
            skin,
            positions[:, : len(seen.cloud)],
            com,
            scene_conf.fps,
            distance=options.distance or contact.d_contact,
            mass=mass,
            restitution=seen.material.restitution,
        )
    speed = velocity(com, scene_conf.fps, search)
    gravity = np.array(scene_conf.gravity)
    kinetic = 0.5 * mass * (speed**2).sum(axis=1)
    trajectory = ObjectTrajectory(
        positions=positions,
        com=com,
        com_velocity=speed,
        energy=np.stack([kinetic, np.zeros_like(kinetic), -mass * com @ gravity], axis=-1),
        phase=(PHASE,) * len(com),
    )
    scene = Scene(
        name=scene_conf.name,
        body=_no_body(options),
        object=seen,
        motion_prompt=scene_conf.motion_prompt,
        frames=scene_conf.frames,
        fps=scene_conf.fps,
        gravity=gravity,
        planes=tuple(planes_of(scene_conf, config.material.ground_friction).values())[: int(scene_conf.ground)],
    )
    return Meshes(scene, State(trajectory=trajectory, contact=search), skin, colours)


def _no_body(options: argparse.Namespace) -> Body:
    """Of a mesh neither Gaussians nor skeleton nor weights are known: the person is its points alone."""
    nothing = np.zeros((0, 3), np.float32)
    cloud = GaussianCloud(
        nothing, np.zeros((0, 4), np.float32), nothing, nothing[:, 0], np.zeros((0, 1, 3), np.float32)
    )
    source = f"{options.system}: {options.person.name}"
    return Body("mesh", cloud, np.zeros((0, JOINT_COUNT), np.float32), np.zeros((JOINT_COUNT, 3)), source)


def _outcome(found: Meshes | None, options: argparse.Namespace) -> str:
    """What is in the record, in one sentence."""
    if found is None:
        return f"video of {options.system}, {options.video.name}"
    what = f"meshes of {options.system}, {options.person.name} and {options.object.name}"
    search = found.state.contact
    if search is None:
        return f"{what}; no contact looked for"
    if search.push is None:
        return f"{what}; no contact: smallest gap {search.smallest_gap:.3f} m at frame {search.smallest_gap_frame:.2f}"
    return f"{what}; contact at frame {search.push.frame:.2f}"


def _digest(path: Path) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's files."""
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            digest.update(file.name.encode() + b"\0" if path.is_dir() else b"")
            digest.update(file.read_bytes())
    return digest.hexdigest()
