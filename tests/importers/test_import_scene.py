"""Scene files of PhysGaussian and DreamPhysics: read, converted in the right units, composed and planned."""

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import cloud_of
from omegaconf import DictConfig

from hoi import gaussians
from hoi.config import Config, MaterialConf, MaterialModel
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.importers.physgaussian.reader import read_scene_file
from hoi.importers.scene import Imported, convert, parser, run
from hoi.mpm.materials import kirchhoff_stress, return_map
from hoi.plan import make_plan, material_of
from hoi.runner.scene import load_object
from hoi.stages.object.mpm import MPM

BALL = {  # as DreamPhysics writes it
    "opacity_threshold": 0.02, "rotation_degree": [90], "rotation_axis": [0], "substep_dt": 1e-4, "frame_dt": 4e-2,
    "frame_num": 50, "nu": 0.4, "E": 0.005, "material": "jelly", "density": 100, "g": [0, 0, -9.8],
    "grid_v_damping_scale": 0.9999, "rpic_damping": 0.0, "boundary_conditions": [{"type": "bounding_box"}],
    "mpm_space_vertical_upward_axis": [0, 0, 1], "default_camera_index": -1, "init_azimuthm": -120,
}  # fmt: skip
FIXED = {"velocity": [0, 0, 0], "start_time": 0, "end_time": 1e3, "reset": 1}
ALWAYS = {"friction": 0.0, "start_time": 0, "end_time": 1e3}
FLOOR = {"type": "surface_collider", "point": [1, 1, 0.4], "normal": [0, 0, 2], "surface": "sticky", **ALWAYS}
SAND = {  # as PhysGaussian writes it
    "substep_dt": 2e-5, "frame_dt": 4e-2, "frame_num": 25, "E": 5e7, "nu": 0.3, "material": "sand", "density": 2000,
    "g": [0.0, 0.0, -9.8], "friction_angle": 30, "n_grid": 200, "rotation_degree": [0.0], "rotation_axis": [0],
    "particle_filling": {"n_grid": 100, "max_partciels_per_cell": 1}, "boundary_conditions": [FLOOR],
}  # fmt: skip


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Any]:
    def from_values(values: dict[str, Any], dialect: str | None = None) -> Any:
        path = tmp_path / "a_scene.json"
        path.write_text(json.dumps(values))
        return read_scene_file(path, dialect)

    return from_values


