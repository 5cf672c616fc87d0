"""Whether the video prior's weights are at hand, found out before anything heavy is imported or computed."""

from importlib.util import find_spec
from pathlib import Path

from hoi.errors import InputError

VIDEO_PRIOR_NAME = "video_prior.safetensors"
EMBEDDED_VIDEO_PRIOR = Path(__file__).parent / "weights" / VIDEO_PRIOR_NAME
EMBEDDED_PICTURE = 64
"""Edge of the square pictures that the embedded video prior has learned to see [pixel]."""
COGVIDEOX = "THUDM/CogVideoX-5b"
COGVIDEOX_PARTS = ("transformer", "vae", "text_encoder", "tokenizer", "scheduler")
COGVIDEOX_SIZE = "21 GB (transformer 11.1, T5 9.5, VAE 0.4)"
WITHOUT = "stage/refine=geometric runs without a video prior"


def check_video_prior(prior: str, checkpoint: str | None) -> None:
    """Nothing, when the weights of a prior are there; as `hoi.video_prior.load_video_prior` names them.

    Raises:
        InputError: one line with the model, where its weights are expected, how large the download is, and the config
            that runs without them.
    """
    if prior == "embedded":
        embedded_video_prior(checkpoint)
        return
    cogvideox_folder(checkpoint)
    for package in ("diffusers", "sentencepiece"):
        if find_spec(package) is None:
            raise InputError(f"prior=cogvideox needs {package}: pip install 'hoi[video]'; {WITHOUT}")


def embedded_video_prior(checkpoint: str | Path | None) -> Path:
    """The weights of an embedded video prior: `checkpoint`, the one in that folder, or, of None, the package's.

    Raises:
        InputError: there is no such file.
    """
    given = EMBEDDED_VIDEO_PRIOR if checkpoint is None else Path(checkpoint)
    file = given / VIDEO_PRIOR_NAME if given.is_dir() else given
    if not file.is_file():
        remedy = WITHOUT if checkpoint is None else "checkpoint=null takes the one in the package"
        raise InputError(f"checkpoint: no embedded video prior at {file}; {remedy}")
    return file


def cogvideox_folder(checkpoint: str | None) -> Path:
    """The folder of a CogVideoX: `checkpoint` itself, or where the hub's cache has the model of that name.

    Raises:
        InputError: as `check_video_prior`. Nothing is downloaded: the user decides about 21 GB.
    """
    assert checkpoint is not None, "a CogVideoX has a folder or hub name"
    folder = Path(checkpoint).expanduser()
    if not folder.is_dir():
        found = in_hub_cache(checkpoint)
        if found is None:
            raise InputError(
                f"checkpoint: no CogVideoX-5B at {checkpoint}: neither a folder here nor in the "
                f"Hugging Face cache; `hf download {COGVIDEOX}` fetches {COGVIDEOX_SIZE}; {WITHOUT}"
            )
        folder = found
    missing = [part for part in COGVIDEOX_PARTS if not (folder / part).is_dir()]
    if missing:
        raise InputError(
            f"checkpoint: CogVideoX-5B in {folder} lacks {', '.join(missing)}; "
            f"`hf download {COGVIDEOX}` fetches the whole, {COGVIDEOX_SIZE}; {WITHOUT}"
        )
    return folder


def in_hub_cache(name: str) -> Path | None:
    """Where the hub's model of this name has been downloaded to; None when it has not."""
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HFValidationError, LocalEntryNotFoundError

    try:
        return Path(snapshot_download(name, local_files_only=True))
    except (HFValidationError, LocalEntryNotFoundError):
        return None
