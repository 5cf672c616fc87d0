"""The scene around the object: ground and walls, parts of other materials, and what of it is refused."""

import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation

from hoi.config import CONF, MaterialConf
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.plan import make_plan, materials_of
from hoi.runner.execute import seeds
from hoi.runner.scene import build_scene, load_body, load_object

COARSE = ["stage/object=mpm_coarse", "object.max_gaussians=500", "human.gaussians=1000"]


@pytest.fixture
def build(composed):
    return lambda *overrides: build_scene(to_config(composed(*COARSE, *overrides)))


@pytest.fixture
def load(composed):
    """load(*overrides) -> a cardboard box without the rest of the scene."""
    box = ["object=cardboard_box", "scene.placement.position=[0.3,1.2,null]"]
    return lambda *overrides: load_object(to_config(composed(*COARSE, *box, *overrides)))


def lower_half(material: str) -> str:
    return f"object.regions=[{{box:{{centre:[0,0,-0.25],half_size:[0.6,0.6,0.25]}},material:{material}}}]"


def test_clothes_that_are_not_there_are_named_by_their_key(composed):
    config = to_config(composed("human=smpl", "human.path=nobody.npz", "human.person=king"))
    with pytest.raises(InputError, match=r"^human\.person='king': no such outfit"):
        load_body(config.human, 0)


# --- planes ----------------------------------------------------------------------------------------------------------


def test_the_ground_is_there_unless_taken_away(build):
    (ground,) = build("material.ground_friction=0.7").planes
    assert (ground.contact, ground.friction) == ("coulomb", 0.7)
    np.testing.assert_array_equal([ground.point, ground.normal], [[0, 0, 0], [0, 0, 1]])
    assert build("scene.ground=false", "scene.placement.position=[0,1,1]").planes == ()


def test_walls_come_after_the_ground(build):
    walls = "{point:[0,3,0],normal:[0,-2,0]},{point:[1,0,0],normal:[-3,0,4],contact:slip}"
    ground, straight, tilted = build(f"scene.planes=[{walls}]", "material.ground_friction=0.3").planes
    np.testing.assert_allclose([ground.normal, straight.normal, tilted.normal], [[0, 0, 1], [0, -1, 0], [-0.6, 0, 0.8]])
    assert (straight.contact, straight.friction) == ("coulomb", 0.3)
    assert (tilted.contact, tilted.friction) == ("slip", 0)
    np.testing.assert_array_equal(tilted.point, [1, 0, 0])


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["scene.placement.position=[0,1,0.05]"], ["0.0597 m deep in the ground", "leave z empty"]),
        (
            ["scene.planes=[{point:[0,1.1,0],normal:[0,-1,0]}]"],
            ["0.0598 m deep in scene.planes.0", "[0.0, -1.0, 0.0]"],
        ),
        (
            ["scene.planes=[{point:[0,9,0],normal:[0,-1,0]},{point:[0,0,0.05],normal:[0,0,1]}]"],
            ["0.05 m deep in scene.planes.1"],
        ),
    ],
)
def test_an_object_that_starts_in_a_plane_is_refused(build, overrides, words):
    with pytest.raises(InputError) as caught:
        build(*overrides)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_an_object_that_touches_a_wall_is_not_refused(build):
    build("scene.planes=[{point:[0,1.16,0],normal:[0,-1,0]}]")


@pytest.mark.parametrize(
    ("plane", "message"),
    [
        ("{point:[0,0],normal:[0,0,1]}", "scene.planes.0.point must be a list of 3 numbers, got [0.0, 0.0]"),
        ("{point:[0,0,0],normal:[0,0,0]}", "scene.planes.0.normal must be a list of 3 numbers, not all 0"),
        ("{point:[0,0,0],normal:[0,0,inf]}", "scene.planes.0.normal.2 must be finite, got inf"),
        ("{point:[0,0,0],normal:[0,0,1],friction:-1}", "scene.planes.0.friction must be 0 or more, or null, got -1"),
        (
            "{point:[0,0,0],normal:[0,0,1],contact:stick,friction:1}",
            "scene.planes.0.friction must be null: contact is stick, got 1",
        ),
        ("{normal:[0,0,1]}", "scene.planes[0].point: no value given"),
    ],
)
def test_bad_planes_are_named(composed, plane, message):
    with pytest.raises(InputError) as caught:
        to_config(composed(f"scene.planes=[{plane}]"))
    assert message in str(caught.value)


