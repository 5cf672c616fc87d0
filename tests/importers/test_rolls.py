"""How limbs are turned about their own axes, where neither names nor rest poses tell: by bends, by split bones."""

import re

import numpy as np
import pytest
from demo_run import person
from scipy.spatial.transform import Rotation
from test_joint_motions import bent
from test_motion_imports import along_x, assert_same, made_up, matrices, write_bvh

from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_paths
from hoi.data import Body, Motion
from hoi.importers.motions import read_motion

FPS = 20.0
ARM = ("shoulder", "elbow", "wrist", "hand")


@pytest.fixture(scope="module")
def body() -> Body:
    return person(np.random.default_rng(0), 500)


def wrongly(got: Motion, motion: Motion) -> np.ndarray:
    """By how much each joint is turned wrongly, at most [degrees]."""
    between = matrices(got).swapaxes(-1, -2) @ matrices(motion)
    return np.degrees(Rotation.from_matrix(between.reshape(-1, 3, 3)).magnitude()).reshape(len(motion), 24).max(axis=0)


@pytest.mark.parametrize("roll", [0, 77, -120])
def test_arms_that_are_raised_at_rest_and_turned(tmp_path, body, roll):
    """As Human3.6M's, whose bones of the upper body all point up."""
    motion, rest = bent(body), {}
    for side, sign in (("left", 1), ("right", -1)):
        frame = Rotation.from_euler("z", sign * np.pi / 2) * Rotation.from_euler("x", np.radians(roll))
        rest |= {f"{side}_{part}": frame.as_matrix() for part in ARM}
    path = write_bvh(tmp_path / "m.bvh", body, motion, rest=rest)
    got, notes = read_motion(path, body, len(motion), FPS)
    assert wrongly(got, motion).max() < 1
    np.testing.assert_allclose(joint_paths(body, got), joint_paths(body, motion), atol=1e-3)
    assert any("raised at rest" in note for note in notes)


def test_arms_that_hang_at_rest_are_taken_as_they_are(tmp_path, body):
    """Whatever their elbows do: a motion that bends them oddly stays as it is."""
    motion, rest = made_up(body, 40), {}
    for side, sign in (("left", 1), ("right", -1)):
        rest |= {f"{side}_{part}": Rotation.from_euler("z", -sign * np.pi / 2).as_matrix() for part in ARM}
    got, _ = read_motion(write_bvh(tmp_path / "m.bvh", body, motion, rest=rest), body, len(motion), FPS)
    assert_same(got, motion)


def test_bones_along_one_axis_are_turned_as_they_bend(tmp_path, body):
    motion = bent(body)
    path = write_bvh(tmp_path / "m.bvh", body, motion, rest=along_x(body))
    got, notes = read_motion(path, body, len(motion), FPS)
    limbs = [JOINT_NAMES.index(f"{s}_{p}") for s in ("left", "right") for p in ("hip", "knee", "shoulder", "elbow")]
    assert wrongly(got, motion)[limbs].max() < 3 and wrongly(got, motion).max() < 15
    assert any("no standing person's" in note for note in notes)


def test_what_bends_do_not_tell_is_said(tmp_path, body):
    motion = bent(body)
    motion.body_pose[:, [JOINT_NAMES.index(f"{side}_elbow") - 1 for side in ("left", "right")]] = 0
    rest = {f"left_{part}": Rotation.from_euler("z", np.pi / 2).as_matrix() for part in ARM}
    _, notes = read_motion(write_bvh(tmp_path / "m.bvh", body, motion, rest=rest), body, len(motion), FPS)
    assert any("bends do not tell: left_shoulder, left_elbow" in note for note in notes)


def test_knees_that_bend_backwards_are_said(tmp_path, body):
    """Of a skeleton without toes, whose axes nothing else tells to be left-handed."""
    motion = bent(body)
    knees = [JOINT_NAMES.index(f"{side}_knee") - 1 for side in ("left", "right")]
    motion.body_pose[:, knees] *= -1
    keep = set(JOINT_NAMES) - {"left_foot", "right_foot"}
    path = write_bvh(tmp_path / "m.bvh", body, motion, keep=keep)
    _, notes = read_motion(path, body, len(motion), FPS)
    assert any("both knees bend backwards" in note for note in notes)
    path = write_bvh(tmp_path / "m.bvh", body, bent(body), keep=keep)
    assert not any("backwards" in note for note in read_motion(path, body, len(motion), FPS)[1])


