"""People from a HUGS checkpoint (Kocabas et al. 2024): canonical Gaussians decoded from its triplane, in the T-pose.

A checkpoint holds points x_i in a canonical pose with spread legs, three feature planes and three small networks that
turn a point's features into its offset, rotation, scales, opacity, colour and skinning weights. What it lacks is the
person's betas and the body model: both come from the user, and decide where the canonical joints are.

To the T-pose: mu = sum_k w_ik A_k^{-1} (x_i + offset), with A_k the canonical pose's transforms, so that the T-pose is
exactly HUGS's own. Other poses differ from HUGS's by what blending A_pose and A_k^{-1} one after the other changes.
"""

import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import roma
import torch
from torch import Tensor
from torch.nn import functional

from hoi.body.avatar import LICENCE_MARK
from hoi.body.kinematics import forward_kinematics, rotation_from_6d
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, POSE_FEATURES
from hoi.data import Body, GaussianCloud
from hoi.errors import InputError, about
from hoi.files import check_downloaded
from hoi.importers.smpl import LICENCE as SMPL_LICENCE
from hoi.importers.smpl import read_smpl

LICENCE = f"Apple sample code licence of HUGS; {SMPL_LICENCE}"
CANONICAL_HIP = 1.0
"""Both hips turn outwards about z in the canonical pose [rad]; all else is as in the T-pose."""
TEMPERATURE = 0.1
"""Of the softmax over joints."""
HALF_EXTENT = 1.0
"""The triplane covers [-1, 1]^3 [m]."""
MARGIN = 2e-3
"""How far beyond it HUGS lets a point lie [m]."""
FAINTEST = 0.005
"""Opacity below which HUGS prunes."""
SMALLEST_SCALE = 1e-6
"""[m]; the scales' GELU may be slightly negative."""
SURFACE_THICKNESS = 1e-5
"""The third scale of flat Gaussians, of which the checkpoint has two [m]."""
COEFFICIENTS = 16
"""Harmonics of each Gaussian; those above the active degree are untrained."""
PLANES = ("plane_xy", "plane_xz", "plane_yz")


def load_hugs(checkpoint: Path, smpl: Path, betas: Sequence[float]) -> Body:
    """A person as HUGS has learned it, in the T-pose, the pelvis joint at the origin.

    Args:
        checkpoint: `human_*.pth`.
        smpl: the neutral SMPL file that it was trained with.
        betas: the person's shape, which HUGS keeps with the video, not in the checkpoint.

    Raises:
        InputError: a file is broken or not what it should be.
    """
    checkpoint = Path(checkpoint)
    joints = read_smpl(smpl).shaped(betas)[1]
    state = Checkpoint(checkpoint, read_checkpoint(checkpoint))
    with torch.no_grad():
        person = decode(state)
        seen = person.opacities >= FAINTEST
        if not seen.any():
            raise InputError(f"{checkpoint}: every Gaussian is fainter than {FAINTEST:g}; was it trained?")
        person = to_t_pose(person.kept(seen), torch.as_tensor(joints, dtype=torch.float32))
    cloud = GaussianCloud(
        means=person.means.numpy(),
        quaternions=roma.rotmat_to_unitquat(person.rotations)[:, [3, 0, 1, 2]].numpy(),
        scales=person.scales.numpy(),
        opacities=person.opacities.numpy(),
        sh=person.sh.numpy(),
    )
    return Body(
        checkpoint.stem,
        cloud,
        person.weights.numpy(),
        (joints - joints[0]).astype(np.float32),
        f"HUGS, {checkpoint.name}, betas {[round(float(beta), 4) for beta in betas]}{LICENCE_MARK}{LICENCE}",
        None if person.pose_directions is None else person.pose_directions.numpy().astype(np.float16),
    )


@dataclass(frozen=True)
class Decoded:
    """What the networks say of N Gaussians."""

    means: Tensor
    """[m], (N, 3)."""
    rotations: Tensor
    """(N, 3, 3)."""
    scales: Tensor
    """[m], (N, 3)."""
    opacities: Tensor
    """(N,)."""
    sh: Tensor
    """(N, K, 3)."""
    weights: Tensor
    """w_ik, (N, 24)."""
    pose_directions: Tensor | None
    """As in `hoi.data.Body`, where HUGS was trained with them, (N, 3, 207)."""

    def kept(self, rows: Tensor) -> "Decoded":
        """The Gaussians where `rows` (N,) is true."""
        kept: dict[str, Any] = {name: None if value is None else value[rows] for name, value in vars(self).items()}
        return Decoded(**kept)


