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

from hoi.body.kinematics import joint_positions, rotation_from_6d, rotation_to_6d
from hoi.body.skeleton import PARENTS
from hoi.data import Array
from hoi.errors import InputError
from hoi.motion.features import encode

FRAMES = 40
FPS = 20.0
PEAK_FRAMES = range(16, 27, 2)
"""Where the peak of a strike may lie in its window. Spread wider, the mean over all those times, to which pure noise is
denoised, hardly moves, and so do the samples of a prior that is not trained for long."""
MIRRORED_JOINTS = (0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22)

HELD_OUT = (
    "dg_",  # HDM05's subject dg: front kicks, ball throws and eight other exercises
    "11_", "14_",  # CMU's subjects 11 (soccer kick) and 14 (exercises, which subject 13 does too)
    "08_", *(f"cmu_walking_{k}@" for k in range(113, 118)),  # CMU's subject 08, which is in the files twice
    "05_19", "06_15",  # single takes: dance, basketball
    "135_02@35", "135_02@36", "135_02@38",  # the end of a karate form, unlike all before it
    "m2m:Fighting", "m2m:Power Up", "kaykit:Throw",  # distinct hand-animated motions: jab, push, throw
)  # fmt: skip
"""Beginnings of the names of clips that no training sees: whole subjects, takes or distinct motions, so that no copy of
one (mirrored, cut otherwise, at another tempo, captioned otherwise) is on the other side."""

STRIKE_WEIGHTS = {
    "kick_soccer": 3.6, "kick_front": 3.5, "kick_high": 1.5, "kick_side": 2.0, "kick_spin": 1.2, "kick_crescent": 0.4,
    "karate_knee": 2.0, "karate_strike": 1.3, "punch": 3.4, "punch_jab": 2.8, "punch_cross": 2.0, "punch_hook": 2.0,
    "punch_combo": 0.8, "fight_combo": 0.4, "punch_slow": 1.6, "punch_swing": 0.6, "push": 2.8, "push_heavy": 1.0,
    "push_one_hand": 0.8, "throw": 0.9, "throw_basketball": 0.7, "shoot_basketball": 0.6,
}  # fmt: skip
"""How often each kind of strike is drawn, relative to the others."""
STRIKE_SHARE = 0.72
"""Share of strikes among the windows drawn."""
KNEE_TEMPO = 1.5
"""How much faster than the exercise a knee strike is."""
SIDES = ("left", "right")
FEET, KNEES, HANDS = (10, 11), (4, 5), (22, 23)
"""Joints of a limb, left and right."""
OTHER_HAND_STRIKES = 0.6
"""A hand this fast, relative to the peak of the punch that a clip is about, punches too."""
PUNCH_FRAMES = 4
"""So near its peak a punch is one motion of both arms."""
NAMED_SIDE_FASTER = 0.9
"""How fast the named limb must be in a window, relative to the other side's."""
KEYFRAMED_WEIGHT = 0.5
"""How often a hand-animated clip is drawn, relative to a captured one of the same label."""

PLAIN_CAPTIONS = {
    "kick_soccer": (
        "a person kicks a ball", "a person kicks a soccer ball", "a man kicks a football",
        "a person kicks a soccer ball with the {side} foot", "a person kicks the ball with the {side} foot",
    ),
    "kick_front": (
        "a person kicks", "a person kicks a box", "a person kicks forward with the {side} leg",
        "a person does a front kick with the {side} foot", "a person does a front kick with the {side} leg",
    ),
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
        "a person hits something with the {side} knee", "a person strikes with the {side} knee",
        "a person knees a box",
    ),
}  # fmt: skip
"""Captions beside those of the files, for the sentences that people type first."""
SIDED_CAPTION_WEIGHT = 3
"""How often a caption that names the side is drawn, relative to one that does not."""
FORCE_WORDS = {"strong": ("hard", "with full force"), "weak": ("gently", "lightly")}
FORCE_MARGIN = 0.15
"""A strike this share faster or slower than the median of its label is told as strong or weak, too."""


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
    speed: float | None = None
    """Of the fastest strike [m/s]; None where it is not known."""


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
            speed = max((strike["speed"] for strike in entry["strikes"] if "speed" in strike), default=None)
            clips.append(
                Clip(
                    entry["name"], entry["label"], entry["side"], tuple(entry["captions"]), strikes,
                    entry.get("keyframed", False), clip_poses, clip_translation, speed,
                )
            )  # fmt: skip
    return clips