def split(text: str, name: str, child: str, new: str, rest_bone: np.ndarray) -> str:
    """A BVH in which a bone is two of half the length: the first swings, the second, `new`, twists."""
    header, motion = text.split("MOTION\n")
    lines, out, order, closing = header.splitlines(), [], [], None
    for row, line in enumerate(lines):
        joint = re.match(r"(\t*)(ROOT|JOINT) (\S+)", line)
        if joint and joint[3] == child:
            half = " ".join(f"{value:.9f}" for value in rest_bone / 2)
            out += [f"{joint[1]}JOINT {new}", f"{joint[1]}{{", f"{joint[1]}OFFSET {half}"]
            out += [f"{joint[1]}CHANNELS 3 Zrotation Xrotation Yrotation"]
            order.append(new)
            closing = joint[1]
        if joint:
            order.append(joint[3])
        if closing is not None and line.strip().startswith("OFFSET") and order[-1] == child:
            line = f"{closing}OFFSET {half}" if f"JOINT {child}" in lines[row - 2] else line
        out.append(line)
        if closing is not None and line == f"{closing}}}" and order[-1] != new:
            out.append(f"{closing}}}")
            closing = None
    frames = motion.splitlines()
    made = frames[:2]
    axis = rest_bone / np.linalg.norm(rest_bone)
    at = 3 + 3 * [joint for joint in order if joint != new].index(name)
    for frame in frames[2:]:
        values = np.array(frame.split(), float)
        turn = Rotation.from_euler("ZXY", values[at : at + 3], degrees=True)
        quaternion = turn.as_quat()
        twist = Rotation.from_quat([*(axis * (quaternion[:3] @ axis)), quaternion[3]])
        parts = [(turn * twist.inv()).as_euler("ZXY", degrees=True), twist.as_euler("ZXY", degrees=True)]
        made.append(" ".join(f"{value:.8f}" for value in [*values[:at], *parts[0], *parts[1], *values[at + 3 :]]))
    return "\n".join(out) + "\nMOTION\n" + "\n".join(made) + "\n"


@pytest.mark.parametrize("naming", ["names", "numbers"])
def test_upper_arms_and_thighs_that_are_split(tmp_path, body, naming):
    """By names, or by the shape, where a second finger tells the wrist: the twist is the shoulder's own."""
    motion = made_up(body)
    path = write_bvh(tmp_path / "m.bvh", body, motion)
    text = path.read_text()
    for side in ("Left", "Right"):
        for name, child, part, end in (("Arm", "ForeArm", "shoulder", "elbow"), ("UpLeg", "Leg", "hip", "knee")):
            ends = [JOINT_NAMES.index(f"{side.lower()}_{each}") for each in (part, end)]
            bone = 100 * (body.rest_joints[ends[1]] - body.rest_joints[ends[0]]).astype(float)
            text = split(text, f"{side}{name}", f"{side}{child}", f"{side}{name}Twist", bone)
    if naming == "numbers":
        for side in ("Left", "Right"):  # a thumb
            thumb = f"JOINT {side}Thumb\n{{\nOFFSET 1 0 3\nCHANNELS 0\nEnd Site\n{{\nOFFSET 0 0 1\n}}\n}}\n"
            text = text.replace(f"JOINT {side}HandIndex1", f"{thumb}JOINT {side}HandIndex1")
        names = list(dict.fromkeys(re.findall(r"(?:ROOT|JOINT) (\S+)", text)))
        for number, name in enumerate(names):
            text = re.sub(rf"(ROOT|JOINT) {name}\n", rf"\1 j{7 * number}\n", text)
    path.write_text(text)
    got, notes = read_motion(path, body, len(motion), FPS)
    assert_same(got, motion)
    assert any("not used" in note for note in notes)