class Checkpoint:
    """The tensors of a checkpoint, each asked for with the shape it must have."""

    def __init__(self, path: Path, values: Mapping[str, Any]) -> None:
        self.path, self.values = path, values

    def find(self, *names: str) -> Any:
        """What is there under these names, one in the other; None where there is nothing."""
        node: Any = self.values
        for name in names:
            node = node.get(name) if isinstance(node, Mapping) else None
        return node

    def tensor(self, *names: str, shape: tuple[int | None, ...]) -> Tensor:
        """In float32; None in `shape` allows any extent."""
        node = self.find(*names)
        with about(self.path), about(".".join(names)):
            if node is None:
                raise InputError("missing; not the human of a HUGS checkpoint")
            given = tuple(node.shape) if isinstance(node, Tensor) else None
            fits = given is not None and len(given) == len(shape)
            if not fits or any(want not in (None, have) for want, have in zip(shape, given or (), strict=True)):
                wanted = ", ".join("any" if extent is None else str(extent) for extent in shape)
                found = type(node).__name__ if given is None else f"shape {given}"
                raise InputError(f"{found}; must be a tensor of shape ({wanted})")
            if not torch.isfinite(node).all():
                raise InputError("holds values that are not finite")
        return node.detach().float()

    def linear(self, decoder: str, layer: str, x: Tensor, out: int | None) -> Tensor:
        """A layer of a decoder, applied to x (N, in)."""
        weight = self.tensor(decoder, f"{layer}.weight", shape=(out, x.shape[1]))
        return functional.linear(x, weight, self.tensor(decoder, f"{layer}.bias", shape=(len(weight),)))

    def trunk(self, decoder: str, features: Tensor) -> Tensor:
        """The two layers that each decoder starts with."""
        for layer in ("net.0", "net.2"):
            features = functional.gelu(self.linear(decoder, layer, features, None))
        return features


def decode(state: Checkpoint) -> Decoded:
    """The canonical Gaussians.

    Raises:
        InputError: a tensor is missing, misshapen or not finite, or a point lies outside the triplane.
    """
    points = state.tensor("xyz", shape=(None, 3))
    count = len(points)
    if count == 0 or points.abs().max() > HALF_EXTENT + MARGIN:
        raise InputError(f"{state.path}: xyz: must be points within [-1, 1]^3")
    features = _triplane(state, points / HALF_EXTENT)

    geometry = state.trunk("geometry_dec", features)
    scales = functional.gelu(state.linear("geometry_dec", "scales.1", geometry, None))
    scales = (scales * state.tensor("scaling_multiplier", shape=(count, 1))).clamp_min(SMALLEST_SCALE)
    if scales.shape[1] not in (2, 3):
        raise InputError(f"{state.path}: geometry_dec.scales.1.weight: {scales.shape[1]} scales; must be 2 or 3")
    if scales.shape[1] == 2:
        scales = functional.pad(scales, (0, 1), value=SURFACE_THICKNESS)

    appearance = state.trunk("appearance_dec", features)
    degree = state.values.get("active_sh_degree")
    if degree not in (0, 1, 2, 3):
        raise InputError(f"{state.path}: active_sh_degree={degree!r:.20}: must be 0, 1, 2 or 3")
    sh = state.linear("appearance_dec", "shs", appearance, 3 * COEFFICIENTS).unflatten(1, (COEFFICIENTS, 3))

    deformation = state.trunk("deformation_dec", features)
    direction = state.tensor("deformation_dec", "skinning_linear.weight_v", shape=(None, deformation.shape[1]))
    length = state.tensor("deformation_dec", "skinning_linear.weight_g", shape=(len(direction), 1))
    bias = state.tensor("deformation_dec", "skinning_linear.bias", shape=(len(direction),))
    weight = length * functional.normalize(direction, dim=1)  # weight normalisation
    skinning = functional.gelu(functional.linear(deformation, weight, bias))
    skinning = functional.gelu(state.linear("deformation_dec", "skinning", skinning, JOINT_COUNT))
    directions = None
    if state.find("deformation_dec", "blendshapes.weight") is not None:
        # HUGS reads the flattened (N, 621) array as (207, N, 3), and has learned it so.
        flat = state.linear("deformation_dec", "blendshapes", deformation, 3 * POSE_FEATURES)
        directions = flat.reshape(POSE_FEATURES, count, 3).permute(1, 2, 0)

    return Decoded(
        means=points + state.linear("geometry_dec", "xyz.1", geometry, 3),
        rotations=rotation_from_6d(state.linear("geometry_dec", "rotations.1", geometry, 6)),
        scales=scales,
        opacities=torch.sigmoid(state.linear("appearance_dec", "opacity.0", appearance, 1))[:, 0],
        sh=sh[:, : (degree + 1) ** 2],
        weights=torch.softmax(skinning / TEMPERATURE, dim=1),
        pose_directions=directions,
    )


