"""Whether a motion prior's files are at hand, found out before anything heavy is imported or computed."""

from pathlib import Path

from hoi.data import Missing

DESCRIPTION_NAME, WEIGHTS_NAME, REST_JOINTS_NAME = "prior.json", "prior.safetensors", "rest_joints.npy"
CHECKPOINT = Path("logs", "checkpoints", "last.ckpt")
CLIP_WEIGHTS = ("model.safetensors", "pytorch_model.bin")
CLIP_TOKENS = (("tokenizer.json",), ("vocab.json", "merges.txt"))
"""Either of these."""
STMC = "STMC's MDM-SMPL, the published motion prior"
STMC_SIZE = "about 0.3 GB"
"""27 million parameters, and as a Lightning checkpoint their optimiser's two moments."""
STMC_HOME = "https://github.com/nv-tlabs/stmc, prepare/download_pretrain_models.sh, unpacks it as pretrained_models/"
CLIP_NAME, CLIP_SIZE = "openai/clip-vit-base-patch32", "0.6 GB"
EMBEDDED = "stage/motion=hmsd runs with the prior of the package"


def run_folder(checkpoint: Path) -> Path:
    """RUN_DIR of RUN_DIR/logs/checkpoints/x.ckpt; otherwise the file's own folder."""
    inside_run = checkpoint.parent.name == "checkpoints" and checkpoint.parent.parent.name == "logs"
    return checkpoint.parents[2] if inside_run else checkpoint.parent


def missing_prior(key: str, checkpoint: str | None, published: str) -> list[Missing]:
    """What `hoi.motion.prior.load_prior` will look for and not find.

    Args:
        key: of the config, which names the prior.
        checkpoint: what it says; None: the one in the package.
        published: where the published one is expected: whatever is not there is taken to be that.
    """
    if checkpoint is None:
        return []
    path = Path(checkpoint)
    if not path.exists() and path != Path(published):
        return [Missing(key, "file or folder of a motion prior", str(path), "", f"{key}=null: the one in the package")]
    folder = run_folder(path) if path.is_file() else path
    own = path.parent if path.name in (WEIGHTS_NAME, DESCRIPTION_NAME) else path
    if any((own / name).is_file() for name in (DESCRIPTION_NAME, WEIGHTS_NAME)):
        return [
            Missing(key, "part of a motion prior", str(own / name), "", "write_prior makes both")
            for name in (DESCRIPTION_NAME, WEIGHTS_NAME)
            if not (own / name).is_file()
        ]
    found = []
    weights = path if path.is_file() else path / CHECKPOINT
    if not weights.is_file():
        found.append(Missing(key, STMC, str(weights), STMC_SIZE, f"{STMC_HOME}; {EMBEDDED}"))
    clip = folder / "clip"
    if lacking := _clip_lacks(clip):
        get = f"`hf download {CLIP_NAME} --local-dir {clip}`"
        found.append(Missing(key, f"CLIP's text encoder ({lacking})", str(clip), CLIP_SIZE, get))
    joints = folder / REST_JOINTS_NAME
    if not joints.is_file():
        get = f"`python -m hoi.importers.rest_joints SMPLH_NEUTRAL.npz -o {joints}`; else the package's, scaled"
        found.append(Missing(key, "T-pose joints of the prior's skeleton", str(joints), "1 kB", get, needed=False))
    return found


def _clip_lacks(folder: Path) -> str:
    """What of CLIP's text encoder is not in its folder; empty when all is."""
    wanted = {
        "config.json": (folder / "config.json").is_file(),
        CLIP_WEIGHTS[0]: any((folder / name).is_file() for name in CLIP_WEIGHTS),
        "vocab.json and merges.txt": any(all((folder / name).is_file() for name in names) for names in CLIP_TOKENS),
    }
    return ", ".join(name for name, there in wanted.items() if not there)
