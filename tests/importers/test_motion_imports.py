"""Motion files of other people: what is written here is read back, whatever its axes, unit, names and rest pose."""

import re

import numpy as np
import pytest
import roma
import torch
from demo_run import person
from scipy.spatial.transform import Rotation

from hoi.body.kinematics import rotation_from_6d, rotation_to_6d
from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.body.skinning import joint_paths, sole_height
from hoi.data import Body, Motion
from hoi.errors import InputError
from hoi.importers.amass import SMPL_HIPS, SMPL_LEG_BONES
from hoi.importers.bvh import read_bvh
from hoi.importers.motions import TO_Z_UP, Y_TO_Z_UP, read_motion
from hoi.importers.retarget import hips_from_pelvis, leg_bones, map_joints, side_and_part

FRAMES, FPS = 9, 20.0

MIXAMO = dict(zip(JOINT_NAMES, (
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
    "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm",
    "LeftForeArm", "RightForeArm", "LeftHand", "RightHand", "LeftHandIndex1", "RightHandIndex1",
), strict=True))  # fmt: skip
HDM05 = dict(zip(JOINT_NAMES, (
    "root", "lfemur", "rfemur", "lowerback", "ltibia", "rtibia", "upperback", "lfoot", "rfoot", "thorax", "ltoes",
    "rtoes", "lowerneck", "lclavicle", "rclavicle", "head", "lhumerus", "rhumerus", "lradius", "rradius", "lwrist",
    "rwrist", "lhand", "rhand",
), strict=True))  # fmt: skip
BIOVISION = MIXAMO | {
    f"{side.lower()}_{part}": f"{side}{name}"
    for side in ("Left", "Right")
    for part, name in {
        "hip": "Hip", "knee": "Knee", "ankle": "Ankle", "foot": "Toe", "collar": "Collar", "shoulder": "Shoulder",
        "elbow": "Elbow", "wrist": "Wrist", "hand": "Palm",
    }.items()
}  # fmt: skip
SMPL = {name: re.sub("^(l|r)(eft|ight)_", lambda m: f"{m[1].upper()}_", name).title() for name in JOINT_NAMES}
NAMINGS = {
    "mixamo": {name: f"mixamorig:{told}" for name, told in MIXAMO.items()},
    "hdm05": HDM05,
    "biovision": BIOVISION,
    "smpl": SMPL,
    "prefixed": {name: f"Model_{told}" for name, told in MIXAMO.items()},
    "blender": {name: re.sub("^(Left|Right)(.*)$", lambda m: f"{m[2]}.{m[1][0]}", told) for name, told in SMPL.items()}
    | {name: re.sub("^(L|R)_(.*)$", r"\2.\1", told) for name, told in SMPL.items()},
}


@pytest.fixture(scope="module")
def body() -> Body:
    return person(np.random.default_rng(0), 500)


def made_up(body: Body, frames: int = FRAMES, fps: float = FPS) -> Motion:
    """Everything moves smoothly; begins at the origin facing +Y, the lowest joint where it is when standing."""
    rng = np.random.default_rng(1)
    time = np.arange(frames)[:, None, None] / fps
    rate, size = rng.uniform(2, 6, (1, 23, 3)), rng.uniform(0.05, 0.6, (1, 23, 3))
    pose = size * np.sin(rate * time + rng.uniform(0, 6, (1, 23, 3)))
    pose[:, [21, 22]] = 0
    clock = time[:, 0, 0]
    root = Rotation.from_euler("ZX", np.stack([np.pi + 0.8 * clock, np.pi / 2 + 0.3 * np.sin(3 * clock)], -1))
    orientation = rotation_to_6d(torch.from_numpy(root.as_matrix())).numpy()
    path = np.stack([0.3 * np.sin(2 * clock), 1.1 * clock, 0.9 + 0.05 * np.cos(5 * clock)], -1)
    motion = Motion(path, orientation, pose, fps)
    motion.translation[:, 2] -= joint_paths(body, motion)[..., 2].min() - sole_height(body)
    return motion


