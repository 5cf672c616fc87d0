"""The GLB holds the record: joints, skinned and morphed vertices by a second reader, and what the validator says."""

from dataclasses import replace

import numpy as np
import pytest
from demo_run import make_run
from glb_files import Glb, validate
from scipy.spatial import KDTree

from hoi.body.people import load_person
from hoi.body.skinning import joint_frames, posed_means
from hoi.data import Run
from hoi.errors import InputError
from hoi.export.axes import linear
from hoi.export.glb import write_glb
from hoi.export.person import skinned_mesh, strongest
from hoi.export.surface import reconstruct
from hoi.export.thing import moving_mesh, rigid_rotations
from hoi.gaussians import fibonacci_sphere

FRAMES = 8
NEAR = 1e-4
"""What every position agrees to [m]."""


@pytest.fixture(scope="module")
def demo() -> Run:
    """A person of capsules; the ball turns, flies and is squashed after the kick."""
    return make_run(frames=FRAMES, points=1500, gaussians=300, particles=600, contact_frame=2.5)[0]


@pytest.fixture(scope="module")
def packaged(demo) -> Run:
    """A person of the package with an object that keeps its shape."""
    assert demo.scene is not None
    trajectory = demo.state.trajectory
    rotation = rigid_rotations(trajectory.positions)
    start = trajectory.positions[0].astype(np.float64) - trajectory.com[0]
    rigid = np.einsum("tij,nj->tni", rotation, start) + trajectory.com[:, None]
    moved = replace(trajectory, positions=rigid.astype(np.float32), deformation_gradient=None)
    scene = replace(demo.scene, body=load_person("man", 3000))
    return replace(demo, scene=scene, state=replace(demo.state, trajectory=moved))


@pytest.fixture(scope="module")
def files(demo, packaged, tmp_path_factory) -> dict[str, tuple[Run, Glb]]:
    folder = tmp_path_factory.mktemp("glb")
    runs = {"demo": demo, "packaged": packaged}
    for name, run in runs.items():
        write_glb(run, folder / f"{name}.glb")
    return {name: (run, Glb(folder / f"{name}.glb")) for name, run in runs.items()}


@pytest.mark.parametrize("name", ["demo", "packaged"])
def test_skeleton_and_clock_are_the_records(files, name):
    run, glb = files[name]
    assert len(glb.gltf.skins[0].joints) == 24 and len(glb.times) == FRAMES
    np.testing.assert_allclose(glb.times, np.arange(FRAMES) / 20, atol=1e-6)
    places = joint_frames(run.scene.body, run.state.motion)[1]
    for key in range(FRAMES):
        np.testing.assert_allclose(glb.joints(key), places[key], atol=NEAR)


@pytest.mark.parametrize("name", ["demo", "packaged"])
def test_object_is_where_the_record_has_it(files, name):
    run, glb = files[name]
    node, trajectory = glb.node("object"), run.state.trajectory
    for key in range(FRAMES):
        place = glb.world(key)[node][:3, 3]
        np.testing.assert_allclose([place[0], -place[2], place[1]], trajectory.com[key], atol=NEAR)
        surface = trajectory.positions[key, : len(run.scene.object.cloud)]
        assert KDTree(glb.vertices("object", key)).query(surface)[0].max() < 0.02
        assert np.abs(KDTree(surface).query(glb.vertices("object", key))[0]).max() < 0.02


def test_skinned_vertices_move_as_the_body_does(files):
    """The mesh's vertices in place of the Gaussians, posed by the project's own skinning."""
    run, glb = files["packaged"]
    body = run.scene.body
    mesh = skinned_mesh(body)
    dense = np.zeros((len(mesh.vertices), 24))
    np.add.at(dense, (np.arange(len(dense))[:, None], mesh.joints), mesh.weights)
    rows = np.arange(len(mesh.vertices)) % len(body.cloud)
    cloud = type(body.cloud)(*(getattr(body.cloud, f)[rows] for f in body.cloud.__dataclass_fields__))
    vertices = replace(body, cloud=replace(cloud, means=mesh.vertices), skinning_weights=dense)
    expected = posed_means(vertices, run.state.motion)
    for key in (0, 3, FRAMES - 1):
        np.testing.assert_allclose(glb.vertices("person", key), expected[key], atol=NEAR)


@pytest.mark.parametrize("name", ["demo", "packaged"])
def test_mesh_covers_the_gaussians(files, name):
    run, glb = files[name]
    seen = posed_means(run.scene.body, run.state.motion)
    for key in (0, 4):
        apart = KDTree(glb.vertices("person", key)).query(seen[key])[0]
        assert np.quantile(apart, 0.95) < 0.05, "all but those inside another limb"