@pytest.fixture
def convert_values(read: Callable[..., Any]) -> Callable[..., Imported]:
    return lambda values, **options: convert(read(values), "a_scene", **options)


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A solid-looking block of 2 x 1 x 0.5 units, off the origin."""
    axes = [np.linspace(0, side, count) for side, count in ((2, 41), (1, 21), (0.5, 11))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    shell = ((points == points.min(0)) | (points == points.max(0))).any(1)
    path = tmp_path / "block.ply"
    gaussians.write_ply(cloud_of(points[shell] + [5, -3, 2], 0.03), path)
    return path


@pytest.fixture
def imported(tmp_path: Path, composed: Callable[..., DictConfig]) -> Callable[..., Config]:
    """imported(values, *options) -> the checked config that a run makes of it."""

    def config(values: dict[str, Any], *options: str, overrides: tuple[str, ...] = ()) -> Config:
        source, folder = tmp_path / "a_scene.json", tmp_path / "out"
        source.write_text(json.dumps(values))
        run(parser().parse_args([str(source), "-o", str(folder), *options]))
        return to_config(composed(f"hydra.searchpath=[file://{folder}]", "scene=a_scene", *overrides))

    return config


# --- whole files -----------------------------------------------------------------------------------------------------


def test_dreamphysics_ball(imported, capsys):
    config = imported(BALL, "--size", "0.22", overrides=("object.path=ball.ply",))
    assert (config.material.model.value, config.material.youngs_modulus) == ("fixed_corotated", 5e4)
    assert (config.material.poisson_ratio, config.material.density) == (0.4, 100)
    assert (config.object.up, config.object.size, config.object.path) == ("+y", 0.22, "ball.ply")
    assert (config.scene.frames, config.scene.fps) == (40, 20)
    assert config.scene.gravity == [0, 0, -9.8]
    (floor,) = config.scene.planes or []
    assert (floor.contact.value, floor.normal, floor.point[2]) == ("slip", [0, 0, 1], pytest.approx(0))
    assert config.scene.placement.position[2] == pytest.approx(0.22 * (1 - 3 * 2 / 50))
    plan = make_plan(config)
    assert plan.keeps("free_motion") and any(check.name == "planes" for check in plan.checks)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].startswith("python -m hoi.run --config-dir ") and lines[-1].endswith(
        "scene=a_scene object.path=PATH"
    )
    for key in ("E", "init_azimuthm", "grid_v_damping_scale", "opacity_threshold", "frame_dt", "substep_dt"):
        assert any(key in line.split(": ")[0] for line in lines), key
    assert not any("rpic_damping" in line for line in lines), "0 does nothing, so nothing is lost"


def test_physgaussian_sand(imported, capsys):
    config = imported(SAND, overrides=("object.path=wolf.ply",))
    assert config.material.model.value == "drucker_prager"
    assert config.material.friction_angle == pytest.approx(math.radians(30))
    assert config.material.youngs_modulus == 5e7
    mover = config.stage.object
    assert isinstance(mover, MPM) and (mover.cells_across, mover.domain, mover.grid, mover.dt) == (
        None,
        2,
        200,
        2e-5,
    )
    (floor,) = config.scene.planes or []
    assert (floor.contact.value, floor.point[2]) == ("stick", pytest.approx(0))
    assert config.scene.placement.position[2] == pytest.approx(0.6)
    assert config.scene.frames == 20
    assert "particle_filling: the interior is filled in another way" in capsys.readouterr().out


def test_the_command_line_and_ablations_beat_the_import(imported):
    given = ("object.path=a.ply",)
    assert imported(SAND, overrides=(*given, "material=foam")).material.name == "foam"
    assert imported(SAND, overrides=(*given, "ablation=no_mpm")).stage.object.name == "constant_velocity"
    coarse = imported(SAND, overrides=(*given, "stage/object=mpm_coarse")).stage.object
    assert isinstance(coarse, MPM) and coarse.cells_across == 6


def test_the_printed_command_plans(tmp_path, block):
    (tmp_path / "my scene.json").write_text(json.dumps(BALL))
    module = [sys.executable, "-m"]
    options = ["my scene.json", "--name", "brick", "--object", str(block), "-o", "my configs"]
    done = subprocess.run([*module, "hoi.importers.scene", *options], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    command = done.stdout.splitlines()[-1].replace("python -m", " ".join(module)) + " plan_only=true"
    planned = subprocess.run(command, shell=True, capture_output=True, text=True, cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr
    assert "slip at" in planned.stdout


def test_a_name_of_ours_is_refused(tmp_path):
    (tmp_path / "foam.json").write_text(json.dumps(BALL))
    with pytest.raises(InputError, match="material=foam comes with hoi; give another --name"):
        run(parser().parse_args([str(tmp_path / "foam.json"), "-o", str(tmp_path)]))


# --- space -----------------------------------------------------------------------------------------------------------


def test_parts_are_where_they_were(imported, block):
    """The object in the file's frame: turned, scaled, centred at (1, 1, 1); its boxes hold the same Gaussians here."""
    part = {"point": [1.3, 1.0, 1.0], "size": [0.2, 0.6, 0.6], "E": 1e6, "nu": 0.2, "density": 70}
    values = {"E": 1e5, "g": [0, 0, -9.8], "rotation_degree": [90, 90], "rotation_axis": [0, 2], "scale": 0.8}
    config = imported(values | {"additional_material_params": [part]}, "--object", str(block), "--size", "0.4")
    (region,) = config.object.regions
    material = material_of(region.material)
    assert (material.youngs_modulus, material.poisson_ratio, material.density) == (1e6, 0.2, 70)
    thing = load_object(config)
    assert thing.region is not None
    x, y, z = gaussians.load_clean(block)[0].means.astype(np.float64).T
    x, y, z = x, -z, y  # 90 degrees about x
    x, y, z = -y, x, z  # 90 degrees about z
    theirs = np.stack([x, y, z], -1)
    theirs = (theirs - (theirs.min(0) + theirs.max(0)) / 2) * 0.8 / np.ptp(theirs, axis=0).max() + 1
    ours = thing.cloud.means - (thing.cloud.means.min(0) + thing.cloud.means.max(0)) / 2
    np.testing.assert_allclose(2 * (theirs - 1) * 0.25, ours, atol=1e-5)
    inside = (np.abs(theirs - part["point"]) < part["size"]).all(1)
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_array_equal(thing.region[: len(theirs)] == 1, inside)


