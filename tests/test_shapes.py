"""Each public function, called with a small example, takes and gives what the table of shapes says; see `shapes`."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from demo_run import make_run
from jaxtyping import TypeCheckError
from mpm_bodies import RUBBER, shaken
from render_scenes import camera, random_splats
from shapes import SHAPES, checked

import hoi
from hoi import api
from hoi.body import skinning
from hoi.data import Motion
from hoi.method import attraction, contact
from hoi.motion import features
from hoi.mpm import solver
from hoi.render.rasterise import rasterise

RUN = make_run()[0]
SCENE, MOTION, TRAJECTORY = RUN.scene, RUN.state.motion, RUN.state.trajectory
TINY = ("ablation=no_mpm", "stage/motion=none", "render=none", "human.gaussians=1000", "scene.frames=4")


def tensors(motion: Motion) -> list[torch.Tensor]:
    return [torch.from_numpy(part) for part in (motion.translation, motion.orientation, motion.body_pose)]


def struck(call) -> None:
    found = call(SCENE, MOTION, TRAJECTORY, tau=0.01, distance=0.3, between_frames=False)
    assert found.contacts


EXAMPLES = {
    api.run: lambda call, _: call(hoi.compose(*TINY, "scene.contact_frame=2", "stage.coordinate.iterations=1")),
    api.simulate: lambda call, _: call(SCENE.thing.cloud, "basketball", 0.1, cells_across=6),
    api.sample_motion: lambda call, _: call("a person kicks", frames=30),
    api.render: lambda call, _: call(SCENE.thing.cloud, camera()),
    api.write: lambda call, folder: call(RUN, folder / "run.mcap"),
    api.read: lambda call, folder: (api.write(RUN, folder / "run.mcap"), call(folder / "run.mcap")),
    attraction.choose_target: lambda call, _: call(skinning.joint_paths(SCENE.body, MOTION)),
    attraction.window: lambda call, _: call(7, RUN.state.target, 2.0, 3),
    attraction.attraction_loss: lambda call, _: (
        call(torch.zeros(7, 3), torch.ones(7, 3), torch.ones(7)),
        call(torch.zeros(2, 7, 3), torch.ones(2, 7, 3), torch.ones(2, 7)),
    ),
    contact.impulse: lambda call, _: call(np.ones(3), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.5),
    contact.find_contact: lambda call, _: struck(call),
    skinning.posed_means: lambda call, _: call(SCENE.body, MOTION, np.array([0.0, 1.5]), np.arange(4)),
    skinning.joint_paths: lambda call, _: call(SCENE.body, MOTION),
    skinning.joint_frames: lambda call, _: call(SCENE.body, MOTION),
    rasterise: lambda call, _: (
        call(random_splats(0, 50, 1, turned=True), camera(), depth=True),
        call(random_splats(0, 50), camera()),
    ),
    solver.simulate: lambda call, _: call(*shaken(), RUBBER, dx=0.05, dt=2e-4, times=np.array([0.0, 1e-3])),
    features.encode: lambda call, _: call(*tensors(MOTION), torch.from_numpy(SCENE.body.rest_joints)),
    features.decode: lambda call, _: (call(torch.ones(5, 205)), call(torch.ones(2, 5, 205))),
}


def name(function) -> str:
    return f"{function.__module__}.{function.__name__}"


@pytest.mark.parametrize("function", SHAPES, ids=name)
def test_shapes_are_those_of_the_table(function, tmp_path) -> None:
    """A row without an example fails here."""
    EXAMPLES[function](checked(function), tmp_path)


def test_the_api_is_in_the_table() -> None:
    """All of it that takes or gives arrays."""
    assert {getattr(api, name) for name in hoi.__all__ if name.islower()} - {api.compose} <= set(SHAPES)


SHORT = replace(MOTION, body_pose=MOTION.body_pose[:-1])
TURNED = replace(random_splats(0, 50), opacities=torch.ones(49).double())


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (attraction.attraction_loss, (torch.zeros(7, 3), torch.ones(6, 3), torch.ones(7))),
        (attraction.choose_target, (np.zeros((5, 23, 3)),)),
        (skinning.joint_paths, (SCENE.body, SHORT)),
        (rasterise, (TURNED, camera())),
        (contact.impulse, (np.ones(3), np.zeros(2), np.ones(3), 0.5)),
        (features.decode, (torch.ones(5, 204),)),
    ],
    ids=lambda value: name(value) if callable(value) else "",
)
def test_other_shapes_are_refused(function, arguments) -> None:
    with pytest.raises(TypeCheckError):
        checked(function)(*arguments)


def test_results_of_other_shapes_are_refused(monkeypatch) -> None:
    monkeypatch.setattr("hoi.body.skinning.joint_positions", lambda *_: torch.zeros(4, 24, 3))
    with pytest.raises(TypeCheckError):
        checked(skinning.joint_paths)(SCENE.body, MOTION)