def test_without_ground_nothing_is_put_on_it(composed):
    with pytest.raises(InputError, match=r"scene\.placement\.position must be a number in z: no ground"):
        to_config(composed("scene.ground=false"))


def test_the_plan_lists_what_is_beside_the_ground(composed):
    def checks(*overrides):
        return {check.name: check for check in make_plan(to_config(composed(*overrides))).checks}

    assert not {"planes", "materials"} & set(checks())
    found = checks("scene.planes=[{point:[0,3,0],normal:[0,-1,0],contact:stick}]", lower_half("foam"))
    assert found["planes"].value == "2" and "stick at [0.0, 3.0, 0.0]" in found["planes"].detail
    assert found["materials"].detail == "soccer_ball, foam"


def test_a_tilted_gravity_does_not_leave_a_ball_at_rest(composed):
    assert not make_plan(to_config(composed())).keeps("free_motion")
    assert make_plan(to_config(composed("scene.gravity=[1,0,-9.81]"))).keeps("free_motion")


# --- regions ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(file.stem for file in (CONF / "material").glob("*.yaml")))
def test_a_named_material_is_that_of_the_group(composed, name):
    (region,) = to_config(composed(lower_half(name))).object.regions
    assert isinstance(region.material, MaterialConf)
    assert region.material == to_config(composed(f"material={name}")).material


def test_a_mapping_changes_the_objects_material(composed):
    config = to_config(composed("material=foam", lower_half("{name:filling,density:500}")))
    own, filling = materials_of(config)
    assert (filling.name, filling.density) == ("filling", 500)
    assert (filling.youngs_modulus, filling.model) == (own.youngs_modulus, own.model)


def test_a_mapping_with_a_model_is_whole(composed):
    whole = "name:jelly,model:neo_hookean,youngs_modulus:1e4,poisson_ratio:0.4,density:200,restitution:0"
    config = to_config(composed(lower_half(f"{{{whole},ground_friction:1}}")))
    assert materials_of(config)[1].model == "neo_hookean"
    with pytest.raises(InputError, match=r"object\.regions\[0\]\.material\.density.*: no value given"):
        to_config(composed(lower_half("{name:jelly,model:neo_hookean}")))


def test_what_is_recorded_has_the_whole_material(composed):
    given = composed(lower_half("foam"))
    (_, recorded), before = next(seeds(given, to_config(given))), given.object.regions[0].material
    again = OmegaConf.create(OmegaConf.to_yaml(recorded, resolve=True))
    assert before == "foam", "what is given is left as it is"
    assert again.object.regions[0].material.density == 40


@pytest.mark.parametrize(("axis", "yaw", "size"), [(0, 0.7, 0.4), (1, -2.0, 0.8), (2, 0.0, 0.4)])
def test_regions_turn_and_grow_with_the_object(load, axis, yaw, size):
    """Half of a box is heavier, on whichever side, at any yaw and size: masses follow."""
    centre, half = [0, 0, 0], [1, 1, 1]
    centre[axis], half[axis] = 0.25, 0.25
    region = f"object.regions=[{{box:{{centre:{centre},half_size:{half}}},material:{{density:180}}}}]"
    thing = load(f"scene.placement.yaw={yaw}", f"object.size={size}", region)
    assert [m.density for m in thing.materials] == [60, 180]
    assert thing.region is not None and thing.region.dtype == np.int32
    heavy = thing.region == 1
    assert thing.volumes[heavy].sum() == pytest.approx(thing.volumes.sum() / 2, rel=0.08)
    assert thing.masses.sum() == pytest.approx(60 * thing.volumes.sum() + 120 * thing.volumes[heavy].sum())
    side = Rotation.from_euler("z", yaw).apply(np.eye(3)[axis])
    distance = (thing.particles - middle(thing)) @ side
    assert (distance[heavy] > -1e-5).all() and (distance[~heavy] < 1e-5).all()