def test_a_free_turn_keeps_the_size_it_stands_with(imported, block, capsys):
    values = {"E": 1e5, "g": [0, 0, -9.8], "rotation_degree": [30, -20], "rotation_axis": [1, 0], "scale": 0.5}
    part = {"point": [1, 1, 1], "size": [1, 1, 1], "E": 1e6, "nu": 0.2}
    thing = load_object(imported(values | {"additional_material_params": [part]}, "--object", str(block)))
    assert np.ptp(thing.cloud.means, axis=0).max() == pytest.approx(0.5, rel=1e-4)
    source = gaussians.load_clean(block)[0].means
    a, b = np.radians(30), np.radians(-20)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turned = source @ (about_x @ about_y).T
    shape = np.ptp(turned, axis=0) / np.ptp(turned, axis=0).max()
    np.testing.assert_allclose(np.ptp(thing.cloud.means, axis=0) / 0.5, shape, atol=1e-4)
    assert "additional_material_params: its boxes are not along the axes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("values", "up", "gravity"),
    [
        ({"g": [0, -9.8, 0]}, "+y", [0, 0, -9.8]),
        ({"g": [9.8, 0, 0]}, "-x", [0, 0, -9.8]),
        ({"g": [0, 0, 0], "mpm_space_vertical_upward_axis": [0, -1, 0]}, "-y", [0, 0, 0]),
        ({"g": [0, 0, -9.8], "mpm_space_vertical_upward_axis": [0, 1, 0]}, "+z", [0, 0, -9.8]),
        ({"g": [1, 0, -9.8]}, "+z", [1, 0, -9.8]),
    ],
)
def test_up_is_against_gravity(convert_values, values, up, gravity):
    imported = convert_values({"E": 1e5, **values})
    assert imported.object["up"] == up
    np.testing.assert_allclose(imported.scene["gravity"], gravity)


def test_planes_stand_to_the_object_as_in_the_file(convert_values):
    """g along -y, the object half as large: a wall 0.7 from the centre is 0.35 m from it."""
    wall = {"type": "surface_collider", "point": [1.7, 1, 1], "normal": [-1, 0, 0], "surface": "slip", **ALWAYS}
    rough = wall | {"point": [1, 0.5, 1], "normal": [0, 1, 0], "surface": "separate", "friction": 0.3}
    scene = convert_values({"E": 1e5, "g": [0, -9.8, 0], "boundary_conditions": [wall, rough]}, size=0.5).scene
    position = scene["placement"]["position"]
    assert position == [0, 1.25, 0.25]
    smooth, floor = scene["planes"]
    np.testing.assert_allclose(np.subtract(smooth["point"], position), [0.35, 0, 0])
    assert (smooth["contact"], smooth["normal"]) == ("slip", [-1, 0, 0])
    assert (floor["contact"], floor["friction"], floor["normal"]) == ("coulomb", 0.3, [0, 0, 1])
    assert floor["point"][2] == pytest.approx(0)
    assert scene["ground"] is False


