"""Splat sequences: read back by the project's own readers, within what each format can say."""

from dataclasses import replace

import numpy as np
import pytest
from demo_run import make_run
from scipy.spatial.transform import Rotation

from hoi import gaussians
from hoi.data import GaussianCloud, Run
from hoi.errors import InputError
from hoi.export import clouds
from hoi.export.axes import AXES
from hoi.gaussians import covariances, read_gaussians, select, transform

FRAMES = 4


@pytest.fixture(scope="module")
def run() -> Run:
    """With harmonics of degree 1 on the object and none on the person."""
    made = make_run(frames=FRAMES, points=150, gaussians=60, particles=80, contact_frame=1.5)[0]
    rng = np.random.default_rng(3)
    thing = made.scene.object
    view = rng.uniform(-0.4, 0.4, (60, 3, 3)).astype(np.float32)
    scales = rng.uniform(0.002, 0.02, (60, 3)).astype(np.float32)
    cloud = replace(thing.cloud, sh=np.concatenate([thing.cloud.sh, view], 1), scales=scales)
    return replace(made, scene=replace(made.scene, object=replace(thing, cloud=cloud)))


def random_cloud(count: int, degree: int) -> GaussianCloud:
    rng = np.random.default_rng(count + degree)
    arrays = (
        rng.uniform(-3, 3, (count, 3)),
        Rotation.random(count, rng=rng).as_quat(scalar_first=True),
        np.exp(rng.uniform(-7, -1, (count, 3))),
        rng.uniform(0.02, 0.98, count),
        rng.uniform(-0.9, 0.9, (count, (degree + 1) ** 2, 3)),
    )
    return GaussianCloud(*(array.astype(np.float32) for array in arrays))


def angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Between rotations wxyz [rad]."""
    return 2 * np.arccos(np.clip(np.abs((one.astype(np.float64) * other).sum(-1)), 0, 1))


@pytest.mark.parametrize("degree", range(4))
def test_spz_comes_back_within_its_steps(tmp_path, degree):
    cloud = random_cloud(500, degree)
    gaussians.write_spz(cloud, tmp_path / "a.spz")
    back = read_gaussians(tmp_path / "a.spz")
    assert np.abs(back.means - cloud.means).max() < 1e-5
    assert angle(back.quaternions, cloud.quaternions).max() < 0.004
    assert np.abs(np.log(back.scales / cloud.scales)).max() <= 0.5 / 16 + 1e-4
    assert np.abs(back.opacities - cloud.opacities).max() <= 0.5 / 255 + 1e-6
    assert np.abs(back.sh[:, 0] - cloud.sh[:, 0]).max() <= 0.5 / 255 / 0.15 + 1e-5
    assert back.sh.shape == cloud.sh.shape
    if degree:
        assert np.abs(back.sh[:, 1:] - cloud.sh[:, 1:]).max() <= 0.5 / 128 + 1e-6


def test_spz_of_a_wide_scene_gives_up_digits_not_places(tmp_path):
    cloud = random_cloud(50, 0)
    gaussians.write_spz(replace(cloud, means=cloud.means * 1000), tmp_path / "a.spz")
    back = read_gaussians(tmp_path / "a.spz")
    assert np.abs(back.means - cloud.means * 1000).max() < 1e-3


@pytest.mark.parametrize("kind", ["ply", "splat", "spz"])
def test_sequence_is_the_scene_frame_by_frame(run, tmp_path, kind):
    clouds.write_sequence(run, tmp_path / kind, kind)
    assert sorted(p.name for p in (tmp_path / kind).iterdir()) == [f"frame_{i:04d}.{kind}" for i in range(FRAMES)]
    assert [p.name for p in tmp_path.iterdir()] == [kind], "nothing is left beside it"
    for frame, expected in zip(range(FRAMES), clouds.clouds(run), strict=True):
        back = read_gaussians(tmp_path / kind / f"frame_{frame:04d}.{kind}")
        assert np.abs(back.means - expected.means).max() < 1e-4
        trajectory = run.state.trajectory.positions[frame, :60]
        assert np.abs(back.means[150:] - trajectory).max() < 1e-4
        tolerance = {"ply": 1e-4, "splat": 0.04, "spz": 0.08}[kind]
        sizes = np.trace(covariances(expected), axis1=1, axis2=2)
        assert (np.abs(covariances(back) - covariances(expected)).max((1, 2)) < tolerance * sizes).all()
        assert np.abs(back.opacities - expected.opacities).max() < (1e-5 if kind == "ply" else 0.5 / 255 + 1e-6)
        if kind != "splat":
            assert np.abs(back.sh - expected.sh).max() < (1e-5 if kind == "ply" else 0.014)


def test_clouds_are_what_the_renderer_draws(run):
    from hoi.render.replay import replay
    from hoi.render.splats import join

    shown = replay(run)
    made = list(clouds.clouds(run))
    assert len(made) == FRAMES
    for frame, cloud in enumerate(made):
        splats = join(shown.parts(frame))
        assert np.abs(cloud.means - splats.means.numpy()).max() < 1e-5
        assert np.abs(covariances(cloud) - splats.covariances.numpy()).max() < 1e-7


def test_axes_turn_the_scene(run, tmp_path):
    clouds.write_sequence(run, tmp_path / "ply", "ply", axes="y-down")
    first = next(clouds.clouds(run))
    back = read_gaussians(tmp_path / "ply/frame_0000.ply")
    assert np.abs(-back.means[:, 1] - first.means[:, 2]).max() < 1e-5, "what was up is -y"
    again = transform(back, AXES["y-down"].T)
    assert np.abs(again.means - first.means).max() < 1e-4 and np.abs(again.sh - first.sh).max() < 1e-4
    for rotation in AXES.values():
        assert np.isclose(np.linalg.det(rotation), 1)


def test_a_sequence_is_replaced_as_a_whole_or_not_at_all(run, tmp_path, monkeypatch):
    folder = tmp_path / "spz"
    clouds.write_sequence(run, folder, "spz")
    (folder / "frame_0009.spz").write_bytes(b"of a longer run")
    before = {p.name: p.read_bytes() for p in folder.iterdir()}

    def broken(cloud, path):
        if "0002" in path.name:
            raise OSError(28, "No space left on device")
        gaussians.write_spz(cloud, path)

    with monkeypatch.context() as patch:
        patch.setitem(clouds.KINDS, "spz", broken)
        with pytest.raises(Exception, match="No space left"):
            clouds.write_sequence(run, folder, "spz")
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["spz"]
    clouds.write_sequence(run, folder, "spz")
    assert len(list(folder.iterdir())) == FRAMES


def test_a_folder_with_other_things_is_left_alone(run, tmp_path):
    (tmp_path / "ply").mkdir()
    (tmp_path / "ply/thesis.txt").write_text("dear")
    with pytest.raises(InputError, match=r"thesis\.txt"):
        clouds.write_sequence(run, tmp_path / "ply", "ply")
    assert [p.name for p in (tmp_path / "ply").iterdir()] == ["thesis.txt"]


def test_the_same_run_gives_the_same_bytes(run, tmp_path):
    for name in "ab":
        clouds.write_sequence(run, tmp_path / name, "spz")
    first, second = ((tmp_path / name / "frame_0002.spz").read_bytes() for name in "ab")
    assert first == second


def test_selecting_keeps_rows_of_a_part(run):
    person = select(next(clouds.clouds(run)), np.arange(150))
    assert person.sh.shape == (150, 4, 3) and not person.sh[:, 1:].any(), "the person's missing harmonics are zero"
