"""Objects: shapes look and weigh right, captures are cleaned and filled, placing puts them where asked."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import cloud_of
from captures import join
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from hoi import gaussians
from hoi.data import Array, GaussianCloud, Material
from hoi.errors import InputError
from hoi.objects import filling, load, shapes
from hoi.objects.solidity import THICKNESS

SHARED = Path(__file__).parents[3] / "shared" / "data" / "objects"
WOOD = Material("wood", "neo_hookean", 1e6, 0.3, 400.0, 0.5, 0.5)


def shell(radius: float = 0.5, count: int = 4000) -> GaussianCloud:
    """A closed ball-shaped cloud, as a good capture of a ball is."""
    normals = gaussians.fibonacci_sphere(count)
    spacing = radius * (4 * np.pi / count) ** 0.5
    return cloud_of(radius * normals, 0.4 * spacing)


def inertia(particles: Array, masses: Array) -> Array:
    arms = particles - np.average(particles, axis=0, weights=masses)
    return np.einsum(
        "p,pij->ij", masses, (arms**2).sum(1)[:, None, None] * np.eye(3) - arms[:, :, None] * arms[:, None]
    )


# --- built-in shapes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shapes.SHAPES)
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_builtin_is_a_closed_coloured_surface(name: str, factor: float) -> None:
    import trimesh

    shape = shapes.SHAPES[name]
    surface = shapes.build(shape, factor * max(shape.extent))
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0
    extent = factor * np.array(shape.extent)
    volume = {"ball": np.pi / 6, "cylinder": np.pi / 4, "box": 1.0}[shape.kind] * extent.prod()
    assert mesh.volume == pytest.approx(volume, rel=0.01)
    assert np.ptp(surface.cloud.means, axis=0) == pytest.approx(extent, rel=2e-3)
    assert 1000 <= len(surface.cloud) <= 12500
    rgb = gaussians.colours(surface.cloud)
    assert rgb.min() >= 0 and rgb.max() <= 1 and np.ptp(rgb, axis=0).max() > 0.3


@pytest.mark.parametrize("name", ["soccer_ball", "cardboard_box", "sand_bag"])
def test_gaussians_are_flat_lie_along_the_surface_and_are_evenly_spread(name: str) -> None:
    shape = shapes.SHAPES[name]
    cloud = shapes.build(shape, max(shape.extent)).cloud
    normals = gaussians.rotation_matrices(cloud)[:, :, 2]
    outward = cloud.means / np.linalg.norm(cloud.means, axis=1, keepdims=True)
    assert ((normals * outward).sum(1) > (0.999 if shape.kind == "ball" else 0.55)).all()
    assert (cloud.scales[:, 2] < 0.25 * cloud.scales[:, :2].min(1)).all()
    nearest = KDTree(cloud.means).query(cloud.means, 2)[0][:, 1]
    assert nearest.min() > 0.6 * np.median(nearest) and nearest.max() < 1.5 * np.median(nearest)


def test_soccer_ball_is_a_truncated_icosahedron() -> None:
    directions = gaussians.fibonacci_sphere(20000)
    black = shapes.SHAPES["soccer_ball"].pattern(directions, directions)[:, 0] < 0.1
    near = KDTree(directions[black]).query_ball_point(directions[black], 0.1)
    pieces = np.arange(len(near))
    for _ in range(50):  # every point takes the lowest label around it
        pieces = np.array([pieces[n].min() for n in near])
    assert len(np.unique(pieces)) == 12
    # The pentagons' share of the solid's area, less the half seams, is close to that of the sphere.
    pentagon, hexagon = 12 * 1.720477, 20 * 2.598076
    assert black.mean() == pytest.approx(pentagon / (pentagon + hexagon), abs=0.03)


# --- filling ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shapes.SHAPES)
@pytest.mark.parametrize("cells", [11, 32])
def test_builtin_volume_is_the_mesh_volume(name: str, cells: int) -> None:
    shape = shapes.SHAPES[name]
    size = max(shape.extent)
    surface = shapes.build(shape, size)
    loaded = load.load_builtin(name, size / cells)
    corners = surface.vertices[surface.faces]
    volume = np.linalg.det(corners).sum() / 6
    assert loaded.volumes.sum(dtype=np.float64) == pytest.approx(volume, rel=1e-4)
    np.testing.assert_array_equal(loaded.particles[: len(loaded.cloud)], loaded.cloud.means)
    assert loaded.volumes.shape == (len(loaded.particles),)
    assert loaded.volumes.min() > 0 and loaded.volumes.max() < 2.5 * (size / cells) ** 3
    half = np.array(shape.extent) / 2
    assert (np.abs(loaded.particles) <= half + 1e-6).all()


def test_fraction_solid_matches_the_mesh_before_it_is_scaled_to_it() -> None:
    surface = shapes.build(shapes.SHAPES["soccer_ball"], 0.22)
    axis = np.linspace(-0.12, 0.12, 97)
    inside = filling._inside_mesh(surface.vertices, surface.faces, [axis] * 3)
    radius = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)
    assert inside[radius < 0.1095].all() and not inside[radius > 0.1101].any()


def test_overlapping_closed_parts_are_solid_throughout() -> None:
    import trimesh

    boxes = [trimesh.creation.box(extents=(1, 1, 1)).apply_translation((0.5 * k, 0.1 * k, 0.2 * k)) for k in range(2)]
    vertices = np.concatenate([boxes[0].vertices, boxes[1].vertices])
    faces = np.concatenate([boxes[0].faces, boxes[1].faces + len(boxes[0].vertices)])
    axes = [np.linspace(-1, 2, 60)] * 3
    inside = filling._inside_mesh(vertices, faces, axes)
    each = [filling._inside_mesh(b.vertices, b.faces, axes) for b in boxes]
    np.testing.assert_array_equal(inside, each[0] | each[1])


def test_filled_ball_has_the_inertia_of_a_ball() -> None:
    loaded = load.load_builtin("soccer_ball", 0.22 / 32)
    masses = 77.0 * loaded.volumes.astype(np.float64)
    mass, radius = 77 * 4 / 3 * np.pi * 0.11**3, 0.11
    assert masses.sum() == pytest.approx(mass, rel=0.01)
    assert np.average(loaded.particles, axis=0, weights=masses) == pytest.approx(0, abs=1e-3 * radius)
    ball = 2 / 5 * mass * radius**2
    np.testing.assert_allclose(inertia(loaded.particles, masses), ball * np.eye(3), atol=0.03 * ball)


def test_density_is_even_where_gaussians_crowd() -> None:
    surface = shapes.build(shapes.SHAPES["cardboard_box"], 0.4)
    points = surface.cloud.means.astype(np.float64)
    crowded = np.concatenate([points, *[points[points[:, 0] > 0.19]] * 5])  # one side has six times as many
    filled = filling.fill_mesh(crowded, surface.vertices, surface.faces, 0.02)
    particles = np.concatenate([crowded, filled.interior])
    assert np.average(particles, axis=0, weights=filled.volumes) == pytest.approx(0, abs=0.4 * 2e-3)


@pytest.mark.parametrize("cells", [16, 24, 40, 64])
def test_closed_capture_is_solid(cells: int) -> None:
    cloud = shell()
    filled = filling.fill_cloud(cloud, 1.0 / cells)
    assert filled.volumes.sum() == pytest.approx(np.pi / 6, rel=0.06)
    assert filled.enclosed > 0.95
    assert len(filled.interior) > 0 and (np.linalg.norm(filled.interior, axis=1) < 0.5 + 1 / cells).mean() > 0.999
    particles = np.concatenate([cloud.means, filled.interior])
    expected = 2 / 5 * filled.volumes.sum() * 0.5**2
    np.testing.assert_allclose(np.diag(inertia(particles, filled.volumes)), expected, rtol=0.08)


def test_open_capture_is_a_sheet() -> None:
    bowl = gaussians.select(shell(), shell().means[:, 2] < 0)
    filled = filling.fill_cloud(bowl, 0.05)
    assert filled.enclosed < 0.05
    assert filled.volumes.sum() == pytest.approx(THICKNESS * 2 * np.pi * 0.5**2, rel=0.2)


def test_spacing_that_does_not_fit_is_refused() -> None:
    for spacing in (0.0, -1.0, np.nan, 0.2):
        with pytest.raises(InputError, match="spacing"):
            load.load_builtin("soccer_ball", spacing)
    with pytest.raises(InputError, match="coarser"):
        load.load_builtin("soccer_ball", 2e-4)


# --- captures --------------------------------------------------------------------------------------------------------


def test_haze_alone_is_no_object(tmp_path: Path) -> None:
    ball = shell()
    gaussians.write_splat(replace(ball, opacities=np.full(len(ball), 0.02, np.float32)), tmp_path / "haze.splat")
    with pytest.raises(InputError, match=r"haze\.splat: no solid object"):
        load.load_file(tmp_path / "haze.splat", 1.0, "+z", 0.05)


@pytest.mark.parametrize("up", load.UP)
def test_up_axis_ends_up(tmp_path: Path, up: str) -> None:
    ball = shell()
    head = gaussians.transform(gaussians.select(ball, np.arange(400)), np.eye(3), 0.4, [0, 0, 0.6])  # stands out on +z
    to_file = load.UP[up].T
    gaussians.write_ply(gaussians.transform(join(ball, head), to_file, 7.0, [3, 4, 5]), tmp_path / "o.ply")
    assert np.linalg.det(load.UP[up]) == pytest.approx(1)
    axis = {"x": 0, "y": 1, "z": 2}[up[1]]
    assert to_file[axis, 2] == (1 if up[0] == "+" else -1)
    loaded = load.load_file(tmp_path / "o.ply", 0.5, up, 0.025)
    means = loaded.cloud.means
    extent = np.ptp(means, axis=0)
    assert extent.max() == pytest.approx(0.5, rel=1e-4) and extent.argmax() == 2
    assert (means.min(0) + means.max(0)) == pytest.approx(0, abs=1e-5)
    assert means[:, 2].mean() < 0  # most of it is the body below


@pytest.mark.parametrize(
    ("change", "message"),
    [({"up": "z"}, "up axis 'z'"), ({"size": 0.0}, "size 0.0"), ({"size": np.nan}, "size nan"), ({"size": -1}, "size")],
)
def test_bad_file_arguments_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    gaussians.write_splat(shell(), tmp_path / "o.splat")
    arguments = {"path": tmp_path / "o.splat", "size": 1.0, "up": "+z", "spacing": 0.05} | change
    with pytest.raises(InputError, match=message):
        load.load_file(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["plant", "spot_10k"])
def test_real_captures(name: str) -> None:
    path = SHARED / f"{name}.splat"
    if not path.is_file():
        pytest.skip(f"{path.name} is not in the shared data")
    loaded = load.load_file(path, 0.8, "-y", 0.025, max_gaussians=20_000)
    assert len(loaded.cloud) <= 20_000
    assert np.ptp(loaded.cloud.means, axis=0).max() == pytest.approx(0.8, rel=0.01)
    assert 1e-3 < loaded.volumes.sum() < 0.2 and (loaded.volumes > 0).all()
    rgb, z = gaussians.colours(loaded.cloud), loaded.cloud.means[:, 2]
    if name == "plant":  # green leaves above a pot
        greenness = rgb[:, 1] - rgb[:, [0, 2]].mean(1)
        assert greenness[z > 0].mean() > greenness[z < -0.2].mean() + 0.05
        assert any("floating" in note for note in loaded.notes)
    else:  # a closed cow, lit from above
        assert rgb[z > 0.1].sum(1).mean() > rgb[z < -0.1].sum(1).mean()
        assert len(loaded.cloud) == 10_000 and len(loaded.particles) > 10_500


# --- placing ---------------------------------------------------------------------------------------------------------


def test_object_rests_on_the_ground_or_hangs_where_asked() -> None:
    loaded = load.load_builtin("file_cabinet", 0.06)
    resting = load.place(loaded, WOOD, position=(0.3, 1.2, None), yaw=0.5)
    assert resting.particles[:, 2].min() == pytest.approx(0, abs=1e-6)
    middle = (resting.cloud.means.min(0) + resting.cloud.means.max(0)) / 2
    assert middle == pytest.approx([0.3, 1.2, 0.5], abs=1e-4)
    hanging = load.place(loaded, WOOD, position=(0, 1, 2), velocity=(1, 2, 3), angular_velocity=(4, 5, 6))
    assert (hanging.cloud.means.min(0) + hanging.cloud.means.max(0)) / 2 == pytest.approx([0, 1, 2], abs=1e-5)
    np.testing.assert_array_equal(hanging.velocity, [1, 2, 3])
    np.testing.assert_array_equal(hanging.angular_velocity, [4, 5, 6])
    np.testing.assert_array_equal(hanging.particles[: len(hanging.cloud)], hanging.cloud.means)
    assert hanging.masses.sum() == pytest.approx(400 * 0.46 * 0.62 * 1.0, rel=0.01)


def test_placing_turns_particles_and_gaussians_alike() -> None:
    loaded = load.load_builtin("cardboard_box", 0.05)
    orientation = Rotation.random(None, np.random.default_rng(1)).as_quat(scalar_first=True)
    placed = load.place(loaded, WOOD, (0, 0, 1), yaw=0.7, orientation=3 * orientation)
    turn = (Rotation.from_euler("z", 0.7) * Rotation.from_quat(orientation, scalar_first=True)).as_matrix()
    np.testing.assert_allclose(placed.particles, loaded.particles @ turn.T + [0, 0, 1], atol=1e-5)
    covariances = turn @ gaussians.covariances(loaded.cloud) @ turn.T
    np.testing.assert_allclose(gaussians.covariances(placed.cloud), covariances, atol=1e-8)


def test_drawers_face_the_person() -> None:
    placed = load.place(load.load_builtin("file_cabinet", 0.06), WOOD, (0, 1, None))
    rgb, y = gaussians.colours(placed.cloud), placed.cloud.means[:, 1]
    assert np.std(rgb[np.isclose(y, y.min())]) > 2 * np.std(rgb[np.isclose(y, y.max())])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": (0, np.nan, 1)}, "position"),
        ({"position": (0, 1)}, "position"),
        ({"position": (None, 1, 1)}, "position"),
        ({"velocity": (1, 2)}, "velocity"),
        ({"angular_velocity": (0, 0, np.inf)}, "angular_velocity"),
        ({"orientation": (0, 0, 0, 0)}, "orientation"),
        ({"yaw": np.nan}, "yaw"),
    ],
)
def test_bad_placing_is_refused(change: dict[str, object], message: str) -> None:
    loaded = load.load_builtin("blue_ball", 0.03)
    with pytest.raises(InputError, match=message):
        load.place(loaded, WOOD, **change)  # type: ignore[arg-type]


def test_unknown_shape_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'teapot'.*soccer_ball"):
        load.load_builtin("teapot", 0.01)