def test_rigid_object_has_no_morph_targets_and_a_squashed_one_has(files):
    for name, expected in (("packaged", 0), ("demo", FRAMES - 3)):
        run, glb = files[name]
        targets = glb.primitive("object").targets or []
        assert len(targets) == expected == len(moving_mesh(run.scene.object, run.state.trajectory).offsets)
    first = glb.vertices("object", 0)
    squashed = glb.vertices("object", 3)  # F = (1.08, 0.8, 1.08) or so on the way out
    assert np.ptp(squashed, axis=0)[1] < 0.95 * np.ptp(first, axis=0)[1]


def test_colours_are_the_gaussians_in_linear_light(files):
    _, glb = files["packaged"]
    mesh = skinned_mesh(files["packaged"][0].scene.body)
    np.testing.assert_allclose(glb.colours("person"), linear(mesh.colours), atol=1e-4)
    np.testing.assert_allclose(linear(np.array([0.0, 0.5, 1.0])), [0, 0.21404, 1], atol=1e-5)


@pytest.mark.parametrize("name", ["demo", "packaged"])
def test_khronos_validator_has_nothing_to_say(files, name, tmp_path):
    write_glb(files[name][0], tmp_path / "scene.glb")
    issues = validate(tmp_path / "scene.glb")
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


def test_trimesh_reads_it(files, tmp_path):
    import trimesh

    write_glb(files["packaged"][0], tmp_path / "scene.glb")
    scene = trimesh.load(tmp_path / "scene.glb")
    transform, _ = scene.graph["object"]
    com = files["packaged"][0].state.trajectory.com[0]
    np.testing.assert_allclose(transform[:3, 3], [com[0], com[2], -com[1]], atol=NEAR)


def test_parts_that_are_missing_are_left_out(demo, tmp_path):
    write_glb(replace(demo, state=replace(demo.state, motion=None)), tmp_path / "object.glb")
    assert not Glb(tmp_path / "object.glb").gltf.skins
    write_glb(replace(demo, state=replace(demo.state, trajectory=None)), tmp_path / "person.glb")
    assert "object" not in [node.name for node in Glb(tmp_path / "person.glb").gltf.nodes]
    with pytest.raises(InputError, match="neither a motion nor a trajectory"):
        write_glb(replace(demo, state=replace(demo.state, motion=None, trajectory=None)), tmp_path / "none.glb")
    assert not (tmp_path / "none.glb").exists()


def test_what_comes_apart_is_shown_as_points(demo, tmp_path):
    rng = np.random.default_rng(0)
    trajectory = demo.state.trajectory
    flung = trajectory.positions.copy()
    flung[4:] += rng.normal(0, 0.5, flung[4:].shape).astype(np.float32)
    torn = replace(trajectory, positions=flung)
    write_glb(replace(demo, state=replace(demo.state, trajectory=torn)), tmp_path / "torn.glb")
    glb = Glb(tmp_path / "torn.glb")
    assert glb.primitive("object").mode == 0
    np.testing.assert_allclose(glb.vertices("object", 5), flung[5, :300], atol=NEAR)
    assert validate(tmp_path / "torn.glb")["numErrors"] == 0


def test_surface_of_a_sphere_is_closed_and_faces_outwards():
    import trimesh

    points = 0.3 * fibonacci_sphere(2000) + [1.0, 2.0, 3.0]
    mesh = trimesh.Trimesh(*reconstruct(points, points[:0], 0.01), process=False)
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.volume, 4 / 3 * np.pi * 0.3**3, rtol=0.02)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - [1, 2, 3], axis=1), 0.3, rtol=0.01)


def test_surface_closes_over_a_small_hole():
    import trimesh

    points = fibonacci_sphere(4000)
    with_hole = points[points[:, 2] < 0.99]
    mesh = trimesh.Trimesh(*reconstruct(with_hole, points[:0], 0.01), process=False)
    assert mesh.volume > 0.95 * 4 / 3 * np.pi


def test_strongest_keeps_four_and_their_sum():
    rng = np.random.default_rng(1)
    weights = rng.dirichlet(np.full(24, 0.2), 50)
    joints, kept = strongest(weights)
    np.testing.assert_allclose(kept.sum(1), 1)
    assert (np.take_along_axis(weights, joints.astype(int), 1).min(1) >= np.sort(weights, 1)[:, -4] - 1e-12).all()
    joints, kept = strongest(np.eye(24)[:3])
    assert joints.tolist() == [[0, 0, 0, 0], [1, 0, 0, 0], [2, 0, 0, 0]] and kept[:, 0].tolist() == [1, 1, 1]
