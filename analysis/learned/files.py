"""What the models' files have in common."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

import torch

from hoi.errors import InputError
from hoi.motion.text import file_sha256


def files_sha256(paths: Iterable[Path]) -> str:
    """Hex digest of some files' names and contents."""
    lines = [f"{path.name} {file_sha256(path)}\n" for path in paths]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def check_memory(option: str, needed: int, device: torch.device) -> None:
    """Refuse what cannot fit, before it is loaded: a laptop would swap or kill instead.

    Args:
        needed: bytes of the weights.

    Raises:
        InputError: the device has less.
    """
    if device.type == "cuda":
        total, name = torch.cuda.get_device_properties(device).total_memory, "the GPU"
    else:
        total, name = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), "this machine"
    if needed > total:
        raise InputError(
            f"{option}: the weights take {needed / 1e9:.1f} GB, {name} has {total / 1e9:.1f} GB; "
            "take a smaller model or another device (--device cpu or cuda)"
        )