def matrices(motion: Motion) -> np.ndarray:
    """Local rotations (T, 24, 3, 3)."""
    root = rotation_from_6d(torch.as_tensor(motion.orientation).double())
    joints = roma.rotvec_to_rotmat(torch.as_tensor(motion.body_pose).double())
    return torch.cat([root[:, None], joints], 1).numpy()


def assert_same(read: Motion, expected: Motion, joints=range(24)) -> None:
    """Within a thousandth of a radian and a millimetre."""
    between = matrices(read).swapaxes(-1, -2) @ matrices(expected)
    angles = Rotation.from_matrix(between.reshape(-1, 3, 3)).magnitude().reshape(between.shape[:2])
    assert angles[:, list(joints)].max() < 1e-3
    np.testing.assert_allclose(read.translation, expected.translation, atol=1e-3)
    assert read.fps == expected.fps and read.body_pose.dtype == np.float32


def write_npz(path, body, motion, count=24, up="z", turn=0.0, shift=(0.3, -2.0, 0.7), **changes):
    """As AMASS has it: another start, heading and scale, and the pelvis' resting place taken off."""
    turned = Rotation.from_euler("z", turn).as_matrix()
    world = turned if up == "z" else Y_TO_Z_UP.T @ turned
    local = matrices(motion)
    local[:, 0] = world @ local[:, 0]
    vectors = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(len(motion), 24, 3)
    poses = np.full((len(motion), count, 3), 0.3)
    poses[:, : min(count, 24)] = vectors[:, :count]
    if count > 24:
        poses[:, 22:] = 0.3  # fingers, jaw, eyes
    scale = SMPL_LEG_BONES / leg_bones(body.rest_joints)
    hips = motion.translation @ world.T + local[:, 0] @ hips_from_pelvis(body.rest_joints)
    trans = scale * hips - local[:, 0] @ SMPL_HIPS + shift
    data = {"poses": poses.reshape(len(motion), -1), "trans": trans, "mocap_framerate": np.array(motion.fps)}
    data = {name: value for name, value in (data | changes).items() if value is not None}
    np.savez(path, **data, gender=np.array("neutral"), betas=np.zeros(16))
    return path


@pytest.mark.parametrize("count", [22, 24, 52, 55])
@pytest.mark.parametrize("up", ["y", "z"])
def test_amass_round_trip(tmp_path, body, count, up):
    motion = made_up(body)
    path = write_npz(tmp_path / "m.npz", body, motion, count, up, turn=1.3)
    read, notes = read_motion(path, body, FRAMES, FPS)
    assert_same(read, motion)
    assert f"{FRAMES} frames at 20 Hz, {up} up" in notes[0]