def _triplane(state: Checkpoint, coordinates: Tensor) -> Tensor:
    """Features (N, 3 C) at coordinates (N, 3) in [-1, 1]: bilinear in (x, y), (x, z) and (y, z), the first across."""
    features = []
    for plane, axes in zip(PLANES, ([0, 1], [0, 2], [1, 2]), strict=True):
        grid = state.tensor("triplane", plane, shape=(1, None, None, None))
        sampled = functional.grid_sample(grid, coordinates[None, :, None, axes], align_corners=True)
        features.append(sampled[0, :, :, 0].T)
    return torch.cat(features, dim=1)


def canonical_transforms(joints: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations (24, 3, 3) and positions (24, 3) [m] of joints (24, 3) in the canonical pose, the pelvis unmoved."""
    pose = torch.zeros(JOINT_COUNT, 3).to(joints)
    pose[JOINT_NAMES.index("left_hip"), 2] = CANONICAL_HIP
    pose[JOINT_NAMES.index("right_hip"), 2] = -CANONICAL_HIP
    return forward_kinematics(roma.rotvec_to_rotmat(pose), joints[0], joints)


def to_t_pose(person: Decoded, joints: Tensor) -> Decoded:
    """The person with T-posed joints (24, 3) [m], moved so that the pelvis joint is at the origin."""
    rotations, positions = canonical_transforms(joints)
    back = rotations.mT  # A_k^{-1} x = R_k^T (x - p_k) + J_k
    shifts = joints - (back @ positions[..., None])[..., 0]
    turns = (person.weights @ back.flatten(1)).unflatten(1, (3, 3))
    means = (turns @ person.means[..., None])[..., 0] + person.weights @ shifts - joints[0]
    directions = None if person.pose_directions is None else turns @ person.pose_directions
    nearest = torch.as_tensor(roma.special_procrustes(turns))
    return replace(person, means=means, rotations=nearest @ person.rotations, pose_directions=directions)


def read_checkpoint(path: Path) -> Mapping[str, Any]:
    """The dictionary of a torch file, of which only tensors and plain values are read.

    Raises:
        InputError: the file cannot be read, is no dictionary, or names any other class.
    """
    scalar: Any = np.float64(0).__reduce__()[0]
    numbers: list[Any] = [(scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")]
    numbers += [np.dtype, np.dtypes.Float32DType, np.dtypes.Float64DType]
    check_downloaded(path)
    try:
        with torch.serialization.safe_globals(numbers):
            values = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    except UnpicklingError as error:
        named = re.search(r"GLOBAL ([\w.]+)", str(error))
        reason = f"names {named[1]}, which is no tensor; refused" if named else "not a checkpoint of plain tensors"
        raise InputError(f"{path}: {reason}") from None
    except (RuntimeError, EOFError, ValueError, TypeError, LookupError, AttributeError, zipfile.BadZipFile):
        raise InputError(f"{path}: not a whole torch checkpoint") from None
    if not isinstance(values, Mapping):
        raise InputError(f"{path}: holds a {type(values).__name__}; must be the dictionary of a HUGS human")
    return values
