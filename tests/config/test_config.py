"""Every option composes, the paper's numbers stand where they should, and bad values are named."""

import subprocess
import sys

import pytest
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.singleton import Singleton
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF
from hoi.config.compose import one_line
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.render.cameras import ACTION, HEIGHT, VIEWS, WIDTH
from hoi.stages.attraction.windowed import Windowed
from hoi.stages.contact import Detection
from hoi.stages.motion.hmsd import HMSD
from hoi.stages.object.mpm import MPM
from hoi.stages.render.video import Video, View

GROUPS = ["human", "object", "material", "scene", "experiment", "ablation", "render"]
GROUPS += [f"stage/{folder.name}" for folder in sorted((CONF / "stage").iterdir())]
EXTRA = {
    "object=from_file": ["object.path=thing.ply", "object.size=0.3"],
    "human=avatar": ["human.path=avatar.ply"],
    "human=smpl": ["human.path=SMPL_NEUTRAL.npz"],
    "stage/motion=file": ["stage.motion.path=walk.bvh"],
}
OPTIONS = [f"{group}={file.stem}" for group in GROUPS for file in sorted((CONF / group).glob("*.yaml"))]


def test_composing_leaves_hydra_as_it_was(composed):
    with initialize_config_dir(str(CONF), "another", version_base="1.2"):
        before = dict(Singleton._instances), ConfigStore.instance().repo.get("schema")
        assert composed("seed=3").seed == 3
        assert (dict(Singleton._instances), ConfigStore.instance().repo.get("schema")) == before


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_composes(composed, option):
    assert to_config(composed(option, *EXTRA.get(option, []))).seed == 0


def test_the_papers_numbers(composed):
    config = to_config(composed("experiment=paper"))
    motion, coordinate = config.stage.motion, config.stage.coordinate
    assert isinstance(motion, HMSD)
    assert (motion.iterations, motion.learning_rate, motion.guidance) == (100, 0.005, 7.5)
    assert (motion.t_min, motion.t_max) == (0, 100)
    assert (coordinate.iterations, coordinate.learning_rate, coordinate.lambda_hmsd) == (200, 0.005, 10.0)
    attraction = config.stage.attraction
    assert isinstance(attraction, Windowed)
    assert (attraction.lambda_attr, attraction.sigma, attraction.target.value) == (1.0, 2.0, "com")
    contact = config.stage.contact
    assert isinstance(contact, Detection)
    assert (contact.tau, contact.distance, contact.normal.value) == (0.05, 0.01, "centre_of_mass")
    pushed = to_config(composed("experiment=paper", "scene=push_box")).scene
    assert (pushed.striking_joints, pushed.hold) == (None, 0.0)
    material = config.material
    assert (material.youngs_modulus, material.poisson_ratio, material.restitution) == (1e7, 0.45, 0.6)
    mover = config.stage.object
    assert isinstance(mover, MPM)
    assert (mover.grid, mover.dt) == (64, 4e-5)
    assert mover.dt * 1250 == pytest.approx(1 / config.scene.fps)
    assert (config.scene.frames, config.scene.fps) == (40, 20)


def test_an_object_brings_its_material_and_the_command_line_beats_it(composed):
    assert to_config(composed("object=basketball")).material.name == "basketball"
    assert to_config(composed("object=basketball", "material=foam")).material.name == "foam"


def test_every_view_can_be_filmed(composed):
    assert [view.value for view in View] == [ACTION, *VIEWS]
    for name in (ACTION, *VIEWS):
        render = to_config(composed(f"render.view={name}")).render
        assert isinstance(render, Video) and render.view.value == name
        assert (render.width, render.height) == (WIDTH, HEIGHT)