def test_amass_names_of_its_newer_files(tmp_path, body):
    motion = made_up(body)
    path = write_npz(tmp_path / "m.npz", body, motion, 24)
    poses = np.load(path)["poses"]
    changes = {"poses": None, "root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "mocap_framerate": None}
    path = write_npz(tmp_path / "n.npz", body, motion, 24, **changes, mocap_frame_rate=np.array(FPS))
    assert_same(read_motion(path, body, FRAMES, FPS)[0], motion)


def test_npz_that_brings_its_skeleton(tmp_path, body):
    """As `hoi.runner.sample` writes it: the path is then the pelvis joint's of that skeleton."""
    motion = made_up(body)
    changes = {"rest_joints": 2 * body.rest_joints, "trans": 2 * motion.translation}
    assert_same(read_motion(write_npz(tmp_path / "m.npz", body, motion, **changes), body, FRAMES, FPS)[0], motion)


def test_resampled_begun_later_cut_and_held(tmp_path, body):
    fine = made_up(body, 6 * 12 + 1, 120.0)
    path = write_npz(tmp_path / "m.npz", body, fine)
    read, _ = read_motion(path, body, 5, 20.0)
    every_sixth = Motion(fine.translation[:30:6], fine.orientation[:30:6], fine.body_pose[:30:6], 20.0)
    assert_same(read, every_sixth)
    later, _ = read_motion(path, body, 4, 20.0, start_time=0.1)
    np.testing.assert_allclose(later.body_pose, fine.body_pose[12:36:6], atol=1e-3)
    np.testing.assert_allclose(later.translation[0, :2], 0, atol=1e-6)
    rest = Motion(fine.translation[12:], fine.orientation[12:], fine.body_pose[12:], 120.0)
    lift = sole_height(body) - joint_paths(body, rest)[..., 2].min()
    np.testing.assert_allclose(later.translation[:, 2], fine.translation[12:36:6, 2] + lift, atol=1e-3)
    left = rotation_from_6d(torch.from_numpy(later.orientation))[0, :, 0]
    assert left[0] < -0.99 and abs(left[1]) < 1e-6  # the body's left is at -x: it faces +Y
    held, notes = read_motion(path, body, 40, 20.0)
    assert "held for 27 of 40 frames" in notes[0]
    np.testing.assert_array_equal(held.body_pose[13:], np.repeat(held.body_pose[12:13], 27, 0))
    np.testing.assert_allclose(held.body_pose[12], fine.body_pose[72], atol=1e-3)


def test_up_can_be_said(tmp_path, body):
    """Somebody who lies may have his up axis along neither."""
    motion = made_up(body)
    lying = Motion(motion.translation, motion.orientation, motion.body_pose, FPS)
    lying.orientation[:] = Rotation.from_euler("x", np.pi / 4).as_matrix()[:2].reshape(6)  # between y and z
    path = write_npz(tmp_path / "m.npz", body, lying)
    with pytest.raises(InputError, match=r"^up: .*; say up=y or z$"):
        read_motion(path, body, FRAMES, FPS)
    assert "z up" in read_motion(path, body, FRAMES, FPS, up="z")[1][0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": None}, "lacks poses"),
        ({"trans": None, "mocap_framerate": None}, "lacks mocap_framerate; say"),
        ({"poses": np.zeros((FRAMES, 70))}, "poses has shape"),
        ({"trans": np.zeros((3, 3))}, "trans has shape"),
        ({"mocap_framerate": np.array(0.0)}, "mocap_framerate is 0.0"),
        ({"poses": np.full((FRAMES, 72), np.nan)}, "not finite"),
        ({"poses": np.array([{}] * FRAMES)}, "cannot be read"),
        ({"rest_joints": np.zeros((3, 3))}, "rest_joints has shape"),
    ],
)
def test_broken_npz_is_refused_in_one_line(tmp_path, body, changes, message):
    path = write_npz(tmp_path / "m.npz", body, made_up(body), **changes)
    with pytest.raises(InputError, match=message) as caught:
        read_motion(path, body, FRAMES, FPS)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_files_that_are_no_motion(tmp_path, body):
    (tmp_path / "a.npz").write_bytes(b"nothing")
    np.save(tmp_path / "b.npy", np.zeros(3))
    (tmp_path / "b.npy").rename(tmp_path / "b.npz")
    for name, message in (
        ("a.npz", "cannot be read"),
        ("b.npz", "one array"),
        ("c.fbx", r"from \.npz or \.bvh or \.npy"),
    ):
        with pytest.raises(InputError, match=message):
            read_motion(tmp_path / name, body, FRAMES, FPS)
    path = write_npz(tmp_path / "m.npz", body, made_up(body))
    with pytest.raises(InputError, match=r"start_time must be in \[0, 0\.4\] s"):
        read_motion(path, body, FRAMES, FPS, start_time=0.5)


# --- BVH --------------------------------------------------------------------------------------------------------------