@pytest.mark.parametrize(
    ("condition", "kept"),
    [
        ({"type": "cuboid", "point": [1, 1, 0.2], "size": [1, 1, 0.1], **FIXED}, [0, 0, 1]),
        ({"type": "cuboid", "point": [0.2, 1, 1], "size": [0.2, 1, 1], **FIXED}, [1, 0, 0]),
        ({"type": "cuboid", "point": [1, 1, 0.5], "size": [0.5, 0.5, 0.28], **FIXED}, None),
        ({"type": "cuboid", "point": [1, 1, 0.2], "size": [0.1, 1, 0.1], **FIXED}, None),
        ({"type": "cuboid", "point": [1, 1, 0.2], "size": [1, 1, 0.1], **FIXED, "velocity": [1, 0, 0]}, None),
        ({"type": "cuboid", "point": [1, 1, 0.2], "size": [1, 1, 0.1], **FIXED, "end_time": 0.5}, None),
        (FLOOR | {"start_time": 0.1}, None),
        (FLOOR | {"surface": "cut"}, None),
        ({"type": "enforce_particle_translation", "point": [1, 1, 1], "size": [1, 1, 1], **FIXED}, None),
    ],
)
def test_a_wall_is_kept_and_what_holds_the_object_is_reported(convert_values, condition, kept):
    condition = {k: v for k, v in condition.items() if k != "reset" or condition["type"] == "cuboid"}
    imported = convert_values({"E": 1e5, "g": [0, 0, -9.8], "boundary_conditions": [condition]})
    assert [plane["normal"] for plane in imported.scene["planes"]] == ([kept] if kept else [])
    reported = [line for line in imported.remarks if line.startswith(f"boundary_conditions.0 ({condition['type']}): ")]
    assert len(reported) == (0 if kept else 1)
    assert any(line.startswith("no floor") for line in imported.remarks) == (kept != [0, 0, 1])


def test_a_push_at_the_start_becomes_a_velocity(convert_values, block):
    """N particles, each given force dt, weigh density dx^3 a cell that holds any."""
    push = {"type": "particle_impulse", "force": [-0.18, 0, 0.1], "num_dt": 3, "start_time": 0}
    values = {"E": 2e6, "g": [0, 0, 0], "n_grid": 23, "density": 200, "boundary_conditions": [push]}
    velocity = np.array(convert_values(values, model=block).scene["placement"]["velocity"])
    points = gaussians.load_clean(block)[0].means.astype(np.float64)
    points = (points - (points.min(0) + points.max(0)) / 2) / np.ptp(points, axis=0).max() + 1
    dx = 2 / 23
    mass = 200 * dx**3 * len({tuple(cell) for cell in np.floor(points / dx).astype(int)})
    np.testing.assert_allclose(velocity, len(points) * np.array([-0.18, 0, 0.1]) * 3e-4 / mass, rtol=1e-3)


@pytest.mark.parametrize("change", [{"start_time": 0.5}, {"size": [0.1, 1, 1]}, {}])
def test_other_pushes_are_reported(convert_values, change):
    push = {"type": "particle_impulse", "force": [-0.18, 0, 0], **change}
    imported = convert_values({"E": 2e6, "g": [0, 0, 0], "boundary_conditions": [push]})
    assert imported.scene["placement"]["velocity"] == [0, 0, 0]
    assert any("boundary_conditions.0 (particle_impulse)" in line for line in imported.remarks)


# --- material and steps ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"material": "jelly"}, {"model": "fixed_corotated"}),
        ({"material": "sand"}, {"model": "drucker_prager", "friction_angle": math.radians(25)}),
        ({"material": "metal", "yield_stress": 100}, {"model": "von_mises", "yield_stress": 100 * math.sqrt(1.5)}),
        (
            {"material": "metal", "yield_stress": 100, "hardening": 1, "xi": 0.1, "nu": 0.25},
            {"yield_stress": 100 * math.sqrt(1.5), "hardening": 0.12},
        ),
        ({"material": "metal", "yield_stress": 100, "hardening": 0, "xi": 0.1}, {"model": "von_mises"}),
        ({"material": "plasticine", "yield_stress": 300}, {"model": "von_mises", "yield_stress": 300 * math.sqrt(1.5)}),
        (
            {"material": "foam", "yield_stress": 50, "plastic_viscosity": 10},
            {"model": "viscoplastic", "yield_stress": 50, "viscosity": 5},
        ),
        ({"material": "snow"}, {"model": "snow", "hardening": 10, "critical_compression": 0.025}),
    ],
)
def test_materials(convert_values, values, expected):
    material = convert_values({"E": 1e5, **values}).material
    assert {key: material[key] for key in expected} == pytest.approx(expected)
    assert ("hardening" in material) == ("hardening" in expected)


