"""The motion prior: a denoiser with its statistics, text encoder and skeleton, from the package or a user's file."""

import json
import warnings
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from hoi.body.kinematics import leg_length
from hoi.body.skeleton import JOINT_COUNT
from hoi.body.skinning import sole_height
from hoi.data import Body, Motion
from hoi.errors import InputError
from hoi.files import check_downloaded, whole_file
from hoi.motion.diffusion import ancestral_sample, cosine_alphas_cumprod, guide
from hoi.motion.features import FEATURE_COUNT
from hoi.motion.files import CHECKPOINT, DESCRIPTION_NAME, REST_JOINTS_NAME, WEIGHTS_NAME, run_folder
from hoi.motion.mdm import Architecture, MotionDenoiser
from hoi.motion.text import TextEncoder, clip, default_cache, minilm

EMBEDDED = Path(__file__).parent / "weights"
FORMAT = "hoi motion prior 1"
STMC_LENGTHS = (40, 200)
"""Frames of the crops that the published prior was trained on."""
DENOISER_PREFIX = "denoiser."
STMC_EPSILON = 1e-12
NAMED = 4
"""Tensors that an error names of each kind."""
STATISTICS = ("motion_normalizer.mean", "motion_normalizer.std", "text_normalizer.mean", "text_normalizer.std")


@dataclass(frozen=True)
class MotionPrior:
    """p(X | text) as a denoiser on normalised features (see `hoi.motion.features`)."""

    denoiser: MotionDenoiser
    mean: Tensor
    """Of the features, (205,)."""
    std: Tensor
    text_mean: Tensor
    """Of the sentence embeddings, (text_dim,)."""
    text_std: Tensor
    text_encoder: TextEncoder
    rest_joints: Tensor
    """T-pose joints of the skeleton the prior was trained with [m], (24, 3)."""
    alphas_cumprod: Tensor
    """abar_t, float64, (timesteps,)."""
    fps: float
    source: str
    """Where it comes from, for the record."""
    lengths: tuple[int, int] = (40, 50)
    """Fewest and most frames that it knows as one motion. Trained on 40, the embedded one holds to 50: asked for 80, a
    walk goes half as far and the places of its joints are 0.2 m off its rotations', three times as far as at 40."""

    @property
    def device(self) -> torch.device:
        return self.mean.device

    @property
    def timesteps(self) -> int:
        return len(self.alphas_cumprod)

    def normalise(self, features: Tensor) -> Tensor:
        """(..., 205) -> zero mean, unit variance."""
        return (features - self.mean.to(features)) / self.std.to(features)

    def denormalise(self, normalised: Tensor) -> Tensor:
        """Inverse of `normalise`."""
        return normalised * self.std.to(normalised) + self.mean.to(normalised)

    def encode_text(self, prompts: list[str]) -> Tensor:
        """Normalised sentence embeddings, (B, text_dim). The empty sentence is the unconditional one."""
        return (self.text_encoder.embed(prompts).to(self.device) - self.text_mean) / self.text_std

    @cached_property
    def unconditional(self) -> Tensor:
        """The normalised embedding of the empty sentence, (1, text_dim)."""
        return self.encode_text([""])

    @torch.no_grad()
    def predict_x0(self, x_t: Tensor, t: Tensor, text: Tensor, guidance: float, rescale: float = 0.0) -> Tensor:
        """X0_hat(X_t, t, p) with classifier-free guidance, both branches in one forward pass. No gradient flows.

        Args:
            x_t: noised normalised features, (B, T, 205).
            t: timesteps 0 .. timesteps - 1, integers, (B,).
            text: rows of `encode_text`, (B, text_dim) or (1, text_dim).
            guidance: scale g; 1 is the conditional prediction alone.
            rescale: see `hoi.motion.diffusion.guide`.

        Returns:
            Normalised features, (B, T, 205), in the dtype of x_t.
        """
        batch = len(x_t)
        x, text = x_t.to(self.mean.dtype), text.expand(batch, -1)
        if guidance == 1:
            return self.denoiser(x, t, text).to(x_t.dtype)
        both = torch.cat([self.unconditional.expand(batch, -1), text])
        without, with_text = self.denoiser(x.repeat(2, 1, 1), t.repeat(2), both).chunk(2)
        return guide(without, with_text, guidance, rescale).to(x_t.dtype)

    def sample(
        self,
        prompt: str,
        frames: int,
        guidance: float,
        generator: torch.Generator,
        stmc_compat_sigma: bool = False,
    ) -> Tensor:
        """Draw a motion: unnormalised features (frames, 205), for `hoi.motion.features.decode`."""
        text = self.encode_text([prompt])
        x0 = ancestral_sample(
            lambda x, t: self.predict_x0(x, t, text, guidance),
            (1, frames, FEATURE_COUNT),
            self.alphas_cumprod,
            generator,
            device=self.device,
            stmc_compat_sigma=stmc_compat_sigma,
        )
        return self.denormalise(x0)[0]

    def on_body(self, motion: Motion, body: Body) -> Motion:
        """The motion of the prior's skeleton on a body of other size, its soles on the ground."""
        ratio = float(leg_length(torch.as_tensor(body.rest_joints)) / leg_length(self.rest_joints.cpu()))
        translation = motion.translation * np.float32(ratio)
        translation[:, 2] += sole_height(body)
        return replace(motion, translation=translation)