def write_bvh(
    path, body, motion, names=MIXAMO, order="ZXY", scale=100.0, up="y", rest=None, extra=None, keep=JOINT_NAMES
):
    """Any naming, order of channels, unit and rest pose.

    Args:
        rest: world rotation of each joint's frame in the file's own zero pose, by name; default the identity.
        extra: joint names put between a joint and its parent, as CMU's LHipJoint.
        keep: joints that are written.
    """
    rest = rest or {}
    frames = {name: rest.get(name, np.eye(3)) for name in JOINT_NAMES}
    world = Rotation.from_euler("z", 0.7).as_matrix()
    world = Y_TO_Z_UP.T @ world if up == "y" else world
    local, global_ = matrices(motion), np.zeros((len(motion), 24, 3, 3))
    for joint, parent in enumerate(PARENTS):
        global_[:, joint] = world @ local[:, 0] if parent < 0 else global_[:, parent] @ local[:, joint]
    turned = {name: global_[:, row] @ frames[name].T for row, name in enumerate(JOINT_NAMES)}
    root = scale * (motion.translation @ world.T + (3.0, -1.0, 2.0))
    lines, columns = ["HIERARCHY"], []

    def channels(rotation):
        return Rotation.from_matrix(rotation).as_euler(order, degrees=True)

    def node(joint, indent):
        name, parent = JOINT_NAMES[joint], PARENTS[joint]
        pad, between = "\t" * indent, (extra or {}).get(name)
        above = turned[JOINT_NAMES[parent]] if parent >= 0 else None
        offset = np.zeros(3)
        if parent >= 0:
            offset = scale * frames[JOINT_NAMES[parent]] @ (body.rest_joints[joint] - body.rest_joints[parent])
        if between:
            lines.extend([f"{pad}JOINT {between}", pad + "{", pad + "OFFSET 0 0 0", pad + "CHANNELS 0"])
        rotation_names = " ".join(f"{axis}rotation" for axis in order)
        lines.extend([f"{pad}{'ROOT' if parent < 0 else 'JOINT'} {names[name]}", pad + "{"])
        lines.append(pad + "\tOFFSET " + " ".join(f"{value:.9f}" for value in offset))
        if parent < 0:
            lines.append(pad + f"\tCHANNELS 6 Xposition Yposition Zposition {rotation_names}")
            columns.extend([root, channels(turned[name])])
        else:
            lines.append(pad + f"\tCHANNELS 3 {rotation_names}")
            columns.append(channels(above.swapaxes(-1, -2) @ turned[name]))
        children = [child for child, of in enumerate(PARENTS) if of == joint and JOINT_NAMES[child] in keep]
        for child in children:
            node(child, indent + 1)
        if not children:
            lines.extend([pad + "\tEnd Site", pad + "\t{", pad + "\t\tOFFSET 0 0 0.1", pad + "\t}"])
        lines.extend([pad + "}"] * (2 if between else 1))

    node(0, 0)
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.9f}"]
    lines += [" ".join(f"{value:.7f}" for value in row) for row in np.concatenate(columns, axis=1)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("naming", NAMINGS)
def test_bvh_round_trip_whatever_the_names(tmp_path, body, naming):
    motion = made_up(body)
    read, notes = read_motion(write_bvh(tmp_path / "m.bvh", body, motion, NAMINGS[naming]), body, FRAMES, FPS)
    assert_same(read, motion)
    assert "y up" in notes[0]


@pytest.mark.parametrize(
    ("order", "scale", "up"), [("XYZ", 100.0, "z"), ("ZYX", 39.37, "y"), ("YXZ", 1.0, "y"), ("YZX", 2.25, "z")]
)
def test_bvh_round_trip_whatever_the_channels_and_the_unit(tmp_path, body, order, scale, up):
    motion = made_up(body)
    path = write_bvh(tmp_path / "m.bvh", body, motion, order=order, scale=scale, up=up)
    assert_same(read_motion(path, body, FRAMES, FPS)[0], motion)


def test_bvh_with_joints_that_smpl_has_not(tmp_path, body):
    motion = made_up(body)
    extra = {"left_hip": "LHipJoint", "right_hip": "RHipJoint", "head": "Neck1"}
    read, notes = read_motion(write_bvh(tmp_path / "m.bvh", body, motion, extra=extra), body, FRAMES, FPS)
    assert_same(read, motion)
    assert "LHipJoint" in notes[1] and "Neck1" in notes[1] and "LeftHandIndex1" in notes[1]


def test_bvh_with_few_joints(tmp_path, body):
    """Without toes, hands, collars and neck; a turn of a joint that is left out is lost, all others stay."""
    motion = made_up(body)
    absent = {"left_foot", "right_foot", "left_hand", "right_hand", "head"}
    motion.body_pose[:, [JOINT_NAMES.index(name) - 1 for name in absent]] = 0
    motion.translation[:, 2] -= joint_paths(body, motion)[..., 2].min() - sole_height(body)
    path = write_bvh(tmp_path / "m.bvh", body, motion, keep=set(JOINT_NAMES) - absent)
    motion.body_pose[:, JOINT_NAMES.index("neck") - 1] = 0  # without a head it leads nowhere
    assert_same(read_motion(path, body, FRAMES, FPS)[0], motion)


@pytest.mark.parametrize("feet", ["flat", "spread"])
def test_bvh_with_another_pose_at_rest(tmp_path, body, feet):
    """Arms that hang 50 degrees at rest, legs that are spread by 15, and the feet with them, as CMU's, or not."""
    motion, rest = made_up(body), {}
    for side, sign in (("left", 1), ("right", -1)):
        arm, leg = Rotation.from_euler("z", -sign * 0.87), Rotation.from_euler("z", sign * 0.26)
        rest |= {f"{side}_{part}": arm.as_matrix() for part in ("shoulder", "elbow", "wrist", "hand")}
        rest |= {
            f"{side}_{part}": leg.as_matrix() for part in ("hip", "knee", "ankle", "foot")[: 2 if feet == "flat" else 4]
        }
    read, _ = read_motion(write_bvh(tmp_path / "m.bvh", body, motion, rest=rest), body, FRAMES, FPS)
    parts = ("hip", "knee", "ankle", "foot")
    legs = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in parts]
    others = [joint for joint in range(24) if joint not in legs]
    np.testing.assert_allclose(matrices(read)[:, others], matrices(motion)[:, others], atol=1e-3)
    np.testing.assert_allclose(matrices(read)[:, legs], matrices(motion)[:, legs], atol=0.03)  # they lean, too
    millimetres = 1 if feet == "flat" else 5  # a foot that leans by 0.03
    np.testing.assert_allclose(joint_paths(body, read), joint_paths(body, motion), atol=1e-3 * millimetres)