def test_metal_yields_at_the_same_stress(convert_values):
    """PhysGaussian's metal flows when |dev tau| is above yield_stress, and hardens by 2 mu xi |plastic strain|."""
    values = {"E": 1e6, "material": "metal", "yield_stress": 1e3, "hardening": 1, "xi": 0.3, "nu": 0.3}
    conf = MaterialConf(**convert_values(values).material)
    conf.model = MaterialModel(conf.model)
    material = material_of(conf)
    mu = 1e6 / 2.6
    e = np.array([0.02, -0.01, -0.01])  # Hencky strain, beyond yielding
    f, hardening = return_map(material, np.diag(np.exp(e))[None], np.zeros(1), 1e-4)
    stress = np.diag(kirchhoff_stress(material, f, np.zeros((1, 3, 3)), hardening)[0])
    plastic = np.linalg.norm(e) - np.linalg.norm(np.log(np.diag(f[0])))
    deviator = np.linalg.norm(stress - stress.mean())
    assert deviator == pytest.approx(1e3 + 2 * mu * 0.3 * plastic, rel=1e-6)


def test_a_step_above_the_limit_is_not_taken_over(convert_values):
    values = {"E": 1e5, "g": [0, 0, -9.8], "n_grid": 100}
    assert convert_values(values | {"substep_dt": 1e-4}).mover["dt"] == 1e-4
    assert convert_values(values | {"substep_dt": 1e-4}, size=0.5).mover["dt"] == 0.5e-4
    too_long = convert_values(values | {"substep_dt": 1e-3})
    assert "dt" not in too_long.mover and any(line.startswith("substep_dt: ") for line in too_long.remarks)
    assert convert_values({"E": 1e5}).mover == {}


def test_dialects(read):
    assert read({"E": 0.1}).numbers["E"] == pytest.approx(1e6)
    assert read({"E": 2e3}).numbers["E"] == 2e3
    assert read({"E": 0.1}, "physgaussian").numbers["E"] == 0.1
    part = {"point": [1, 1, 1], "size": [1, 1, 1], "E": 0.01, "nu": 0.4}
    (found,) = read({"E": 0.1, "density": 70, "additional_material_params": [part]}).parts
    assert (found["E"], found["density"]) == (pytest.approx(1e5), 70)


