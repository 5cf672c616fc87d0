"""Motion clips -> training windows: 40 frames at 20 FPS, placed so that strikes are seen whole and often.

A clip file is an npz of `poses` (F, 24, 3) rotation vectors and `trans` (F, 3), all clips one after the other,
`offsets` (24, 3) of the skeleton and `meta`, a JSON list with one entry a clip: name, label, side, captions, strikes,
keyframed, start, length. World Z-up, metres, 20 FPS, facing -Y at the start: turned to +Y here, at the door.
"""

import json
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import roma
import torch
from torch import Tensor

from hoi.body.kinematics import rotation_to_6d
from hoi.body.skeleton import PARENTS
from hoi.data import Array
from hoi.errors import InputError
from hoi.motion.features import encode

FRAMES = 40
FPS = 20.0
PEAK_FRAMES = range(12, 31, 2)
"""Where the peak of a strike may lie in its window."""
MIRRORED_JOINTS = (0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22)

STRIKE_WEIGHTS = {
    "kick_soccer": 4.5, "kick_front": 3.5, "kick_high": 1.5, "kick_side": 0.8, "kick_spin": 0.4, "kick_crescent": 0.4,
    "karate_knee": 1.4, "karate_strike": 1.3, "punch": 2.5, "punch_jab": 2.2, "punch_cross": 1.8, "punch_hook": 1.4,
    "punch_combo": 0.8, "fight_combo": 0.4, "punch_slow": 0.25, "punch_swing": 0.6, "push": 2.8, "push_heavy": 1.0,
    "push_one_hand": 0.8, "throw": 0.9, "throw_basketball": 0.7, "shoot_basketball": 0.6,
}  # fmt: skip
"""How often each kind of strike is drawn, relative to the others."""
STRIKE_SHARE = 0.72
"""Share of strikes among the windows drawn."""
KEYFRAMED_WEIGHT = 0.5
"""How often a hand-animated clip is drawn, relative to a captured one of the same label."""

PLAIN_CAPTIONS = {
    "kick_soccer": (
        "a person kicks a ball", "a person kicks a soccer ball", "a man kicks a football",
        "a person kicks a soccer ball with the {side} foot", "a person kicks the ball with the {side} foot",
    ),
    "kick_front": ("a person kicks", "a person kicks a box", "a person kicks forward with the {side} leg"),
    "kick_high": ("a person kicks high with the {side} foot", "a person does a high kick"),
    "punch": (
        "a person punches", "a person punches a bag", "a person punches with the {side} hand",
        "a person throws a punch with the {side} arm",
    ),
    "punch_jab": ("a person jabs", "a person jabs with the {side} hand"),
    "punch_cross": ("a person punches hard", "a person punches a bag with the {side} hand"),
    "push": (
        "a person pushes", "a person pushes a box", "a person pushes an object with both hands",
        "a person shoves something with two hands",
    ),
    "karate_knee": (
        "a person does a knee strike", "a person does a karate knee strike with the {side} knee",
        "a person hits something with the {side} knee",
    ),
}  # fmt: skip
"""Captions beside those of the files, for the sentences that people type first."""


@dataclass(frozen=True)
class Clip:
    """One captioned motion, facing +Y at the start."""

    name: str
    label: str
    side: str
    """"left", "right" or ""."""
    captions: tuple[str, ...]
    strike_frames: tuple[int, ...]
    """Frames at which a hand, foot or knee is fastest; empty where the clip is no strike."""
    keyframed: bool
    poses: Array
    """Rotation vectors of the 24 joints [rad], (F, 24, 3)."""
    translation: Array
    """World position of the pelvis joint [m], (F, 3)."""


def swap_sides(sentence: str) -> str:
    """Exchange left and right."""
    return re.sub("left|right", lambda match: "right" if match[0] == "left" else "left", sentence)


def mirror(clip: Clip) -> Clip:
    """The clip seen in a mirror (x -> -x), captions included."""
    return replace(
        clip,
        side=swap_sides(clip.side),
        captions=tuple(swap_sides(caption) for caption in clip.captions),
        poses=clip.poses[:, MIRRORED_JOINTS] * np.array([1, -1, -1], clip.poses.dtype),
        translation=clip.translation * np.array([-1, 1, 1], clip.translation.dtype),
    )


def turned_to_plus_y(poses: Array, translation: Array) -> tuple[Array, Array]:
    """Half a turn about z: a person who faces -Y then faces +Y."""
    half_turn = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    root = half_turn @ roma.rotvec_to_rotmat(torch.from_numpy(poses[:, 0].astype(np.float64)))
    turned = poses.astype(np.float32)
    turned[:, 0] = roma.rotmat_to_rotvec(root).numpy()
    return turned, (translation * np.array([-1, -1, 1])).astype(np.float32)


def read_clips(path: Path) -> list[Clip]:
    """The clips of one file. Clips named `cat:*` are left out: their library names a source that is not free."""
    clips = []
    with np.load(path, allow_pickle=False) as file:
        poses, translation = file["poses"], file["trans"]
        for entry in json.loads(str(file["meta"])):
            if entry["name"].startswith("cat:"):
                continue
            rows = slice(entry["start"], entry["start"] + entry["length"])
            clip_poses, clip_translation = turned_to_plus_y(poses[rows], translation[rows])
            strikes = tuple(strike["frame"] for strike in entry["strikes"]) if entry["is_strike"] else ()
            clips.append(
                Clip(
                    entry["name"], entry["label"], entry["side"], tuple(entry["captions"]), strikes,
                    entry.get("keyframed", False), clip_poses, clip_translation,
                )
            )  # fmt: skip
    return clips


