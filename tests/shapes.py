"""Shapes of what the public functions take and give, as a table that tests can hold them to.

The axes of one row are one call's: T frames, J = 24 joints, N Gaussians of a person, M of an object or in all, P
particles, K times. What stands in braces is worked out from the arguments.
"""

from collections.abc import Callable
from operator import attrgetter
from types import FunctionType
from typing import Annotated, Any

import numpy as np
from beartype import beartype
from beartype.vale import Is
from jaxtyping import Float, Integer, jaxtyped
from torch import Tensor

from hoi import api
from hoi.body import skinning
from hoi.data import Body, ContactSearch, GaussianCloud, Motion, ObjectState, ObjectTrajectory, Run, Scene
from hoi.method import attraction, contact
from hoi.motion import features
from hoi.mpm import solver
from hoi.render.rasterise import rasterise
from hoi.render.splats import Picture, Splats


def array(dims: str) -> Any:
    return Float[np.ndarray, dims]


def tensor(dims: str) -> Any:
    return Float[Tensor, dims]


def parts(of: type, shapes: dict[str, str], kind: Callable[[str], Any] = array) -> Any:
    """A dataclass of that type whose fields have these shapes."""
    return Annotated[of, Is[lambda value: fits(value, shapes, kind)]]


def each(of: type, name: str, shapes: dict[str, str]) -> Any:
    """A dataclass with a tuple `name` of dataclasses whose fields have these shapes."""
    return Annotated[of, Is[lambda value: all(fits(element, shapes, array) for element in getattr(value, name))]]


def fits(value: object, shapes: dict[str, str], kind: Callable[[str], Any]) -> bool:
    """Where a field is None, there is nothing to check."""
    fields = ((attrgetter(name)(value), kind(dims)) for name, dims in shapes.items())
    return all(field is None or isinstance(field, shape) for field, shape in fields)


def cloud(count: str, under: str = "") -> dict[str, str]:
    """Fields of a GaussianCloud, or of the one under `under.`."""
    shapes = {"means": "{n} 3", "quaternions": "{n} 4", "scales": "{n} 3", "opacities": "{n}", "sh": "{n} _ 3"}
    return {under + name: dims.format(n=count) for name, dims in shapes.items()}


def motion(frames: str, under: str = "") -> dict[str, str]:
    shapes = {"translation": "{t} 3", "orientation": "{t} 6", "body_pose": "{t} 23 3"}
    return {under + name: dims.format(t=frames) for name, dims in shapes.items()}


def trajectory(frames: str, under: str = "") -> dict[str, str]:
    shapes = {"positions": "{t} P 3", "com": "{t} 3", "com_velocity": "{t} 3", "energy": "{t} 3"}
    shapes["deformation_gradient"] = "{t} P 3 3"
    return {under + name: dims.format(t=frames) for name, dims in shapes.items()}


def state(under: str = "") -> dict[str, str]:
    shapes = {"positions": "P 3", "velocities": "P 3", "affine": "P 3 3", "deformation_gradient": "P 3 3"}
    return {under + name: dims for name, dims in shapes.items()}


def person(under: str = "") -> dict[str, str]:
    fields = {"skinning_weights": "N 24", "rest_joints": "24 3", "pose_directions": "N 3 207"}
    return {**cloud("N", f"{under}cloud."), **{under + name: dims for name, dims in fields.items()}}


def scene(under: str = "") -> dict[str, str]:
    fields = {"particles": "P 3", "volumes": "P", "velocity": "3", "angular_velocity": "3"}
    thing = {f"{under}thing.{name}": dims for name, dims in fields.items()}
    return {**person(f"{under}body."), **cloud("M", f"{under}thing.cloud."), **thing, f"{under}gravity": "3"}


BODY, MOTION = parts(Body, person()), parts(Motion, motion("T"))
OBJECT = parts(ObjectTrajectory, trajectory("T"))
CLOUD = parts(GaussianCloud, cloud("M"))
VECTOR = array("3")
RUN = parts(Run, {**scene("scene."), **motion("T", "state.motion."), **trajectory("T", "state.trajectory.")})
CONTACT = dict.fromkeys(("point", "normal", "v_human", "v_object", "v_post", "impulse"), "3")
SPLATS = {"means": "N 3", "covariances": "N 3 3", "opacities": "N", "sh": "N _ 3", "turns": "N 3 3"}
PICTURE = {"colour": "{camera.height} {camera.width} 3", "alpha": "{camera.height} {camera.width}"}
PICTURE["depth"] = PICTURE["alpha"]
RESULT = {"times": "K", "com": "K 3", "com_velocity": "K 3", "energy": "K 3", "collider_impulse": "K 3"}
MOVED = {"translation": tensor("*B T 3"), "orientation": tensor("*B T 6"), "body_pose": tensor("*B T 23 3")}

SHAPES: dict[Callable[..., Any], dict[str, Any]] = {
    # The API.
    api.run: {"return": RUN},
    api.simulate: {"cloud": CLOUD, "return": parts(ObjectTrajectory, trajectory("{round(seconds*fps)+1}"))},
    api.sample_motion: {"return": parts(Motion, motion("{frames}"))},
    api.render: {"cloud": CLOUD, "return": array("{camera.height} {camera.width} 3")},
    api.read: {"return": RUN},
    api.write: {"run": RUN},
    # The method.
    attraction.choose_target: {"joints": array("T 24 3")},
    attraction.window: {"return": array("{frames}")},
    attraction.attraction_loss: {
        "positions": tensor("*B T 3"), "goal": tensor("*B T 3"), "weights": tensor("*B T"), "return": tensor("*B"),
    },
    contact.impulse: {"v_human": VECTOR, "v_object": VECTOR, "normal": VECTOR, "return": tuple[float, VECTOR]},
    contact.find_contact: {
        "scene": parts(Scene, scene()), "motion": MOTION, "trajectory": OBJECT,
        "return": each(ContactSearch, "contacts", CONTACT),
    },
    # Bodies.
    skinning.posed_means: {
        "body": BODY, "motion": MOTION, "frames": array("F"), "subset": Integer[np.ndarray, "n"],
        "return": array("F n 3"),
    },
    skinning.joint_paths: {"body": BODY, "motion": MOTION, "return": array("T 24 3")},
    skinning.joint_frames: {
        "body": BODY, "motion": MOTION, "return": tuple[array("T 24 3 3"), array("T 24 3")],
    },
    # Pictures, the MPM, the prior's features.
    rasterise: {
        "splats": parts(Splats, SPLATS, tensor), "return": parts(Picture, PICTURE, tensor),
    },
    solver.simulate: {
        "state": parts(ObjectState, state()), "volumes": array("P"), "times": array("K"),
        "return": parts(solver.SimulationResult, {**RESULT, **state("final.")}),
    },
    features.encode: {**MOVED, "rest_joints": tensor("24 3"), "return": tensor("*B T 205")},
    features.decode: {"features": tensor("*B T 205"), "return": tuple[*MOVED.values()]},
}  # fmt: skip


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of the table, whose calls raise where shapes are not those of its row.

    A copy: the package itself names no shapes and checks none.
    """
    assert isinstance(function, FunctionType)
    parts = function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    copy = FunctionType(*parts)
    copy.__kwdefaults__, copy.__module__ = function.__kwdefaults__, function.__module__
    copy.__annotations__ = dict(SHAPES[function])
    return jaxtyped(copy, typechecker=beartype)