def along_x(body: Body) -> dict[str, np.ndarray]:
    """Rest frames of a skeleton all of whose bones lie along x, as LaFAN's do: x up the trunk, z to the left."""
    trunk = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # rows: x is up, y is forward, z is left
    frames = {name: trunk for name in JOINT_NAMES}
    ends = {"hip": "knee", "knee": "ankle", "ankle": "foot", "collar": "shoulder", "shoulder": "elbow"}
    ends |= {"elbow": "wrist", "wrist": "hand"}
    for side in ("left", "right"):
        for part, end in ends.items():
            bone = body.rest_joints[JOINT_NAMES.index(f"{side}_{end}")]
            bone = bone - body.rest_joints[JOINT_NAMES.index(f"{side}_{part}")]
            x = bone / np.linalg.norm(bone)
            z = np.cross(x, (0, 0, 1.0) if part in ("collar", "shoulder", "elbow", "wrist") else (0, 1.0, 0.01))
            z = np.cross(x, (0, 0, 1.0)) if np.linalg.norm(z) < 0.2 else z
            z /= np.linalg.norm(z)
            frames[f"{side}_{part}"] = np.stack([x, np.cross(z, x), z])
        frames[f"{side}_foot"] = frames[f"{side}_ankle"]
        frames[f"{side}_hand"] = frames[f"{side}_wrist"]
    return frames


