"""The Gaussians of a run in USD, Rerun and glTF, read back with their own libraries."""

from collections import defaultdict

import numpy as np
import pytest
from demo_run import make_run

from hoi.data import Run
from hoi.errors import InputError
from hoi.export import clouds, splats
from hoi.export.axes import Y_UP
from hoi.export.glb import write_collider
from hoi.gaussians import colours, covariances, read_file, transform

FRAMES = 6


@pytest.fixture(scope="module")
def run() -> Run:
    return make_run(frames=FRAMES)[0]


def test_usd_splats_hold_every_frame(run, tmp_path):
    pxr = pytest.importorskip("pxr")
    if not hasattr(pytest.importorskip("pxr.UsdVol"), "ParticleField3DGaussianSplat"):
        pytest.skip("usd-core is older than the schema")
    splats.write_usd_splats(run, tmp_path / "s.usdc")
    stage = pxr.Usd.Stage.Open(str(tmp_path / "s.usdc"))
    assert stage.GetEndTimeCode() == FRAMES - 1 and stage.GetTimeCodesPerSecond() == run.scene.fps
    assert pxr.UsdGeom.GetStageUpAxis(stage) == "Z" and pxr.UsdGeom.GetStageMetersPerUnit(stage) == 1
    for name, frames in clouds.moving_parts(run).items():
        field = pxr.UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath(f"/scene/{name}"))
        assert field
        for frame, cloud in enumerate(frames):
            np.testing.assert_allclose(np.array(field.GetPositionsAttr().Get(frame)), cloud.means, atol=1e-6)
            np.testing.assert_allclose(np.array(field.GetScalesAttr().Get(frame)), cloud.scales, atol=1e-7)
            np.testing.assert_allclose(np.array(field.GetOpacitiesAttr().Get(frame)), cloud.opacities, atol=1e-7)
            turns = field.GetOrientationsAttr().Get(frame)
            wxyz = np.array([[q.GetReal(), *q.GetImaginary()] for q in turns])
            np.testing.assert_allclose(wxyz, cloud.quaternions, atol=1e-6)
            sh = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(frame))
            np.testing.assert_allclose(sh.reshape(cloud.sh.shape), cloud.sh, atol=1e-6)
        degree = field.GetRadianceSphericalHarmonicsDegreeAttr().Get()
        assert (degree + 1) ** 2 == cloud.sh.shape[1]
    assert len(field.GetOpacitiesAttr().GetTimeSamples()) == 1, "what does not change is written once"


def test_rerun_splats_hold_every_frame(run, tmp_path):
    chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not here, or an older one")
    splats.write_rerun_splats(run, tmp_path / "s.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["s.rrd"]
    stored = defaultdict(list)
    for chunk in chunks.RrdReader(tmp_path / "s.rrd").stream():
        table = chunk.to_record_batch().to_pydict()
        names = {name: name.rpartition(":")[2] for name in table if name.startswith("GaussianSplats3D:")}
        for row in range(len(table["frame"]) if names else 0):
            values = {short: table[name][row] for name, short in names.items()}
            stored[chunk.entity_path].append({"frame": table["frame"][row]} | values)
    for name, frames in clouds.moving_parts(run).items():
        rows = sorted(stored[f"/scene/{name}"], key=lambda row: row["frame"])
        assert len(rows) == FRAMES
        for row, cloud in zip(rows, frames, strict=True):
            np.testing.assert_allclose(row["centers"], cloud.means, atol=1e-6)
            np.testing.assert_allclose(row["scales"], cloud.scales, atol=1e-7)
            np.testing.assert_allclose(row["quaternions"], cloud.quaternions[:, [1, 2, 3, 0]], atol=1e-6)
            rgba = np.array(row["colors"], "<u4")[:, None] >> np.array([24, 16, 8, 0]) & 255
            np.testing.assert_allclose(rgba[:, :3] / 255, np.clip(colours(cloud), 0, 1), atol=0.5 / 255 + 1e-6)
            np.testing.assert_allclose(rgba[:, 3] / 255, cloud.opacities, atol=0.5 / 255 + 1e-6)
            if cloud.sh.shape[1] > 1:
                higher = np.array(row["sh_coefficients"]).reshape(len(cloud), 15, 3)
                np.testing.assert_allclose(higher[:, : cloud.sh.shape[1] - 1], cloud.sh[:, 1:], atol=2e-3)


def test_khr_sequence_is_y_up_and_reads_back(run, tmp_path):
    clouds.write_sequence(run, tmp_path / "khr", "khr")
    files = sorted((tmp_path / "khr").iterdir())
    assert [file.name for file in files] == [f"frame_{frame:04d}.glb" for frame in range(FRAMES)]
    for file, cloud in zip(files, clouds.clouds(run), strict=True):
        back, turned = read_file(file), transform(cloud, Y_UP)
        assert back.up == "+y"
        np.testing.assert_allclose(back.cloud.means, turned.means, atol=1e-5)
        np.testing.assert_allclose(covariances(back.cloud), covariances(turned), atol=1e-7)
        np.testing.assert_allclose(colours(back.cloud), colours(turned), atol=1 / 255)


def test_the_collider_is_one_closed_mesh_around_the_object(run, tmp_path):
    import trimesh

    write_collider(run, tmp_path / "c.glb")
    mesh = trimesh.load(tmp_path / "c.glb", force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    assert mesh.is_watertight and mesh.volume > 0
    rest = run.state.trajectory.positions[0][: len(run.scene.thing.cloud)] @ Y_UP.T
    np.testing.assert_allclose(mesh.bounds, [rest.min(0), rest.max(0)], atol=0.02)


def test_what_is_missing_is_named(run, tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match="needs rerun-sdk"):
        splats.write_rerun_splats(run, tmp_path / "s.rrd")
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match="needs usd-core"):
        splats.write_usd_splats(run, tmp_path / "s.usdc")