def middle(thing):
    return (thing.cloud.means.min(0) + thing.cloud.means.max(0)) / 2


def test_later_regions_win(load):
    inner = "{box:{centre:[0,0,0],half_size:[0.2,0.2,0.2]},material:stiff}"
    outer = "{box:{centre:[0,0,0],half_size:[1,1,1]},material:foam}"
    thing = load(f"object.regions=[{outer},{inner}]")
    inside = (np.abs(thing.particles - middle(thing)) <= 0.2 * 0.4).all(1)
    np.testing.assert_array_equal(thing.region, np.where(inside, 2, 1))
    assert [m.name for m in thing.materials] == ["cardboard", "foam", "stiff"]
    with pytest.raises(InputError, match=r"object\.regions\.0: no particle is left to stiff"):
        load(f"object.regions=[{inner},{outer}]")


def test_a_region_beside_the_object_is_refused(load):
    with pytest.raises(InputError) as caught:
        load("object.regions=[{box:{centre:[0,0,3],half_size:[1,1,1]},material:foam}]")
    message = str(caught.value)
    assert "object.regions.0: no particle is left to foam" in message and "[-0.5, 0.5]" in message


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ("custard", "object.regions.0.material: unknown material 'custard'; allowed are basketball, "),
        ("3", "object.regions.0.material must be a name or a mapping, got 3"),
        ("{desnity:3}", "object.regions.0.material: Key 'desnity' not in 'MaterialConf'"),
        ("{density:heavy}", "object.regions.0.material: Value 'heavy' of type 'str' could not be converted to Float"),
        ("{density:-1}", "object.regions.0.material.density must be positive"),
        ("{poisson_ratio:0.5}", "object.regions.0.material.poisson_ratio must lie in (-1, 0.5)"),
    ],
)
def test_bad_region_materials_are_named(composed, material, message):
    with pytest.raises(InputError) as caught:
        make_plan(to_config(composed(lower_half(material))))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ("{centre:[0,0],half_size:[1,1,1]}", "object.regions.0.box.centre must be a list of 3 numbers, got [0.0, 0.0]"),
        ("{centre:[0,0,0],half_size:[1,0,1]}", "object.regions.0.box.half_size must be greater than 0"),
        ("{centre:[0,0,0]}", "object.regions[0].box.half_size: no value given"),
    ],
)
def test_bad_boxes_are_named(composed, box, message):
    with pytest.raises(InputError) as caught:
        to_config(composed(f"object.regions=[{{box:{box},material:foam}}]"))
    assert message in str(caught.value)


# --- placing ---------------------------------------------------------------------------------------------------------


def test_orientation_turns_before_yaw(load):
    """A quarter turn about x lays a cabinet on its back, a half turn about z after that turns its top around."""
    cabinet = ["object=file_cabinet", "scene.placement.orientation=[1,1,0,0]", "scene.placement.yaw=3.14159265"]
    upright, lying, turned = (load(*cabinet[:count]) for count in (1, 2, 3))
    extents = [np.ptp(thing.cloud.means, axis=0) for thing in (upright, lying, turned)]
    assert np.ptp(extents[0]) > 0.3
    np.testing.assert_allclose(extents[1:], np.tile(extents[0][[0, 2, 1]], (2, 1)), atol=1e-5)
    tops = [(thing.cloud.means - middle(thing))[upright.cloud.means[:, 2].argmax()] for thing in (lying, turned)]
    assert tops[0][1] == pytest.approx(-0.5, abs=0.01) and tops[1][1] == pytest.approx(0.5, abs=0.01)


def test_a_bad_orientation_is_named(composed):
    with pytest.raises(InputError, match=r"scene\.placement\.orientation must be a quaternion wxyz that is not zero"):
        to_config(composed("scene.placement.orientation=[0,0,0,0]"))
