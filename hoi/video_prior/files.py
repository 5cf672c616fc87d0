"""Whether the video prior's weights are at hand, found out before anything heavy is imported or computed."""

import json
from importlib.util import find_spec
from pathlib import Path

from hoi.data import Missing
from hoi.errors import InputError

VIDEO_PRIOR_NAME = "video_prior.safetensors"
EMBEDDED_VIDEO_PRIOR = Path(__file__).parent / "weights" / VIDEO_PRIOR_NAME
EMBEDDED_PICTURE = 64
"""Edge of the square pictures that the embedded video prior has learned to see [pixel]."""
COGVIDEOX = "THUDM/CogVideoX-5b"
COGVIDEOX_PARTS = (
    ("transformer", "config.json", "diffusion_pytorch_model.safetensors"),
    ("vae", "config.json", "diffusion_pytorch_model.safetensors"),
    ("text_encoder", "config.json", "model.safetensors"),
    ("scheduler", "scheduler_config.json", ""),
)
"""Folder, config and weights, which may lie in shards."""
TOKENS = ("spiece.model", "tokenizer.json")
"""T5's, either of them."""
COGVIDEOX_SIZE = "21 GB: transformer 11.1, T5 9.5, VAE 0.4"
WITHOUT = "stage/refine=geometric runs without a video prior"


def missing_video_prior(key: str, prior: str, checkpoint: str | None) -> list[Missing]:
    """What `hoi.video_prior.load_video_prior` will look for and not find; nothing is downloaded or imported.

    Args:
        key: of the config, which names the weights.
    """
    if prior == "embedded":
        file = embedded_file(checkpoint)
        remedy = WITHOUT if checkpoint is None else f"{key}=null takes the one in the package"
        return [] if file.is_file() else [Missing(key, "embedded video prior", str(file), "", remedy)]
    found = []
    for package in ("diffusers", "sentencepiece"):
        if find_spec(package) is None:
            found.append(Missing(key, f"package {package}", "", "", f"pip install 'hoi[video]'; {WITHOUT}"))
    assert checkpoint is not None, "a CogVideoX has a folder or hub name"
    folder = cogvideox_at(checkpoint)
    if folder is None:
        get = f"neither a folder nor in the Hugging Face cache; `hf download {COGVIDEOX}` fetches it; {WITHOUT}"
        return [*found, Missing(key, "CogVideoX-5B", checkpoint, COGVIDEOX_SIZE, get)]
    if lacking := cogvideox_lacks(folder):
        what = f"whole CogVideoX-5B ({', '.join(lacking)})"
        get = f"`hf download {COGVIDEOX}` fetches the rest; {WITHOUT}"
        found.append(Missing(key, what, str(folder), COGVIDEOX_SIZE, get))
    return found


def embedded_video_prior(checkpoint: str | Path | None) -> Path:
    """The weights of an embedded video prior: `checkpoint`, the one in that folder, or, of None, the package's.

    Raises:
        InputError: there is no such file.
    """
    if missing := missing_video_prior("checkpoint", "embedded", None if checkpoint is None else str(checkpoint)):
        raise InputError(missing[0])
    return embedded_file(checkpoint)


def embedded_file(checkpoint: str | Path | None) -> Path:
    """Where `embedded_video_prior` looks."""
    given = EMBEDDED_VIDEO_PRIOR if checkpoint is None else Path(checkpoint)
    return given / VIDEO_PRIOR_NAME if given.is_dir() else given


def cogvideox_at(checkpoint: str) -> Path | None:
    """The folder of a CogVideoX: `checkpoint` itself, or where the hub's cache has the model of that name."""
    folder = Path(checkpoint).expanduser()
    return folder if folder.is_dir() else in_hub_cache(checkpoint)


def cogvideox_lacks(folder: Path) -> list[str]:
    """What is not in a CogVideoX's folder, of each part's config and weights, all shards of them, and T5's tokens."""
    lacking = []
    for part, config, weights in COGVIDEOX_PARTS:
        place = folder / part
        if config and not (place / config).is_file():
            lacking.append(f"{part}/{config}")
        if weights:
            lacking += [f"{part}/{name}" for name in _shards(place, weights) if not (place / name).is_file()]
    tokens = folder / "tokenizer"
    if not any((tokens / name).is_file() for name in TOKENS):
        lacking.append(f"tokenizer/{TOKENS[0]}")
    return lacking


def _shards(place: Path, name: str) -> list[str]:
    """The files that weights of that name lie in; the name itself where no index says otherwise."""
    try:
        return sorted(set(json.loads((place / f"{name}.index.json").read_text())["weight_map"].values()))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return [name]


def cogvideox_folder(checkpoint: str | None) -> Path:
    """The folder of a whole CogVideoX, see `cogvideox_at`.

    Raises:
        InputError: it is not there, or lacks files. Nothing is downloaded: the user decides about 21 GB.
    """
    if missing := missing_video_prior("checkpoint", "cogvideox", checkpoint):
        raise InputError("\n".join(map(str, missing)))
    folder = cogvideox_at(str(checkpoint))
    assert folder is not None
    return folder


def in_hub_cache(name: str) -> Path | None:
    """Where the hub's model of this name has been downloaded to; None when it has not."""
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HFValidationError, LocalEntryNotFoundError

    try:
        return Path(snapshot_download(name, local_files_only=True))
    except (HFValidationError, LocalEntryNotFoundError):
        return None
