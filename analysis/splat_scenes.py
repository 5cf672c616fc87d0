"""What the renderer is measured on: the default scene, a synthetic cloud, a file; and the camera that shows it."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hoi.data import GaussianCloud
from hoi.gaussians import load_clean
from hoi.render.cameras import HEIGHT, VIEWS, WIDTH, Camera, frame_action
from hoi.render.splats import Splats, from_cloud

PERSON_GAUSSIANS = 26_000
"""Of the person of the default scene: with the object's the scene has more than 30,000."""
BAND_STRENGTH = (0.12, 0.06, 0.04)
"""Standard deviations of the synthetic cloud's harmonics of degree 1, 2, 3."""
LUMPS = 12
"""Waves that bend the synthetic cloud's surface."""
OUTLIERS = 0.005
"""Share of the Gaussians at either end of each axis that the camera need not show."""


def default_parts(person_gaussians: int = PERSON_GAUSSIANS) -> tuple[Splats, Splats]:
    """The person of the default scene, standing, and its object. Colours do not depend on the view."""
    from hoi.body.skinning import stand_motion
    from hoi.config import compose
    from hoi.render.replay import person_tensors, posed
    from hoi.runner.scene import build_scene

    scene = build_scene(compose.config_of(f"human.gaussians={person_gaussians}"))
    still = stand_motion(scene.body, 1, scene.fps)
    parameters = (torch.as_tensor(array) for array in (still.translation, still.orientation, still.body_pose))
    (person,) = posed(person_tensors(scene.body), *parameters)
    return person, from_cloud(scene.thing.cloud)


def synthetic_cloud(count: int, degree: int = 3, seed: int = 0) -> Splats:
    """Flat Gaussians of many sizes on a lumpy surface about 2 m across, with harmonics.

    Like what optimisation leaves: sizes are spread by a factor of e^1, opacities crowd at both ends, and each
    Gaussian's colour changes with the view by about 0.1.
    """
    rng = np.random.default_rng(seed)
    outward = rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    waves, phases = rng.normal(size=(LUMPS, 3)) * 3, rng.uniform(0, 2 * np.pi, LUMPS)
    radius = 1 + 0.04 * np.sin(outward @ waves.T + phases).sum(axis=1)
    spacing = np.sqrt(4 * np.pi / count)
    sizes = spacing * np.exp(0.5 * rng.normal(size=(count, 1)) + 0.3 * rng.normal(size=(count, 3)))
    sizes[:, 2] *= 0.2
    turns = np.column_stack([1 + outward[:, 2], -outward[:, 1], outward[:, 0], np.zeros(count)])  # z axis to outward
    sh = np.zeros((count, (degree + 1) ** 2, 3))
    sh[:, 0] = np.sin(outward @ rng.normal(size=(3, 3)) * 3) + 0.3 * rng.normal(size=(count, 3))
    for band in range(1, degree + 1):
        sh[:, band**2 : (band + 1) ** 2] = BAND_STRENGTH[band - 1] * rng.normal(size=(count, 2 * band + 1, 3))
    opacities = rng.beta(0.6, 0.6, count).clip(0.02, 0.99)
    arrays = (radius[:, None] * outward, turns / np.linalg.norm(turns, axis=1, keepdims=True), sizes, opacities, sh)
    return from_cloud(GaussianCloud(*(array.astype(np.float32) for array in arrays)))


def cloud_of_file(path: Path) -> Splats:
    """A 3DGS file as it stands.

    Raises:
        InputError: as `hoi.gaussians.load_clean`.
    """
    return from_cloud(load_clean(path)[0])


def camera_on(splats: Splats, width: int = WIDTH, height: int = HEIGHT) -> Camera:
    """Shows all but the outliers, from the three-quarter view."""
    means = splats.means.numpy().astype(np.float64)
    low, high = np.quantile(means, [OUTLIERS, 1 - OUTLIERS], axis=0)
    return frame_action(means.clip(low, high), VIEWS["three_quarter"], width=width, height=height)


def as_type(splats: Splats, dtype: torch.dtype, device: torch.device | str = "cpu") -> Splats:
    """The same numbers in another type or place."""

    def there(tensor: Tensor) -> Tensor:
        return tensor.to(device, dtype)

    means, covariances, opacities, sh = map(there, (splats.means, splats.covariances, splats.opacities, splats.sh))
    return Splats(means, covariances, opacities, sh, None if splats.turns is None else there(splats.turns))


@contextlib.contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Runs PyTorch, and with it the renderer, on so many threads of the CPU."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