def rest_joints_of(offsets: Array) -> Tensor:
    """Offsets from the parent (24, 3) -> T-pose joints (24, 3)."""
    joints = np.array(offsets, np.float64)
    for joint, parent in enumerate(PARENTS[1:], start=1):
        joints[joint] += joints[parent]
    return torch.from_numpy(joints.astype(np.float32))


def is_held_out(clip: Clip) -> bool:
    """Whether the clip is kept from training, for evaluation."""
    return clip.name.removeprefix("knee:").startswith(HELD_OUT)


def played_at(clip: Clip, tempo: float) -> tuple[Array, Array]:
    """Poses and translation of the clip at another tempo (2 is twice as fast), interpolated between frames."""
    frames = np.arange(0, len(clip.poses) - 1, tempo)
    before, share = frames.astype(int), (frames % 1).astype(np.float32)
    rows = rotation_to_6d(roma.rotvec_to_rotmat(torch.from_numpy(clip.poses))).numpy()
    rows = rows[before] + share[:, None, None] * (rows[before + 1] - rows[before])
    poses = roma.rotmat_to_rotvec(rotation_from_6d(torch.from_numpy(rows))).numpy()
    return poses, clip.translation[before] + share[:, None] * (clip.translation[before + 1] - clip.translation[before])


def with_knee_strikes(clips: list[Clip], rest_joints: Tensor) -> list[Clip]:
    """The clips, with knee strikes from the exercise "elbow to knee", half as fast again, for those of a karate form.

    In the form an arm strikes right after the knee, faster: a prior that learns knee strikes from it strikes with the
    arm. In the exercise nothing outruns the knee, which rises as in a knee strike.
    """
    made = []
    for clip in clips:
        if clip.label != "elbow_knee":
            continue
        poses, translation = played_at(clip, KNEE_TEMPO)
        faster = replace(clip, poses=poses, translation=translation)
        frame, knee = divmod(int(joints_of(faster, rest_joints)[:, KNEES, 2].argmax()), 2)
        made.append(
            replace(
                faster, name=f"knee:{clip.name}", label="karate_knee", side=SIDES[knee], captions=(),
                strike_frames=(frame,), speed=None,
            )
        )  # fmt: skip
    return [clip for clip in clips if clip.label != "karate_knee"] + made if made else clips


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


def joints_of(clip: Clip, rest_joints: Tensor) -> Array:
    """World joint positions [m], (F, 24, 3)."""
    poses = torch.from_numpy(clip.poses)
    root = rotation_to_6d(roma.rotvec_to_rotmat(poses[:, 0]))
    return joint_positions(torch.from_numpy(clip.translation), root, poses[:, 1:], rest_joints).numpy()


def single_punch(clip: Clip, rest_joints: Tensor) -> Clip:
    """A clip of a punch, cut off where the other hand punches: a series is cut into clips that reach into the next."""
    if not clip.label.startswith("punch") or clip.side not in SIDES or len(clip.strike_frames) != 1:
        return clip
    speed = np.linalg.norm(np.diff(joints_of(clip, rest_joints)[:, HANDS], axis=0), axis=-1)
    (peak,), named = clip.strike_frames, SIDES.index(clip.side)
    punches = np.flatnonzero(speed[:, 1 - named] > OTHER_HAND_STRIKES * speed[max(peak - 1, 0) : peak + 2, named].max())
    first = max((int(frame) + 2 for frame in punches if frame < peak - PUNCH_FRAMES), default=0)
    last = min((int(frame) for frame in punches if frame > peak + PUNCH_FRAMES), default=len(clip.poses))
    return replace(
        clip, poses=clip.poses[first:last], translation=clip.translation[first:last], strike_frames=(peak - first,)
    )