def test_bvh_with_all_bones_along_one_axis(tmp_path, body):
    """Places are exact; how limbs are turned about themselves is right where on average they are not turned."""
    motion = made_up(body, 60)
    motion.body_pose[:, [9, 10]] = 0  # toes
    path = write_bvh(tmp_path / "m.bvh", body, motion, rest=along_x(body))
    offsets = np.array([joint.offset for joint in read_bvh(path).joints])
    knees = [row for row, joint in enumerate(read_bvh(path).joints) if joint.name in ("LeftLeg", "LeftForeArm")]
    assert (offsets[knees, 0] > 20).all() and np.abs(offsets[knees, 1:]).max() < 1e-3
    read, _ = read_motion(path, body, 60, FPS)
    free = [j for j in range(24) if "hand" not in JOINT_NAMES[j]]
    np.testing.assert_allclose(joint_paths(body, read)[:, free], joint_paths(body, motion)[:, free], atol=2e-3)
    between = matrices(read).swapaxes(-1, -2) @ matrices(motion)
    angles = Rotation.from_matrix(between.reshape(-1, 3, 3)).magnitude().reshape(60, 24)
    assert angles[:, [0, 3, 6, 9]].max() < 1e-3 and angles.max() < 0.5


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("LeftUpLeg", ("left", "upleg")), ("RightHandIndex1", ("right", "handindex")), ("L_Hip", ("left", "hip")),
        ("upperleg01.R", ("right", "upperleg")), ("lfemur", ("left", "femur")), ("LThumb", ("", "lthumb")),
        ("lShldr", ("left", "shldr")), ("Spine1", ("", "spine")), ("lowerback", ("", "lowerback")),
        ("L Thigh", ("left", "thigh")), ("thigh_l", ("left", "thigh")), ("RHipJoint", ("right", "hipjoint")),
    ],
)  # fmt: skip
def test_names_are_taken_apart(name, expected):
    assert side_and_part(name) == expected


def test_trunk_is_found_by_its_place():
    """A spine of five joints under a root of its own."""
    names = ["Reference", "Hips", "A", "B", "C", "D", "E", "Neck", "Head"]
    parents = [-1, 0, 1, 2, 3, 4, 5, 6, 7]
    for side in ("Left", "Right"):
        for limb, base in ((("UpLeg", "Leg", "Foot"), 1), (("Arm", "ForeArm", "Hand"), 6)):
            for number, part in enumerate(limb):
                parents.append(base if number == 0 else len(names) - 1)
                names.append(side + part)
    told = {JOINT_NAMES[joint]: names[row] for joint, row in map_joints(names, parents).items()}
    trunk = {"pelvis": "Hips", "spine1": "A", "spine2": "C", "spine3": "E", "neck": "Neck", "head": "Head"}
    assert told.items() >= trunk.items()
    assert "left_collar" not in told and told["left_wrist"] == "LeftHand"
    with pytest.raises(InputError, match="no joint for left_knee, right_ankle; the skeleton has Reference"):
        map_joints([re.sub("LeftLeg|RightFoot", "Stick", name) for name in names], parents)
    swapped = [{"LeftLeg": "LeftFoot", "LeftFoot": "LeftLeg"}.get(name, name) for name in names]
    with pytest.raises(InputError, match="not in a row"):
        map_joints(swapped, parents)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("HIERARCHY", "SKELETON"), "no BVH file"),
        (lambda t: t.replace("MOTION", ""), "no BVH file"),
        (lambda t: t.replace("Frame Time", "Time"), "Frame Time"),
        (lambda t: re.sub("Frame Time: .*", "Frame Time: 0", t), "greater than 0"),
        (lambda t: t[:-40], "cut short"),
        (lambda t: t.replace("CHANNELS 3", "CHANNELS 2", 1), "as many of Xposition"),
        (lambda t: t.replace("OFFSET", "OFFSET x", 1), "could not convert"),
        (lambda t: t.replace("JOINT Spine\n", "HINGE Spine\n", 1), "'HINGE Spine' is not understood"),
        (lambda t: t.replace("}\nMOTION", "MOTION"), "not closed"),
        (lambda t: t.replace("}\nMOTION", "}\nROOT b\n{\n}\nMOTION"), "the one skeleton"),
        (lambda t: re.sub(r"\n[^\n]*\n$", "\n" + "nan " * 75 + "\n", t), "not finite"),
    ],
)
def test_broken_bvh_is_refused_in_one_line(tmp_path, body, change, message):
    path = write_bvh(tmp_path / "m.bvh", body, made_up(body))
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message) as caught:
        read_motion(path, body, FRAMES, FPS)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