# --- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1, 2], "must hold one JSON object"),
        ({"g": 9.8}, "g must be a list of 3 numbers, got 9.8"),
        ({"g": [0, -9.8]}, "g must be a list of 3 numbers, got [0, -9.8]"),
        ({"E": "1e5"}, "E must be a number, got '1e5'"),
        ({"E": None}, "E must be a number, got None"),
        ({"E": True}, "E must be a number, got True"),
        ({"E": float("nan")}, "E must be a number, got nan"),
        ({"density": -1}, "density must be greater than 0, got -1"),
        ({"n_grid": 50.5}, "n_grid must be a whole number, got 50.5"),
        (
            {"material": "custard"},
            "material must be one of jelly, metal, sand, foam, snow, plasticine, watermelon, got 'custard'",
        ),
        ({"material": ["sand"]}, "material must be one of"),
        ({"rotation_degree": [90], "rotation_axis": []}, "rotation_degree and rotation_axis must be equally long"),
        ({"rotation_degree": [90], "rotation_axis": [3]}, "axes 0, 1 or 2"),
        ({"boundary_conditions": {}}, "boundary_conditions must be a list of JSON objects"),
        ({"boundary_conditions": [{"type": "box"}]}, "boundary_conditions.0.type must be one of bounding_box, "),
        (
            {"boundary_conditions": [{"type": "cuboid", "point": [1, 1, 1]}]},
            "boundary_conditions.0: needs size, velocity",
        ),
        ({"boundary_conditions": [FLOOR | {"normal": [0, 0, 0]}]}, "boundary_conditions.0.normal must not be zero"),
        ({"boundary_conditions": [FLOOR | {"surface": "wet"}]}, "surface must be one of sticky, slip, separate, cut"),
        (
            {"boundary_conditions": [FLOOR | {"point": [1, 1]}]},
            "boundary_conditions.0.point must be a list of 3 numbers",
        ),
        ({"additional_material_params": [{"E": 1}]}, "additional_material_params.0: needs point, size, nu"),
    ],
)
def test_bad_files_get_one_line(read, tmp_path, values, message):
    with pytest.raises(InputError) as caught:
        read({"E": 1e5, **values} if isinstance(values, dict) else values)
    assert message in str(caught.value) and str(tmp_path / "a_scene.json") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"nu": 0.5}, "jelly: material.poisson_ratio must lie in (-1, 0.5), got 0.5"),
        ({"material": "metal"}, "yield_stress must be given for metal"),
        ({"material": "sand", "friction_angle": 95}, "sand: material.friction_angle"),
    ],
)
def test_materials_that_cannot_be(convert_values, values, message):
    with pytest.raises(InputError, match=message.replace("(", r"\(").replace(")", r"\)")):
        convert_values({"E": 1e5, **values})


def test_unknown_keys_are_named(read, convert_values):
    remarks = read(
        {"E": 1e5, "frictoin_angle": 30, "boundary_conditions": [{"type": "bounding_box", "size": 3}]}
    ).remarks
    assert "frictoin_angle: unknown key, left out; did you mean friction_angle?" in remarks
    assert "boundary_conditions.0.size: unknown key, left out" in remarks
    unused = convert_values({"E": 1e5, "g": [0, 0, -9.8], "friction_angle": 30, "yield_stress": 10}).remarks
    assert "friction_angle, yield_stress: jelly does not use it" in unused


def test_bad_files_end_with_two(tmp_path):
    (tmp_path / "cut.json").write_text('{"E": 1e5,')
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\x00")
    for arguments, words in (
        (["cut.json"], "cut.json: not a JSON file: line 1"),
        (["bytes.json"], "bytes.json: not a JSON file"),
        (["none.json"], "none.json: No such file"),
        (["."], ".: Is a directory"),
    ):
        command = [sys.executable, "-m", "hoi.importers.scene", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 2 and done.stdout == ""
        assert words in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "0"], "--size must be greater than 0"),
        (["--size", "nan"], "--size must be greater than 0"),
        (["--name", "a b"], "--name must start with a letter"),
        (["--object", "nowhere.ply"], "nowhere.ply: cannot be read"),
    ],
)
def test_bad_options_are_named(tmp_path, options, message):
    (tmp_path / "a_scene.json").write_text(json.dumps(BALL))
    with pytest.raises(InputError, match=message):
        run(parser().parse_args([str(tmp_path / "a_scene.json"), "-o", str(tmp_path), *options]))


def test_a_byte_order_mark_is_skipped(tmp_path):
    (tmp_path / "a_scene.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(BALL).encode())
    assert read_scene_file(tmp_path / "a_scene.json").material == "jelly"


def test_a_watermelon_is_elastic_and_says_so(convert_values):
    values = {**BALL, "E": 2000.0, "material": "watermelon", "beta": 1.0, "xi": 3.0, "hardening": 1.0, "alpha_0": -0.04}
    imported = convert_values(values)
    assert imported.material["model"] == "fixed_corotated" and imported.material["youngs_modulus"] == 2000
    assert any("watermelon breaks" in remark for remark in imported.remarks)
