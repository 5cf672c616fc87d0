"""Motion-capture clips, and which of them is nearest to a sentence."""

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import roma
import torch

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import forward_kinematics, rotation_from_6d, rotation_to_6d
from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.body.skinning import joint_paths, sole_height
from hoi.data import Body, Motion
from hoi.errors import InputError
from hoi.importers.motions import SUFFIXES, read_motion
from hoi.importers.retarget import retarget
from hoi.motion.text import TextEncoder
from hoi.training.motion import deepmimic
from hoi.training.motion.dataset import FPS, MIRRORED_JOINTS, rest_joints_of, swap_sides

LONGEST = 60.0
"""As much of a recording is searched for its strike [s]."""
MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Clip:
    """A motion that could be replayed."""

    name: str
    captions: tuple[str, ...]
    load: Callable[[Body, float], Motion]
    """The whole clip on a body, at a frame rate."""


def shipped_clips() -> list[Clip]:
    """The DeepMimic clips that the package of the extra `train` brings.

    Raises:
        InputError: it is not installed.
    """
    try:
        folder = deepmimic.clip_folder()
    except InputError:
        raise InputError(
            f"the clips come with the package {deepmimic.PACKAGE}, which is not installed: pip install 'hoi[train]',"
            " or give --clips DIR"
        ) from None
    clips = []
    for name, (*_, captions) in deepmimic.CLIPS.items():
        path = folder / f"humanoid3d_{name}.txt"
        if path.is_file():
            clips.append(Clip(path.stem, captions, lambda body, fps, path=path: _on_body(path, body, fps)))
    return clips


def clips_of(folder: Path) -> list[Clip]:
    """The AMASS (.npz) and BVH files of a folder, captioned by its `captions.json`, else by their names' words.

    Raises:
        InputError: no such folder, no such file in it, or a `captions.json` that is none.
    """
    if not folder.is_dir():
        raise InputError(f"--clips {folder}: no such folder")
    files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in SUFFIXES)
    if not files:
        raise InputError(f"--clips {folder}: no {' or '.join(SUFFIXES)} in it")
    known, told = {}, folder / "captions.json"
    if told.is_file():
        try:
            known = json.loads(told.read_text())
        except (OSError, ValueError) as error:
            raise InputError(f"{told} cannot be read: {error}") from error
        lists = known.values() if isinstance(known, dict) else [None]
        if not all(isinstance(each, list) and each and all(isinstance(text, str) for text in each) for each in lists):
            raise InputError(f"{told} must map a file's name to a list of sentences")
    clips = []
    for file in files:
        name = file.relative_to(folder).as_posix()
        words = " ".join(re.findall(r"[A-Z]?[a-z]+|[A-Z]+", file.stem)).lower()
        captions = tuple(known.get(name, [words or "a motion"]))
        clips.append(
            Clip(name, captions, lambda body, fps, file=file: read_motion(file, body, round(LONGEST * fps), fps)[0])
        )
    return clips


def with_mirrored(clips: Sequence[Clip]) -> list[Clip]:
    """The clips, and each that tells left from right as seen in a mirror, too."""
    made = list(clips)
    for clip in clips:
        captions = tuple(swap_sides(caption) for caption in clip.captions)
        if captions != clip.captions:
            load = clip.load
            made.append(
                Clip(f"{clip.name} (mirrored)", captions, lambda body, fps, load=load: mirrored(load(body, fps)))
            )
    return made


def nearest(prompt: str, clips: Sequence[Clip], encoder: TextEncoder) -> tuple[Clip, str, float]:
    """The clip with the caption nearest to the prompt, that caption, and the cosine of their embeddings.

    Where the prompt names one side, a caption that names only the other is not considered. Of equals the first counts.

    Raises:
        InputError: every caption names the other side.
    """
    pairs = [(clip, text) for clip in clips for text in clip.captions if not _other_side(prompt, text)]
    if not pairs:
        raise InputError(f"no clip fits {prompt!r}: all are of the other side")
    asked, *rows = torch.nn.functional.normalize(encoder.embed([prompt, *(text for _, text in pairs)]), dim=-1)
    likeness = [round(float(row @ asked), 6) for row in rows]
    best = int(np.argmax(likeness))
    return *pairs[best], likeness[best]


def _other_side(prompt: str, caption: str) -> bool:
    asked, told = (set(re.findall("left|right", text)) for text in (prompt.lower(), caption.lower()))
    return len(asked) == 1 and bool(told) and not asked & told


def _on_body(path: Path, body: Body, fps: float) -> Motion:
    """A DeepMimic clip on a body, from the origin on, its lowest joint where the body's is when it stands."""
    poses, translation = deepmimic.read_motion(path)
    rotations = roma.rotvec_to_rotmat(torch.from_numpy(poses))
    plain = rest_joints_of(deepmimic.OFFSETS).double()
    world, positions = forward_kinematics(rotations, torch.from_numpy(translation), plain)
    local, path_of_pelvis, _ = retarget(
        JOINT_NAMES, PARENTS, plain.numpy(), world.numpy(), positions.numpy(), np.asarray(body.rest_joints)
    )
    turns = torch.from_numpy(np.ascontiguousarray(local))
    motion = Motion(
        translation=path_of_pelvis - path_of_pelvis[0] * (1, 1, 0),
        orientation=rotation_to_6d(turns[:, 0]).numpy(),
        body_pose=roma.rotmat_to_rotvec(turns[:, 1:]).numpy(),
        fps=FPS,
    )
    motion.translation[:, 2] += sole_height(body) - joint_paths(body, motion)[..., 2].min()
    return replace(interpolate_motion(motion, np.arange(0, len(motion) - 1 + 1e-9, FPS / fps)), fps=fps)


def mirrored(motion: Motion) -> Motion:
    """The motion seen in a mirror, x -> -x; right for a body that is symmetric."""
    root = rotation_from_6d(torch.as_tensor(motion.orientation, dtype=torch.float64)).numpy()
    joints = [joint - 1 for joint in MIRRORED_JOINTS[1:]]
    return replace(
        motion,
        translation=motion.translation * MIRROR.diagonal().astype(motion.translation.dtype),
        orientation=rotation_to_6d(torch.from_numpy(MIRROR @ root @ MIRROR)).numpy().astype(motion.orientation.dtype),
        body_pose=motion.body_pose[:, joints] * np.array([1, -1, -1], motion.body_pose.dtype),
    )