FOREIGN = {
    "daz": {"hip": "{s}ThighBend", "knee": "{s}Shin", "ankle": "{s}Foot", "foot": "{s}Toe", "collar": "{s}Collar",
            "shoulder": "{s}ShldrBend", "elbow": "{s}ForearmBend", "wrist": "{s}Hand", "hand": "{s}Mid1"},
    "motive": {"hip": "{S}Thigh", "knee": "{S}Shin", "ankle": "{S}Foot", "foot": "{S}Toe", "collar": "{S}Shoulder",
               "shoulder": "{S}UArm", "elbow": "{S}FArm", "wrist": "{S}Hand", "hand": "{S}Middle1"},
    "german": {"hip": "Oberschenkel_{S}", "knee": "Unterschenkel_{S}", "ankle": "Fuss_{S}", "foot": "Zehen_{S}",
               "collar": "Schulter_{S}", "shoulder": "Oberarm_{S}", "elbow": "Unterarm_{S}", "wrist": "Handgelenk_{S}",
               "hand": "Finger_{S}"},
    "mmd": {"hip": "{j}足", "knee": "{j}ひざ", "ankle": "{j}足首", "foot": "{j}つま先", "collar": "{j}肩",
            "shoulder": "{j}腕", "elbow": "{j}ひじ", "wrist": "{j}手首", "hand": "{j}中指１"},
}  # fmt: skip
FOREIGN_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")


def foreign(naming: str) -> dict[str, str]:
    """SMPL joint -> its name there; of the trunk only a number, which tells nothing."""
    told = {name: f"bone_{row}" for row, name in enumerate(JOINT_NAMES) if name in FOREIGN_TRUNK}
    for side, marks in (("left", {"s": "l", "S": "L", "j": "左"}), ("right", {"s": "r", "S": "R", "j": "右"})):
        told |= {f"{side}_{part}": name.format(**marks) for part, name in FOREIGN[naming].items()}
    return told


@pytest.mark.parametrize("naming", [*FOREIGN, "numbers"])
def test_bvh_whose_names_tell_little(tmp_path, body, naming):
    """By the names of their limbs, or by the shape of the skeleton: neck and head too, which are called nothing."""
    motion = made_up(body)
    names = foreign(naming) if naming in FOREIGN else {name: f"j{3 * row}" for row, name in enumerate(JOINT_NAMES)}
    read, notes = read_motion(write_bvh(tmp_path / "m.bvh", body, motion, names), body, FRAMES, FPS)
    assert_same(read, motion)
    told = any("told by the shape" in note for note in notes)
    assert told == (naming in ("german", "mmd", "numbers"))


def test_bvh_with_a_file_of_names(tmp_path, body):
    motion, names = made_up(body), {name: f"j{3 * row}" for row, name in enumerate(JOINT_NAMES)}
    (tmp_path / "names.txt").write_text("".join(f"{ours} = {theirs}  # so\n" for ours, theirs in names.items()))
    path = write_bvh(tmp_path / "m.bvh", body, motion, names)
    assert_same(read_motion(path, body, FRAMES, FPS, names=tmp_path / "names.txt")[0], motion)
    (tmp_path / "names.txt").write_text("left_kne = j1\n")
    with pytest.raises(InputError, match=r"names: .*left_kne"):
        read_motion(path, body, FRAMES, FPS, names=tmp_path / "names.txt")