def rest_joints_of(offsets: Array) -> Tensor:
    """Offsets from the parent (24, 3) -> T-pose joints (24, 3)."""
    joints = np.array(offsets, np.float64)
    for joint, parent in enumerate(PARENTS[1:], start=1):
        joints[joint] += joints[parent]
    return torch.from_numpy(joints.astype(np.float32))


def window_starts(length: int, strike_frames: tuple[int, ...]) -> list[int]:
    """First frames of a clip's windows. They may reach beyond its ends, as little as the clip's length forces them to.

    A strike is shown at every place of `PEAK_FRAMES` that allows it; other motion every half second.
    """
    last = length - FRAMES
    if not strike_frames:
        return sorted({*range(0, max(last, 0) + 1, 10), max(last, 0)})
    starts = {peak - place for peak in strike_frames for place in PEAK_FRAMES}
    overhang = {start: max(0, -start) + max(0, start - last) for start in starts}
    allowed = max(0, -last) + 2
    fitting = [start for start in starts if overhang[start] <= allowed]
    return sorted(fitting) or [min(starts, key=overhang.__getitem__)]


def cut(clip: Clip, start: int) -> tuple[Array, Array]:
    """Poses and translation of one window, the clip's ends held."""
    frames = np.clip(np.arange(start, start + FRAMES), 0, len(clip.poses) - 1)
    return clip.poses[frames], clip.translation[frames]


@dataclass(frozen=True)
class TrainingSet:
    """All windows, their features computed once."""

    features: Tensor
    """(N, 40, 205), unnormalised."""
    weights: Tensor
    """How often each window is drawn, (N,), sums to 1."""
    caption_choices: list[list[int]]
    """Per window, the rows of `captions` that describe it."""
    captions: list[str]
    """Row 0 is the empty sentence."""
    rest_joints: Tensor
    """(24, 3) [m]."""
    summary: dict[str, int]
    """Windows per label, mirrored copies counted."""


def clip_weights(clips: list[Clip]) -> list[float]:
    """How often each clip is drawn: by label, then evenly within it, hand-animated clips less often."""
    size = [KEYFRAMED_WEIGHT if clip.keyframed else 1.0 for clip in clips]
    total: dict[str, float] = {}
    for clip, weight in zip(clips, size, strict=True):
        total[clip.label] = total.get(clip.label, 0.0) + weight
    shares = {label: STRIKE_WEIGHTS.get(label, 0.0) for label in total}
    others = {label: total[label] ** 0.5 for label in total if label not in STRIKE_WEIGHTS}
    strike_sum, other_sum = sum(shares.values()) or 1.0, sum(others.values()) or 1.0
    for label in total:
        if label in others:
            shares[label] = (1 - STRIKE_SHARE) * others[label] / other_sum
        else:
            shares[label] *= STRIKE_SHARE / strike_sum
    return [shares[clip.label] * weight / total[clip.label] for clip, weight in zip(clips, size, strict=True)]


def describe(clip: Clip, sentences: dict[str, list[str]]) -> list[str]:
    """Every caption that fits a clip. Slow motion is told only by sentences that say so, where there are some."""
    known = sentences.get(f"{clip.label}/{clip.side}") or sentences.get(clip.label) or []
    if known and clip.label.endswith("_slow"):
        return known
    plain = [text.format(side=clip.side) for text in PLAIN_CAPTIONS.get(clip.label, ()) if clip.side or "{" not in text]
    return [*clip.captions, *known, *plain]


def build_training_set(clips: list[Clip], rest_joints: Tensor, sentences: dict[str, list[str]]) -> TrainingSet:
    """Cut, mirror and encode.

    Args:
        clips: unmirrored clips.
        rest_joints: the prior's T-pose joints [m], (24, 3).
        sentences: further captions by "label/side" or "label".

    Raises:
        InputError: there is no clip.
    """
    if not clips:
        raise InputError("data: holds no motion clip")
    both = [*clips, *(mirror(clip) for clip in clips)]
    rows: dict[str, int] = {"": 0}
    poses, translations, weights, choices = [], [], [], []
    summary: Counter[str] = Counter()
    for clip, weight in zip(both, clip_weights(both), strict=True):
        captions = [rows.setdefault(caption, len(rows)) for caption in describe(clip, sentences)]
        starts = window_starts(len(clip.poses), clip.strike_frames)
        for start in starts:
            window_poses, window_translation = cut(clip, start)
            poses.append(window_poses)
            translations.append(window_translation)
            weights.append(weight / len(starts))
            choices.append(captions)
        summary[clip.label] += len(starts)
    pose, translation = torch.from_numpy(np.stack(poses)), torch.from_numpy(np.stack(translations))
    features = [
        encode(r, rotation_to_6d(roma.rotvec_to_rotmat(p[:, :, 0])), p[:, :, 1:], rest_joints)
        for r, p in zip(translation.split(256), pose.split(256), strict=True)
    ]
    weight_tensor = torch.tensor(weights)
    return TrainingSet(
        torch.cat(features), weight_tensor / weight_tensor.sum(), choices, list(rows), rest_joints, dict(summary)
    )


def read_captions(folder: Path | None) -> dict[str, list[str]]:
    """`captions.json` of a folder: "label/side" or "label" -> sentences; empty where there is none."""
    if folder is None or not (folder / "captions.json").is_file():
        return {}
    return json.loads((folder / "captions.json").read_text())
