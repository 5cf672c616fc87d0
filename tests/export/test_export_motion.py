"""SMPL parameters and BVH are read back by the project's own readers; the CSV by pandas; USD by its own library."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from demo_run import make_run

from hoi.body.kinematics import forward_kinematics
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_frames
from hoi.data import Run
from hoi.errors import InputError
from hoi.export.axes import Y_UP
from hoi.export.motions import write_bvh, write_smpl
from hoi.export.trajectories import write_csv
from hoi.importers.amass import read_amass
from hoi.importers.bvh import read_bvh
from hoi.importers.motions import read_motion

FRAMES = 9
NEAR = 1e-4


@pytest.fixture(scope="module")
def run() -> Run:
    """Everything turns, each joint also about odd axes and beyond half a turn."""
    made = make_run(frames=FRAMES, points=200, gaussians=60, particles=90, contact_frame=3.0)[0]
    rng = np.random.default_rng(5)
    motion = made.state.motion
    pose = motion.body_pose + rng.normal(0, 0.8, motion.body_pose.shape).astype(np.float32)
    pose[2, 4] = (0.0, np.pi / 2, 0.0)  # some order's gimbal lock
    pose[3, 4] = (np.pi / 2, 0.0, 0.0)
    rest = made.scene.body.rest_joints + np.float32([0.01, -0.2, 0.03])  # as SMPL's, whose pelvis is not the origin
    body = replace(made.scene.body, rest_joints=rest)
    return replace(
        made, scene=replace(made.scene, body=body), state=replace(made.state, motion=replace(motion, body_pose=pose))
    )


@pytest.fixture(scope="module")
def places(run) -> np.ndarray:
    return joint_frames(run.scene.body, run.state.motion)[1]


def test_smpl_file_gives_the_joints_back(run, places, tmp_path):
    write_smpl(run, tmp_path / "smpl.npz")
    rest = run.scene.body.rest_joints.astype(np.float64)
    local, path, fps, _ = read_amass(tmp_path / "smpl.npz", rest)
    with np.load(tmp_path / "smpl.npz", allow_pickle=False) as data:
        start = data["trans"][0] + data["rest_joints"][0]
        assert data["poses"].shape == (FRAMES, 72) and data["betas"].shape == (10,)
        assert str(data["gender"]) == "neutral" and float(data["mocap_framerate"]) == 20
        assert np.array_equal(data["poses"][:, :3], data["root_orient"])
        assert np.array_equal(data["poses"][:, 3:66], data["pose_body"])
    np.testing.assert_allclose(start, run.state.motion.translation[0], atol=1e-6)
    path = path - path[0] + start  # the reader leaves a constant open
    joints = forward_kinematics(*(torch.from_numpy(array) for array in (local, path, rest)))[1].numpy()
    assert fps == 20
    np.testing.assert_allclose(joints, places, atol=NEAR)


def test_bvh_gives_the_joints_back(run, places, tmp_path):
    write_bvh(run, tmp_path / "motion.bvh")
    recording = read_bvh(tmp_path / "motion.bvh")
    order = [JOINT_NAMES.index(joint.name) for joint in recording.joints]
    assert sorted(order) == list(range(24)) and recording.fps == pytest.approx(20)
    _, positions = recording.poses()
    np.testing.assert_allclose(positions @ Y_UP, places[:, order], atol=NEAR)
    rest = run.scene.body.rest_joints
    np.testing.assert_allclose(recording.rest_positions(), (rest - rest[0])[order], atol=1e-6)
    assert np.abs(np.diff(recording.values[:, 3:], axis=0)).max() <= 180 + 1e-6, "no angle jumps by a turn"


def test_bvh_is_imported_as_a_motion(tmp_path):
    """The whole way back: a run may be started from it."""
    made = make_run(frames=FRAMES, points=200, gaussians=60, particles=90)[0]
    write_bvh(made, tmp_path / "motion.bvh")
    body = made.scene.body
    imported, notes = read_motion(tmp_path / "motion.bvh", body, FRAMES, 20.0)
    assert len(imported) == FRAMES and "y up" in notes[0]
    before, after = (joint_frames(body, motion)[1] for motion in (made.state.motion, imported))
    np.testing.assert_allclose(after - after[:, :1], before - before[:, :1], atol=NEAR)


def test_csv_has_object_and_joints(run, places, tmp_path):
    write_csv(run, tmp_path / "t.csv")
    table = pd.read_csv(tmp_path / "t.csv")
    trajectory = run.state.trajectory
    assert table["frame"].tolist() == list(range(FRAMES))
    np.testing.assert_allclose(table["time"], np.arange(FRAMES) / 20)
    np.testing.assert_allclose(table[["object_x", "object_y", "object_z"]], trajectory.com, atol=1e-6)
    np.testing.assert_allclose(table[["object_vx", "object_vy", "object_vz"]], trajectory.com_velocity, atol=1e-6)
    energies = table[["kinetic_energy", "elastic_energy", "potential_energy"]]
    np.testing.assert_allclose(energies, trajectory.energy, rtol=1e-6)
    assert tuple(table["phase"]) == trajectory.phase
    foot = places[:, JOINT_NAMES.index("right_foot")]
    np.testing.assert_allclose(table[[f"right_foot_{a}" for a in "xyz"]], foot, atol=1e-6)


def test_what_a_run_lacks_is_said_or_left_out(run, tmp_path):
    alone = replace(run, state=replace(run.state, motion=None))
    for write in (write_smpl, write_bvh):
        with pytest.raises(InputError, match="no motion"):
            write(alone, tmp_path / "a")
    assert not list(tmp_path.iterdir())
    write_csv(alone, tmp_path / "t.csv")
    assert "pelvis_x" not in pd.read_csv(tmp_path / "t.csv").columns


def test_usd_moves_as_the_record(run, places, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom, UsdSkel

    from hoi.export.usd import write_usd

    write_usd(run, tmp_path / "scene.usdc")
    assert (tmp_path / "scene.usdc").read_bytes()[:8] == b"PXR-USDC"
    stage = Usd.Stage.Open(str(tmp_path / "scene.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetEndTimeCode() - stage.GetStartTimeCode(), stage.GetTimeCodesPerSecond()) == (FRAMES - 1, 20)
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/scene/person/skeleton"))
    query = UsdSkel.Cache()
    query.Populate(UsdSkel.Root(stage.GetPrimAtPath("/scene/person")), Usd.PrimDefaultPredicate)
    thing = UsdGeom.Xformable(stage.GetPrimAtPath("/scene/object"))
    for frame in (0, 4, FRAMES - 1):
        turned = query.GetSkelQuery(skeleton).ComputeJointSkelTransforms(frame)
        joints = np.array([matrix.ExtractTranslation() for matrix in turned])
        np.testing.assert_allclose(joints, places[frame], atol=NEAR)
        place = thing.ComputeLocalToWorldTransform(frame).ExtractTranslation()
        np.testing.assert_allclose(place, run.state.trajectory.com[frame], atol=NEAR)
