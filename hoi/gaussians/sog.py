"""`.sog`, PlayCanvas's: a zip (or a folder) of meta.json and lossless WebP pictures, a pixel a Gaussian.

Positions are 16 bits in two pictures, through sign(x) log(1 + |x|), scales, colours and harmonics bytes that point into
code books (version 2) or lie between bounds (version 1), rotations three bytes and the index of the largest.
"""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array
from hoi.errors import InputError
from hoi.gaussians.found import CloudFile, brief, check_claim, found

MOST_PIXELS = 8_000_000
"""Of a picture: four of them in memory are 128 MB."""
MOST_BYTES = 256 << 20
"""Of a member of the zip, unpacked."""
_COEFFICIENTS = (0, 3, 8, 15)
_SH_WIDTHS = {192: 1, 512: 2, 960: 3}

Pictures = Callable[[str], NDArray[np.uint8]]


def read_sog(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: no zip, a member missing or broken, a picture too small or too large.
    """
    if path.name == "meta.json" and bytes(data[:2]) != b"PK":
        members, text = _folder(path.parent), bytes(data)
        packed = sum(file.stat().st_size for file in path.parent.iterdir() if file.is_file())
    else:
        members, text = _zip(data)
        packed = len(data)
    try:
        meta = json.loads(text)
        version = meta.get("version", 1)
        if version not in (1, 2):
            raise InputError(f"a .sog of version {brief(version)}; allowed are 1 and 2")
        count = meta["count"] if version == 2 else meta["means"]["shape"][0]
        if not isinstance(count, int) or count < 0:
            raise InputError(f"broken .sog: count {brief(count)}")
        check_claim(count, 3 if meta.get("shN") else 0, packed, 16)
        return _decoded(meta, version, count, lambda name: _pixels(members(name), name))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise InputError(f"broken .sog: meta.json ({type(error).__name__} {brief(error)})") from None


def _decoded(meta: dict[str, Any], version: int, count: int, pictures: Pictures) -> CloudFile:
    def pixels(part: str, index: int = 0) -> NDArray[np.uint8]:
        picture = pictures(str(meta[part]["files"][index]))
        if picture.shape[0] * picture.shape[1] < count:
            raise InputError(
                f"broken .sog: {part} has {picture.shape[0] * picture.shape[1]} pixels for {count} Gaussians"
            )
        return picture.reshape(-1, 4)[:count]

    def between(shares: Array, part: str, channels: slice) -> Array:
        low, high = (np.asarray(meta[part][end], np.float64)[channels] for end in ("mins", "maxs"))
        return low + shares * (high - low)

    low, high = pixels("means", 0)[:, :3], pixels("means", 1)[:, :3]
    logs = between((low + high.astype(np.float64) * 256) / 65535, "means", slice(3))
    means = np.sign(logs) * np.expm1(np.abs(logs))
    scales, colours = pixels("scales")[:, :3], pixels("sh0")
    if version == 2:
        sizes, dc = _booked(meta["scales"], scales), _booked(meta["sh0"], colours[:, :3])
        opacities = colours[:, 3] / np.float32(255)
    else:
        sizes, dc = between(scales / 255, "scales", slice(3)), between(colours[:, :3] / 255, "sh0", slice(3))
        opacities = 1 / (1 + np.exp(-between(colours[:, 3:] / 255, "sh0", slice(3, 4))[:, 0]))
    view = _harmonics(meta["shN"], version, pixels("shN", 1), pictures) if meta.get("shN") else np.zeros((count, 0, 3))
    sh = np.concatenate([dc[:, None], view], 1)
    with np.errstate(over="ignore"):
        return found(means, _rotations(pixels("quats")), np.exp(sizes), opacities, sh)


def _booked(part: dict[str, Any], indices: NDArray[np.uint8]) -> Array:
    book = np.asarray(part["codebook"], np.float32)
    if book.ndim != 1 or not 0 < len(book) <= 256 or (indices.size and indices.max() >= len(book)):
        raise InputError(f"broken .sog: a code book of {book.shape} for indices up to {indices.max(initial=0)}")
    return book[indices]


def _harmonics(part: dict[str, Any], version: int, labels: NDArray[np.uint8], pictures: Pictures) -> Array:
    centroids = pictures(str(part["files"][0]))
    width = centroids.shape[1]
    bands = part["bands"] if version == 2 else _SH_WIDTHS.get(width, 0)
    if bands not in (1, 2, 3) or width != 64 * _COEFFICIENTS[bands]:
        raise InputError(f"broken .sog: a palette {width} pixels wide for harmonics of degree {brief(bands)}")
    palette = centroids[:, :, :3].reshape(-1, _COEFFICIENTS[bands], 3)
    label = labels[:, 0] + labels[:, 1].astype(np.intp) * 256
    if len(label) and label.max() >= len(palette):
        raise InputError(f"broken .sog: label {label.max()} in a palette of {len(palette)}")
    if version == 2:
        return _booked(part, palette)[label]
    low, high = float(part["mins"]), float(part["maxs"])
    return (np.float32(low) + palette / np.float32(255) * np.float32(high - low))[label]


def _rotations(pixels: NDArray[np.uint8]) -> Array:
    """wxyz; a fourth byte that names no component stands for no turn."""
    others = (pixels[:, :3] / 255 * 2 - 1) / np.sqrt(2)
    largest = np.sqrt(np.maximum(0, 1 - (others**2).sum(1)))
    quaternions = np.tile([1.0, 0, 0, 0], (len(pixels), 1))
    for which in range(4):
        rows = pixels[:, 3] == 252 + which
        quaternions[rows] = np.insert(others[rows], which, largest[rows], axis=1)
    return quaternions


def _pixels(content: bytes, name: str) -> NDArray[np.uint8]:
    """RGBA (height, width, 4)."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content), formats=("WEBP", "PNG")) as picture:
            if picture.width * picture.height > MOST_PIXELS:
                raise InputError(
                    f"broken .sog: {brief(name)} has {picture.width} x {picture.height} pixels, at most {MOST_PIXELS}"
                )
            return np.asarray(picture.convert("RGBA"))
    except InputError:
        raise
    except Exception as error:  # a picture that is broken ends Pillow's decoders in many ways
        raise InputError(f"broken .sog: {brief(name)} is no picture ({brief(error)})") from None


def _zip(data: bytes | memoryview) -> tuple[Callable[[str], bytes], bytes]:
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        names = {name.rsplit("/", 1)[-1]: name for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise InputError(f"broken .sog, cut short or no zip ({brief(error)})") from None

    def member(name: str) -> bytes:
        if name not in names:
            raise InputError(f"no .sog: a zip without {brief(name)}")
        try:
            with archive.open(names[name]) as file:
                content = file.read(MOST_BYTES + 1)
        except (zipfile.BadZipFile, OSError, EOFError, ValueError, NotImplementedError, RuntimeError) as error:
            raise InputError(f"broken .sog: {brief(name)} ({brief(error)})") from None
        except Exception as error:  # zlib.error and others of the packers
            raise InputError(f"broken .sog: {brief(name)} ({brief(error)})") from None
        if len(content) > MOST_BYTES:
            raise InputError(f"broken .sog: {brief(name)} unpacks to more than {MOST_BYTES >> 20} MiB")
        return content

    return member, member("meta.json")


def _folder(folder: Path) -> Callable[[str], bytes]:
    def member(name: str) -> bytes:
        if Path(name).name != name:
            raise InputError(f"broken .sog: meta.json names {brief(name)!r}, must be a file beside it")
        try:
            return (folder / name).read_bytes()
        except OSError as error:
            raise InputError(f"no .sog: {brief(name)} beside meta.json: {error.strerror}") from None

    return member