def load_prior(
    path: str | Path | None = None,
    device: torch.device | str = "cpu",
    clip_folder: str | Path | None = None,
    rest_joints: Tensor | None = None,
    text_cache: Path | None = None,
) -> MotionPrior:
    """Load a motion prior.

    Args:
        path: None for the one in the package; a folder with prior.json and prior.safetensors; or an STMC run folder
            (config.json, logs/checkpoints/last.ckpt, and what is not its own: clip/, rest_joints.npy) or its .ckpt.
        device: where it runs.
        clip_folder: for STMC, CLIP ViT-B/32 in a local Hugging Face folder; default: `clip` in the run folder.
        rest_joints: for STMC, T-pose joints of the neutral SMPL body [m], (24, 3); default: rest_joints.npy in the run
            folder, or else the embedded skeleton, scaled, with a warning.
        text_cache: where sentence embeddings are kept; default: the user's cache folder.

    Raises:
        InputError: a file is missing, damaged or of another architecture.
    """
    location = EMBEDDED if path is None else Path(path)
    cache = text_cache or default_cache()
    if not location.exists():
        raise InputError(f"prior: {location} does not exist")
    if location.name in (WEIGHTS_NAME, DESCRIPTION_NAME):
        location = location.parent
    if (location / DESCRIPTION_NAME).is_file():
        prior = _load_own(location, cache)
    else:
        prior = _load_stmc(location, clip_folder, rest_joints, cache)
    return _to(prior, torch.device(device))


def _to(prior: MotionPrior, device: torch.device) -> MotionPrior:
    parts = {field.name: getattr(prior, field.name) for field in fields(prior)}
    moved = {name: part.to(device) for name, part in parts.items() if isinstance(part, Tensor | MotionDenoiser)}
    return replace(prior, **moved)


# --- our own format ---------------------------------------------------------------------------------------------------


def write_prior(folder: Path, state: dict[str, Tensor], description: dict[str, Any]) -> None:
    """Write prior.safetensors and prior.json, each replaced in one piece.

    Args:
        state: `denoiser.*` and the four tensors of `STATISTICS`. Denoiser weights are stored in half precision.
        description: architecture, timesteps, fps, rest_joints, text_encoder, source.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stored = {
        name: (value.half() if name.startswith(DENOISER_PREFIX) else value.float()).contiguous()
        for name, value in state.items()
    }
    with whole_file(folder / WEIGHTS_NAME) as part:
        part.write_bytes(save(stored))
    with whole_file(folder / DESCRIPTION_NAME) as part:
        part.write_text(json.dumps({"format": FORMAT, **description}, indent=1) + "\n")


def _load_own(folder: Path, cache: Path | None) -> MotionPrior:
    description = _read_json(folder / DESCRIPTION_NAME)
    if description.get("format") != FORMAT:
        raise InputError(f"prior: {folder / DESCRIPTION_NAME}: format is {description.get('format')!r}, not {FORMAT!r}")
    weights = folder / WEIGHTS_NAME
    try:
        state = {name: value.float() for name, value in load_file(weights).items()}
    except (OSError, SafetensorError) as error:
        raise InputError(f"prior: {weights} cannot be read: {error}") from error
    try:
        architecture = Architecture(**description["architecture"])
        rest_joints = torch.tensor(description["rest_joints"])
        timesteps, fps = int(description["timesteps"]), float(description["fps"])
        wanted = description["text_encoder"]["sha256"]
        source = str(description["source"])
        least, most = (int(count) for count in description.get("lengths", (40, 50)))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"prior: {folder / DESCRIPTION_NAME}: {error!r}") from error
    encoder = minilm(cache)
    if encoder.sha256 != wanted:
        raise InputError(f"prior: {folder} was trained with text encoder {wanted}, the one here is {encoder.sha256}")
    return MotionPrior(
        _denoiser(state, architecture, weights),
        *_statistics(state, weights),
        encoder,
        rest_joints,
        cosine_alphas_cumprod(timesteps),
        fps,
        source,
        (least, most),
    )


# --- STMC -------------------------------------------------------------------------------------------------------------

SMPL_PELVIS_HEIGHT = 0.92
"""Pelvis above the toe joints in SMPL's neutral T-pose [m]."""


