"""`.ply` as INRIA's 3DGS, TRELLIS, nerfstudio, Brush, 2DGS and Mip-Splatting write it.

Raw parameters (log scales, opacity logits, wxyz quaternions of any length), `f_rest_*` channel-major. Properties are
found by name, so their order, type and encoding do not matter. What differs by program is recognised by what is there:
`red green blue` in place of harmonics, two scales (flat Gaussians), `filter_3D`, values that are activated already.
"""

import mmap
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.gaussians.cloud import SH_C0
from hoi.gaussians.found import INRIA_UP, CloudFile, brief, found

PLACE, TURN = "x y z", "rot_0 rot_1 rot_2 rot_3"
SIZE, DC, RGB = "scale_0 scale_1 scale_2", "f_dc_0 f_dc_1 f_dc_2", "red green blue"
FLAT = 0.01
"""Thickness of a Gaussian that has two scales, in the lesser of them."""
WIDE = 0.2
"""Of the extent: log scales that would make half of the Gaussians wider than this are no logarithms."""
_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def read_ply(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: broken, or without what makes a vertex a Gaussian.
    """
    ply = parsed(data, path)
    if "vertex" not in ply:
        raise InputError("a PLY without a vertex element, not a 3DGS file")
    vertex = ply["vertex"]
    present = {p.name for p in vertex.properties}
    rest = sorted((n for n in present if re.fullmatch(r"f_rest_\d+", n)), key=lambda n: int(n[7:]))
    colour = RGB if not present & set(DC.split()) and set(RGB.split()) <= present else DC
    scales = SIZE if "scale_2" in present or "scale_0" not in present else SIZE[:15]
    missing = [n for group in (PLACE, TURN, scales, "opacity", colour) for n in group.split() if n not in present]
    if missing:
        what = "a mesh" if "face" in ply and len(ply["face"].data) else "a point cloud"
        kind = f"{what}, not a 3DGS PLY" if len(missing) > 6 else "not a 3DGS PLY"
        raise InputError(f"{kind}: it has no {', '.join(missing)}")
    if len(rest) not in (0, 9, 24, 45):
        raise InputError(f"{len(rest)} f_rest properties; a 3DGS PLY has 0, 9, 24 or 45 (degree 0 to 3)")

    def columns(names: str, dtype: type = np.float32) -> Array:
        try:
            return np.stack([np.asarray(vertex[name]).astype(dtype) for name in names.split()], 1)
        except (ValueError, TypeError):
            raise InputError("not a 3DGS PLY, a property of its vertices is a list") from None

    notes: list[str] = []
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is found by `load_clean`
        means = columns(PLACE, np.float64)
        raw = columns(scales, np.float64)
        opacities = _opacities(columns("opacity", np.float64)[:, 0], notes)
        sizes = _sizes(raw, means, any("opacities" in note for note in notes), notes)
        if "filter_3D" in present:
            sizes, opacities = _smoothed(sizes, opacities, columns("filter_3D", np.float64), notes)
    if sizes.shape[1] == 2:
        sizes = np.column_stack([sizes, FLAT * sizes.min(1)])
        notes.append("flat Gaussians of two scales (2DGS)")
    sh = np.empty((len(means), 1 + len(rest) // 3, 3), np.float32)
    if colour == RGB:
        notes.append("colours as red green blue, without harmonics")
        rgb = columns(RGB)
        whole = all(vertex.ply_property(n).val_dtype not in ("f4", "f8") for n in RGB.split()) or np.nanmax(rgb) > 1.5
        sh[:, 0] = (rgb / (255 if whole else 1) - 0.5) / SH_C0
    else:
        sh[:, 0] = columns(DC)
    for index, name in enumerate(rest):
        channel, coefficient = divmod(index, len(rest) // 3)
        sh[:, 1 + coefficient, channel] = columns(name)[:, 0]
    return found(means, columns(TURN), sizes, opacities, sh, *up_of(ply.comments), tuple(notes))


def parsed(data: bytes | memoryview, path: Path) -> Any:
    """A `plyfile.PlyData`, once its header has been seen to claim no more than there is.

    Raises:
        InputError: broken.
    """
    from plyfile import PlyData, PlyParseError

    check_header(data)
    try:
        if isinstance(data, memoryview) and isinstance(data.obj, mmap.mmap):
            return PlyData.read(str(path))
        with tempfile.TemporaryFile() as file:  # in memory it would be read number by number
            file.write(data)
            file.seek(0)
            return PlyData.read(file)
    except (PlyParseError, ValueError, EOFError, UnicodeDecodeError, TypeError, IndexError, KeyError) as error:
        raise InputError(f"broken PLY, cut short or not well formed ({brief(error)})") from None


def check_header(data: bytes | memoryview) -> None:
    """Refuse a header whose counts do not fit into the file.

    Raises:
        InputError: as said.
    """
    head = bytes(data[: 1 << 16])
    end = re.search(rb"end_header\s*?\n", head)
    if end is None:
        raise InputError("broken PLY, cut short or not well formed (no end of the header in 64 KiB)")
    text = re.search(rb"format\s+ascii", head[: end.start()]) is not None
    needed, count, each = 0, 0, 0
    for line in [*head[: end.start()].decode("latin-1").split("\n"), "element end 0"]:
        words = line.split()
        if words[:1] == ["element"]:
            needed += count * each
            if len(words) != 3 or not re.fullmatch(r"\d{1,18}", words[2]):
                raise InputError(f"broken PLY, not well formed ({brief(line)!r})")
            count, each = int(words[2]), 1 if text else 0
        elif words[:1] == ["property"] and len(words) > 1:
            each += 2 if text else _BYTES.get(words[2 if words[1] == "list" and len(words) > 2 else 1], 1)
    if needed - 1 > len(data) - end.end():
        raise InputError(
            f"cut short, or a header that claims too much: its elements take {needed} bytes or more, "
            f"{len(data) - end.end()} are there"
        )


def up_of(comments: list[str]) -> tuple[str, str]:
    """Up axis and what says so, of the comments of a PLY: `Vertical Axis: z` (nerfstudio), three numbers (Brush)."""
    said = [match for c in comments if (match := re.match(r"vertical axis:?\s*(.+)", c.strip(), re.IGNORECASE))]
    if not said:
        return "-y", INRIA_UP
    value = said[-1][1].strip().lower()
    why = f"the file's comment {said[-1][0]!r}"
    if value in ("x", "y", "z"):
        if value == "y" and any("brush" in c.lower() for c in comments):
            return "-y", f"{why}, which Brush writes for y pointing down"
        return f"+{value}", why
    if re.fullmatch(r"[+-][xyz]", value):
        return value, why
    numbers = re.findall(r"[-+]?\d*\.?\d+(?:e[-+]?\d+)?", value)
    if len(numbers) == 3 and any(vector := [float(n) for n in numbers]):
        axis = int(np.argmax(np.abs(vector)))
        return ("+" if vector[axis] > 0 else "-") + "xyz"[axis], f"{why}, of which that axis is the nearest"
    return "-y", f"{INRIA_UP}; its comment {said[-1][0]!r} says no axis"


def _opacities(raw: Array, notes: list[str]) -> Array:
    """Opacities of logits; those that all lie in [0, 1] and not at one value below 1/2 are opacities already."""
    finite = raw[np.isfinite(raw)]
    activated = len(finite) and finite.min() >= 0 and finite.max() <= 1 and finite.max() > 0
    if activated and (finite.max() > finite.min() or finite.max() >= 0.5):
        notes.append("opacities in [0, 1] taken as they are, not as logits")
        return raw
    return 1 / (1 + np.exp(-raw))


def _sizes(raw: Array, means: Array, activated: bool, notes: list[str]) -> Array:
    """Scales of logarithms, unless they can only be lengths already: positive all, with opacities that are activated
    too or so large that their exponentials would fill the cloud."""
    finite = raw[np.isfinite(raw).all(1)]
    places = means[np.isfinite(means).all(1)]
    if len(finite) and len(places) and finite.min() >= 0 and finite.max() > 0:
        extent = np.subtract(*np.percentile(places, (95, 5), axis=0)).max()
        lengths, powers = np.median(finite.max(1)), np.median(np.exp(finite.max(1)))
        if activated or (powers > WIDE * extent and lengths < WIDE * extent):
            notes.append("scales above 0 taken as lengths, not as logarithms")
            return raw
    return np.exp(raw)


def _smoothed(sizes: Array, opacities: Array, width: Array, notes: list[str]) -> tuple[Array, Array]:
    """Mip-Splatting's 3D smoothing filter: variances grow by width^2, opacities keep the integral."""
    squared = sizes**2
    wider = squared + width**2
    notes.append("filter_3D of Mip-Splatting applied")
    return np.sqrt(wider), opacities * np.sqrt(squared.prod(1) / np.maximum(wider.prod(1), 1e-300))


def write_ply(cloud: GaussianCloud, path: Path) -> None:
    """Write INRIA's binary layout, of the cloud's own degree; every 3DGS viewer reads it."""
    from plyfile import PlyData, PlyElement

    count, coefficients = cloud.sh.shape[:2]
    opacities = np.clip(cloud.opacities.astype(np.float64), 1e-6, 1 - 1e-6)
    columns = {
        "x y z": cloud.means,
        "nx ny nz": np.zeros((count, 3)),
        "f_dc_0 f_dc_1 f_dc_2": cloud.sh[:, 0],
        " ".join(f"f_rest_{i}" for i in range(3 * (coefficients - 1))): cloud.sh[:, 1:].transpose(0, 2, 1),
        "opacity": np.log(opacities / (1 - opacities)),
        "scale_0 scale_1 scale_2": np.log(np.maximum(cloud.scales, 1e-9)),
        "rot_0 rot_1 rot_2 rot_3": cloud.quaternions,
    }
    names = [name for group in columns for name in group.split()]
    table = np.concatenate([values.reshape(count, -1) for values in columns.values()], 1).astype("<f4")
    vertices = np.ascontiguousarray(table).view([(name, "<f4") for name in names])[:, 0]
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(str(path))