def windows_of(clip: Clip, rest_joints: Tensor) -> list[int]:
    """First frames of a clip's windows; of a strike with a side only those, if any, that show it.

    Where the other side is the faster, the caption would be wrong.
    """
    starts = window_starts(len(clip.poses), clip.strike_frames)
    if not clip.strike_frames or clip.side not in SIDES:
        return starts
    limb = FEET if clip.label.startswith("kick") else KNEES if clip.label == "karate_knee" else HANDS
    speed = np.linalg.norm(np.diff(joints_of(clip, rest_joints)[:, limb], axis=0), axis=-1)
    named = SIDES.index(clip.side)
    peaks = {start: speed[max(start, 0) : start + FRAMES - 1].max(axis=0) for start in starts}
    return [start for start in starts if peaks[start][named] > NAMED_SIDE_FASTER * peaks[start][1 - named]]


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
    """Per window, the rows of `captions` that describe it, as often as they are to be drawn."""
    captions: list[str]
    """Row 0 is the empty sentence."""
    kinds: list[str]
    """Per window, what it is: "label/side", or "label" where no side is known."""
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


def force_of(clip: Clip, clips: list[Clip]) -> str:
    """ "strong", "weak" or "", by the strike's speed among those of its label."""
    if clip.speed is None:
        return ""
    usual = float(np.median([other.speed for other in clips if other.label == clip.label and other.speed is not None]))
    if abs(clip.speed - usual) < FORCE_MARGIN * usual:
        return ""
    return "strong" if clip.speed > usual else "weak"


def describe(clip: Clip, sentences: dict[str, list[str]], force: str = "") -> list[str]:
    """Every caption that fits a clip. Slow motion is told only by sentences that say so, where there are some."""
    known = sentences.get(f"{clip.label}/{clip.side}") or sentences.get(clip.label) or []
    if known and clip.label.endswith("_slow"):
        return known
    plain = [text.format(side=clip.side) for text in PLAIN_CAPTIONS.get(clip.label, ()) if clip.side or "{" not in text]
    told = [f"{text} {word}" for text in plain if "hard" not in text for word in FORCE_WORDS.get(force, ())]
    return [*clip.captions, *known, *plain, *told]


def build_training_set(clips: list[Clip], rest_joints: Tensor, sentences: dict[str, list[str]]) -> TrainingSet:
    """Cut, mirror and encode.

    Args:
        clips: unmirrored clips.
        rest_joints: the prior's T-pose joints [m], (24, 3).
        sentences: further captions by "label/side" or "label".

    Raises:
        InputError: there is no clip.
    """
    clips = [single_punch(clip, rest_joints) for clip in clips]
    both = [*clips, *(mirror(clip) for clip in clips)]
    rows: dict[str, int] = {"": 0}
    poses, translations, weights, choices, kinds = [], [], [], [], []
    summary: Counter[str] = Counter()
    for clip, weight in zip(both, clip_weights(both), strict=True):
        captions = [
            rows.setdefault(caption, len(rows))
            for caption in describe(clip, sentences, force_of(clip, both))
            for _ in range(SIDED_CAPTION_WEIGHT if clip.side and clip.side in caption else 1)
        ]
        starts = windows_of(clip, rest_joints)
        for start in starts:
            window_poses, window_translation = cut(clip, start)
            poses.append(window_poses)
            translations.append(window_translation)
            weights.append(weight / len(starts))
            choices.append(captions)
            kinds.append(f"{clip.label}/{clip.side}" if clip.side else clip.label)
        summary[clip.label] += len(starts)
    if not poses:
        raise InputError("data: holds no motion clip")
    pose, translation = torch.from_numpy(np.stack(poses)), torch.from_numpy(np.stack(translations))
    features = [
        encode(r, rotation_to_6d(roma.rotvec_to_rotmat(p[:, :, 0])), p[:, :, 1:], rest_joints)
        for r, p in zip(translation.split(256), pose.split(256), strict=True)
    ]
    weight_tensor = torch.tensor(weights)
    return TrainingSet(
        torch.cat(features), weight_tensor / weight_tensor.sum(), choices, list(rows), kinds, rest_joints, dict(summary)
    )


def read_captions(folder: Path | None) -> dict[str, list[str]]:
    """`captions.json` of a folder: "label/side" or "label" -> sentences; empty where there is none."""
    if folder is None or not (folder / "captions.json").is_file():
        return {}
    return json.loads((folder / "captions.json").read_text())