def test_bvh_in_left_handed_axes_is_mirrored(tmp_path, body):
    motion = made_up(body)
    lines = write_bvh(tmp_path / "m.bvh", body, motion, order="XYZ").read_text().splitlines()
    begin = next(row for row, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    for row, line in enumerate(lines):
        if row >= begin and line.strip():
            values = np.array(line.split(), float)
            values[0] *= -1
            values[3:] *= np.tile([1, -1, -1], len(values[3:]) // 3)
            lines[row] = " ".join(map(str, values))
        elif line.strip().startswith("OFFSET"):
            x, y, z = map(float, line.split()[1:])
            lines[row] = f"OFFSET {-x} {y} {z}"
    (tmp_path / "m.bvh").write_text("\n".join(lines))
    read, notes = read_motion(tmp_path / "m.bvh", body, FRAMES, FPS)
    assert_same(read, motion)
    assert any("left-handed" in note for note in notes)


def test_bvh_with_decimal_commas(tmp_path, body):
    motion = made_up(body)
    path = write_bvh(tmp_path / "m.bvh", body, motion)
    path.write_text(path.read_text().replace(".", ","))
    assert_same(read_motion(path, body, FRAMES, FPS)[0], motion)


def respelt(poses: np.ndarray, spelling: str) -> dict[str, np.ndarray]:
    """The same rotations as others write them."""
    turns = Rotation.from_rotvec(poses.reshape(-1, 3))
    count = poses.shape[1] // 3
    match spelling:
        case "aist":
            return {"smpl_poses": poses}
        case "estimator":
            return {"global_orient": poses[:, :3], "body_pose": poses[:, 3:]}
        case "estimator 63":
            return {"global_orient": poses[:, None, :3], "body_pose": poses[:, 3:66].reshape(len(poses), 21, 3)}
        case "matrices":
            return {"poses": turns.as_matrix().reshape(len(poses), count, 3, 3)}
        case "quaternions":
            return {"poses": turns.as_quat(scalar_first=True).reshape(len(poses), count, 4)}
        case "batch":
            return {"poses": poses[None]}
    return {"poses": np.degrees(poses)}


@pytest.mark.parametrize(
    "spelling", ["aist", "estimator", "estimator 63", "matrices", "quaternions", "batch", "degrees"]
)
def test_smpl_motions_however_they_are_spelt(tmp_path, body, spelling):
    motion = made_up(body)
    poses = np.load(write_npz(tmp_path / "m.npz", body, motion, 24))["poses"]
    path = write_npz(tmp_path / "n.npz", body, motion, 24, **({"poses": None} | respelt(poses, spelling)))
    assert_same(read_motion(path, body, FRAMES, FPS)[0], motion)


@pytest.mark.parametrize(
    ("changes", "note"),
    [({"mocap_framerate": np.array(1 / FPS)}, "time of a frame"), ({"trans": None}, "stays in place")],
)
def test_what_is_wrong_in_a_file_is_noticed(tmp_path, body, changes, note):
    path = write_npz(tmp_path / "m.npz", body, made_up(body), **changes)
    assert any(note in each for each in read_motion(path, body, FRAMES, FPS)[1])


def test_centimetres_are_noticed(tmp_path, body):
    motion = made_up(body)
    motion.translation[:, 1] *= 1.5
    trans = np.load(write_npz(tmp_path / "m.npz", body, motion))["trans"]
    read, notes = read_motion(write_npz(tmp_path / "n.npz", body, motion, trans=100 * trans), body, FRAMES, FPS)
    assert_same(read, motion)
    assert any("centimetres" in note for note in notes)


def test_two_frame_rates_are_refused_unless_one_is_said(tmp_path, body):
    motion = made_up(body)
    path = write_npz(tmp_path / "m.npz", body, motion, mocap_frame_rate=np.array(6 * FPS))
    with pytest.raises(InputError, match=r"mocap_framerate is 20 but mocap_frame_rate is 120; say which"):
        read_motion(path, body, FRAMES, FPS)
    assert_same(read_motion(path, body, FRAMES, FPS, rate=FPS)[0], motion)


@pytest.mark.parametrize("up", ["-y", "-z", "x", "-x"])
def test_up_may_be_any_axis(tmp_path, body, up):
    motion = made_up(body)
    whole = np.load(write_npz(tmp_path / "m.npz", body, motion))
    poses, trans = whole["poses"].copy(), whole["trans"]
    turn = TO_Z_UP[up].T
    root = turn @ Rotation.from_rotvec(poses[:, :3]).as_matrix()
    poses[:, :3] = Rotation.from_matrix(root).as_rotvec()
    hips = trans + Rotation.from_rotvec(whole["poses"][:, :3]).as_matrix() @ SMPL_HIPS
    path = write_npz(tmp_path / "n.npz", body, motion, poses=poses, trans=hips @ turn.T - root @ SMPL_HIPS)
    for said in ("auto", up):
        read, notes = read_motion(path, body, FRAMES, FPS, up=said)
        assert_same(read, motion)
        assert f"{up} up" in notes[0]
