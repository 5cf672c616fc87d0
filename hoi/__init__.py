"""hoi: physically-aware 4D human-object interaction from a sentence and two Gaussian clouds.

    import hoi

    result = hoi.run(hoi.compose("scene=kick_soccer_ball", seed=1))

What can be called is described in `hoi.api`; nothing is imported before it is used.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hoi.api import compose, read, render, run, sample_motion, simulate, write
    from hoi.data import Body, Camera, GaussianCloud, Material, Motion, ObjectTrajectory, Run, Scene, SceneObject
    from hoi.errors import InputError, RunError

__version__ = "0.2.0"

# Read by OpenMP when torch is imported: a thread that waits sleeps. Beside another busy program spinning takes ten
# times as long.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__all__ = [
    "Body",
    "Camera",
    "GaussianCloud",
    "InputError",
    "Material",
    "Motion",
    "ObjectTrajectory",
    "Run",
    "RunError",
    "Scene",
    "SceneObject",
    "compose",
    "read",
    "render",
    "run",
    "sample_motion",
    "simulate",
    "write",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'hoi' has no attribute {name!r}; it has {', '.join(__all__)}")
    module = "api" if name.islower() else "errors" if name.endswith("Error") else "data"
    value = getattr(import_module(f"hoi.{module}"), name)
    return globals().setdefault(name, value)


def __dir__() -> list[str]:
    return __all__