def _load_stmc(
    location: Path, clip_folder: str | Path | None, rest_joints: Tensor | None, cache: Path | None
) -> MotionPrior:
    checkpoint = location / CHECKPOINT if location.is_dir() else location
    if not checkpoint.is_file():
        raise InputError(f"prior: {location} holds neither {DESCRIPTION_NAME} nor {CHECKPOINT}")
    folder = location if location.is_dir() else run_folder(checkpoint)
    config = _read_json(folder / "config.json") if (folder / "config.json").is_file() else {}
    state = _read_checkpoint(checkpoint)
    architecture = _stmc_architecture(state, config, checkpoint)
    mean, std, text_mean, text_std = _statistics(state, checkpoint)
    _compare_statistics(folder, state)
    if rest_joints is None and (folder / REST_JOINTS_NAME).is_file():
        rest_joints = _read_rest_joints(folder / REST_JOINTS_NAME)
    if rest_joints is None:
        rest_joints = _scaled_skeleton()
        warnings.warn(
            f"prior: {folder} has no {REST_JOINTS_NAME}; joint positions are made with the embedded skeleton scaled to"
            " SMPL's height, which is not quite what the checkpoint was trained on",
            stacklevel=3,
        )
    return MotionPrior(
        _denoiser(state, architecture, checkpoint),
        mean,
        std + STMC_EPSILON,
        text_mean,
        text_std + STMC_EPSILON,
        clip(Path(clip_folder) if clip_folder else folder / "clip", cache, architecture.text_dim),
        rest_joints.float(),
        cosine_alphas_cumprod(int(_entry(config, 100, "diffusion", "timesteps"))),
        float(_entry(config, 20.0, "data", "motion_loader", "fps")),
        f"STMC checkpoint {checkpoint.name}",
        STMC_LENGTHS,
    )


def _entry(config: dict[str, Any], default: Any, *keys: str) -> Any:
    """config[k0][k1]..., or the published value where a key is missing."""
    value: Any = config
    for key in keys:
        if not isinstance(value, dict) or key not in value:
            return default
        value = value[key]
    return value


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"prior: {path} cannot be read: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"prior: {path} must hold a JSON object")
    return content