def test_smoke_and_sweeps_make_no_video_unless_asked(composed):
    assert to_config(composed()).render.name == "video"
    assert to_config(composed("experiment=smoke")).render.name == "none"
    assert to_config(composed("experiment=smoke", "render=video")).render.name == "video"


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["object.size=0"], "object.size must be greater than 0 [m], got 0"),
        (["object.size=nan"], "object.size must be finite, got nan"),
        (["object.up=y"], "object.up must be one of auto, +x, -x, +y, -y, +z, -z, got y"),
        (["scene.gravity=[0,0]"], "scene.gravity must be a list of 3 numbers, got [0.0, 0.0]"),
        (["scene.placement.position=[null,1,1]"], "scene.placement.position must be numbers in x and y"),
        (["scene.expected_limb=tail"], "scene.expected_limb must be one of left_foot"),
        (["scene.striking_limb=tail"], "scene.striking_limb must be null or one of left_foot"),
        (
            ["scene.striking_joints=[left_hand,tail]"],
            "scene.striking_joints must be null, or two or more different ones of",
        ),
        (["scene.striking_joints=[left_hand]"], "scene.striking_joints must be null, or two or more different ones of"),
        (["scene.striking_joints=[left_hand,left_hand]"], "got ['left_hand', 'left_hand']"),
        (
            ["scene.striking_joints=[left_hand,right_hand]"],
            "scene.contact_joint must be one of scene.striking_joints: left_hand, right_hand, got right_foot",
        ),
        (["scene.hold=0.2"], "scene.hold must be 0: scene.striking_joints is null, got 0.2"),
        (["scene=push_box", "scene.hold=-1"], "scene.hold must be 0 or more [s], got -1"),
        (["scene.contact_frame=40"], "scene.contact_frame must be in [0, 39], got 40"),
        (["stage.contact.tau=0"], "stage.contact.tau must be in (0, 1], got 0"),
        (["stage.object.limit_fraction=1.5"], "stage.object.limit_fraction must be in (0, 1], got 1.5"),
        (["stage.object.grid=32"], "stage.object must be given either cells_across or both domain and grid"),
        (["render.width=97"], "render.width must be an even number in [16, 8192] [pixel], got 97"),
        (["render.height=8"], "render.height must be an even number in [16, 8192] [pixel], got 8"),
        (["render.width=10000"], "render.width must be an even number in [16, 8192] [pixel], got 10000"),
        (["scene.fps=2000"], "scene.fps must be in [0.1, 1000] [1/s] for a video, got 2000"),
        (["render.sh_degree=4"], "render.sh_degree must be 0, 1, 2 or 3, or null, got 4"),
        (["object=from_file"], "object.size: no value given"),
        (["object=from_file", "object.size=1"], "object.path must be the path of a 3DGS file, got None"),
        (["stage/motion=file"], "stage.motion.path"),
        (["stage.motion.init=file"], "stage.motion.path must be the path of a .npz, .bvh or .npy file"),
        (["stage.motion.path=walk.bvh"], "stage.motion.path must be null: stage.motion.init is sample, got walk.bvh"),
        (["stage.motion.start_time=-1"], "stage.motion.start_time must be 0 or more [s], got -1"),
        (["human=avatar"], "human.path must be the path of an avatar's folder or 3DGS PLY file, got None"),
        (["human=smpl"], "human.path must be the path of an SMPL .npz or .pkl file, got None"),
        (["human.betas=[1]"], "human.betas must be empty: human.kind is builtin, got [1.0]"),
    ],
)
def test_bad_values_are_named(composed, overrides, message):
    with pytest.raises(InputError) as caught:
        to_config(composed(*overrides))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("device=tpu", ["device", "tpu", "auto"]),
        ("ablation=no_fun", ["ablation", "no_fun", "no_mpm"]),
        ("scene.frame=3", ["frame", "scene"]),
        ("material.youngs_modulus=stiff", ["youngs_modulus", "stiff"]),
        ("stage.motion.iterations=1.5", ["iterations", "1.5"]),
        ("stage.object.kind=constant_velocity", ["kind", "stage.object"]),
        ("stage.contact.model=collider", ["model", "stage.contact"]),
        ("render=film", ["render", "film", "video"]),
        ("render.view=left", ["view", "left", "three_quarter"]),
        ("render.backend=cuda", ["backend", "cuda", "taichi"]),
        ("render.width=wide", ["width", "wide"]),
    ],
)
def test_composition_errors_becomeone_line(composed, override, words):
    with pytest.raises((HydraException, OmegaConfBaseException)) as caught:
        composed(override)
    line = one_line(caught.value)
    assert "\n" not in line
    assert all(word in line for word in words), line


def test_front_door_imports_nothing_heavy():
    heavy = ["torch", "taichi", "av", "mcap", "transformers", "matplotlib", "trimesh", "scipy", "pandas"]
    code = f"import sys, hoi.run, hoi.plan; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