def _read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The state dict of a Lightning checkpoint. Nothing but tensors and plain values is unpickled."""
    check_downloaded(path, "prior: ")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a file that is damaged or holds other objects
        raise InputError(
            f"prior: {path} cannot be read as tensors alone ({type(error).__name__}); if you trust it, re-save it once:"
            " torch.save({'state_dict': torch.load(OLD, map_location='cpu', weights_only=False)['state_dict']}, NEW)"
        ) from error
    state = content.get("state_dict") if isinstance(content, dict) else None
    if not isinstance(state, dict):
        raise InputError(f"prior: {path} has no 'state_dict'; an STMC MDM-SMPL checkpoint is wanted")
    return state


def _stmc_architecture(state: dict[str, Tensor], config: dict[str, Any], path: Path) -> Architecture:
    """Sizes from the shapes; the number of heads is in no shape and comes from config.json (published: 8)."""
    names = ("registers", "skel_embedding.weight", "tx_embedding.0.weight", "seqTransEncoder.layers.0.linear1.weight")
    for name in names:
        if DENOISER_PREFIX + name not in state:
            first = next(iter(state), "nothing")
            raise InputError(
                f"prior: {path} is no STMC MDM-SMPL: {DENOISER_PREFIX + name} is missing (it has {first}, ...)"
            )
        if not isinstance(state[DENOISER_PREFIX + name], Tensor) or state[DENOISER_PREFIX + name].ndim != 2:
            raise InputError(f"prior: {path} is no STMC MDM-SMPL: {DENOISER_PREFIX + name} must be a matrix")
    registers, skeleton, text, linear = (state[DENOISER_PREFIX + name] for name in names)
    if skeleton.shape[1] != FEATURE_COUNT:
        raise InputError(f"prior: {path} works on {skeleton.shape[1]} features a frame, smplrifke has {FEATURE_COUNT}")
    layers = {key.split(".")[3] for key in state if key.startswith(DENOISER_PREFIX + "seqTransEncoder.layers.")}
    heads = int(_entry(config, 8, "diffusion", "denoiser", "num_heads"))
    latent = registers.shape[1]
    if heads < 1 or latent % heads:
        raise InputError(f"prior: {path}: num_heads {heads} does not divide the latent size {latent}; see config.json")
    return Architecture(
        skeleton.shape[1], text.shape[1], latent, linear.shape[0], len(layers), heads, registers.shape[0]
    )


def _compare_statistics(folder: Path, state: dict[str, Tensor]) -> None:
    """Warn where the statistics beside the checkpoint differ from those in it; the latter are used."""
    for kind in ("motion", "text"):
        for name in ("mean", "std"):
            path = folder / f"{kind}_stats" / f"{name}.pt"
            if not path.is_file():
                continue
            beside = torch.load(path, map_location="cpu", weights_only=True)
            inside = state[f"{kind}_normalizer.{name}"]
            if not isinstance(beside, Tensor) or beside.shape != inside.shape or not torch.allclose(beside, inside):
                warnings.warn(f"prior: {path} differs from the checkpoint's own, which is used", stacklevel=4)


def _read_rest_joints(path: Path) -> Tensor:
    try:
        joints = torch.from_numpy(np.load(path, allow_pickle=False).astype(np.float32))
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"prior: {path} cannot be read: {' '.join(str(error).split())}") from error
    if joints.shape != (JOINT_COUNT, 3) or not joints.isfinite().all():
        raise InputError(f"prior: {path} has shape {tuple(joints.shape)}, must be {JOINT_COUNT} finite points (24, 3)")
    return joints


def _scaled_skeleton() -> Tensor:
    joints = torch.tensor(_read_json(EMBEDDED / DESCRIPTION_NAME)["rest_joints"])
    return joints * (SMPL_PELVIS_HEIGHT / (joints[0, 1] - joints[10, 1]))


# --- both -------------------------------------------------------------------------------------------------------------


def _statistics(state: dict[str, Tensor], path: Path) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean and deviation of the features, then of the text."""
    for name in STATISTICS:
        if name not in state:
            raise InputError(f"prior: {path} lacks {name}, the statistics that its denoiser works with")
    mean, std, text_mean, text_std = (state[name].float() for name in STATISTICS)
    return mean, std, text_mean, text_std


def _check_layout(state: dict[str, Tensor], denoiser: MotionDenoiser, path: Path) -> None:
    """Refuse a state dict with another layout: names what is missing, surplus or of another shape.

    Raises:
        InputError: in one line, the first few of each.
    """
    architecture = denoiser.architecture
    sizes = (architecture.features, architecture.features, architecture.text_dim, architecture.text_dim)
    wanted = {DENOISER_PREFIX + name: tuple(value.shape) for name, value in denoiser.state_dict().items()}
    wanted |= {name: (size,) for name, size in zip(STATISTICS, sizes, strict=True)}
    given = {name: tuple(value.shape) if isinstance(value, Tensor) else None for name, value in state.items()}
    other = [f"{n} {given[n]}, not {shape}" for n, shape in wanted.items() if n in given and given[n] != shape]
    lists = {"missing": sorted(wanted.keys() - given), "surplus": sorted(given.keys() - wanted), "of shape": other}
    said = [
        f"{what}: {', '.join(names[:NAMED])}{f' and {len(names) - NAMED} more' if len(names) > NAMED else ''}"
        for what, names in lists.items()
        if names
    ]
    if said:
        raise InputError(f"prior: {path} is of another architecture than {asdict(architecture)}; {'; '.join(said)}")


def _denoiser(state: dict[str, Tensor], architecture: Architecture, path: Path) -> MotionDenoiser:
    """Strict load."""
    denoiser = MotionDenoiser(architecture)
    _check_layout(state, denoiser, path)
    weights = {key.removeprefix(DENOISER_PREFIX): v for key, v in state.items() if key.startswith(DENOISER_PREFIX)}
    denoiser.load_state_dict(weights)
    return denoiser.eval().requires_grad_(False)
