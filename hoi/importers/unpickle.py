"""Arrays out of other people's pickles, of which nothing is ever executed.

SMPL's models come as pickles of Python 2 that name classes of NumPy, SciPy and chumpy. Here each of those names becomes
a stand-in that only holds what the file says of the object; the arrays are then built from that. Nothing that the file
names is imported or called, chumpy need not be installed, and any other name is refused.
"""

import pickle
import re
import struct
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hoi.errors import InputError, about

_ALLOWED = re.compile(
    r"""
    numpy\.(ndarray|dtype)
    | numpy\.(_?core)\.(multiarray\.(_reconstruct|scalar)|numeric\._frombuffer)
    | scipy\.sparse\.(_?csc\.)?csc_(matrix|array)
    | chumpy(\.\w+)*
    | (copy_reg|copyreg)\._reconstructor
    | (__builtin__|builtins)\.(object|set|frozenset|bytes|bytearray)
    | _codecs\.encode
    """,
    re.VERBOSE,
)
_DTYPE = re.compile(r"b1|[iu][1248]|f[248]")
_DAMAGED = (
    pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, LookupError, OverflowError, MemoryError,
    RecursionError, ImportError, NotImplementedError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What a broken or hostile stream makes `pickle` and the decoding raise."""
LARGEST = 100_000_000
"""Entries of a sparse matrix made dense; SMPL-X's joint regressor has 0.6 million."""


class Held:
    """Stands for an object of the file: what its class is called, what it was made from, what state it was given."""

    name = ""

    def __new__(cls, *args: Any) -> "Held":
        held = super().__new__(cls)
        held.args, held.state = args, None
        return held

    args: tuple[Any, ...]
    state: Any

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Reader(pickle._Unpickler):  # pyright: ignore[reportAttributeAccessIssue]
    """Python's own unpickler, not C's, which takes memory for whatever memo index a file names."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(file, encoding="latin1")
        self._classes: dict[str, type[Held]] = {}

    def find_class(self, module_name: str, global_name: str) -> type[Held]:
        full = f"{module_name}.{global_name}"
        if not _ALLOWED.fullmatch(full):
            raise InputError(f"names {full[:80].encode('unicode_escape').decode()}, which is no array; refused")
        return self._classes.setdefault(full, type("Held", (Held,), {"name": full}))


def read_arrays(path: Path, keys: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Those of `keys` that a pickled dictionary or an .npz holds, as plain arrays.

    Arrays of NumPy, sparse CSC matrices of SciPy (made dense), chumpy's `Ch` and `Select`, numbers and lists of numbers
    are understood, in a pickle and in an .npz's pickled members too.

    Raises:
        InputError: the file cannot be read, is no dictionary, names any other class or function, or a value is none of
            these.
    """
    with about(path):
        try:
            with path.open("rb") as file:
                if file.read(4) == b"PK\x03\x04":
                    return _read_npz(path, keys)
                file.seek(0)
                values = _Reader(file).load()
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror or error})") from None
        except InputError:
            raise
        except _DAMAGED:
            raise InputError("neither an .npz nor a whole pickle") from None
        if not isinstance(values, dict):
            raise InputError(f"the pickle holds a {type(values).__name__}; it must be a dictionary of arrays")
        return {key: _named(key, values[key]) for key in keys if key in values}


def _read_npz(path: Path, keys: Iterable[str]) -> dict[str, NDArray[Any]]:
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        present = set(archive.namelist())
        for key in keys:
            if f"{key}.npy" not in present:
                continue
            with about(key):
                try:
                    with archive.open(f"{key}.npy") as member:
                        arrays[key] = _read_npy(member)
                except (InputError, MemoryError):
                    raise
                except (*_DAMAGED, OSError, RuntimeError):
                    raise InputError("not a whole array") from None
    return arrays


def _read_npy(member: IO[bytes]) -> NDArray[Any]:
    """One member of an .npz; an object array, which is a pickle behind NumPy's header, by way of `_Reader`."""
    version = npy.read_magic(member)
    _, _, dtype = npy.read_array_header_1_0(member) if version == (1, 0) else npy.read_array_header_2_0(member)
    if dtype.hasobject:
        return array_of(_Reader(member).load())
    member.seek(0)
    return npy.read_array(member, allow_pickle=False)


def _named(key: str, value: Any) -> NDArray[Any]:
    with about(key):
        try:
            return array_of(value)
        except InputError:
            raise
        except _DAMAGED:
            raise InputError("not a whole array") from None


def array_of(value: Any) -> NDArray[Any]:
    """The array that a value of the file stands for.

    Raises:
        InputError: it stands for none. ValueError, TypeError, LookupError: it contradicts itself.
    """
    if not isinstance(value, Held):
        if isinstance(value, (bool, int, float, list, tuple)):
            array = np.array([array_of(item) for item in value] if isinstance(value, (list, tuple)) else value)
            if array.dtype.kind in "biuf":
                return array
        raise InputError(f"a {type(value).__name__}; must be numbers")
    name, kind = value.name, value.name.rpartition(".")[2]
    if kind == "_reconstructor":  # how protocols 0 and 1 make an object of their first argument
        name = value.args[0].name
        kind = name.rpartition(".")[2]
    if kind == "_reconstruct":
        return _from_state(*value.state)
    if kind == "_frombuffer":
        raw, dtype, shape, order = value.args
        return _from_bytes(raw, _dtype_of(dtype), shape, order)
    if kind == "scalar":
        dtype, raw = value.args
        return _from_bytes(raw, _dtype_of(dtype), (), "C")
    if kind in ("csc_matrix", "csc_array"):
        return _dense(value.state)
    if name.startswith("chumpy."):
        return _chumpy_array(name, value.state if isinstance(value.state, dict) else {})
    raise InputError(f"a {name}; must be an array")


def _from_state(version: int, shape: tuple[int, ...], dtype: Held, fortran: bool, raw: Any) -> NDArray[Any]:
    """What `ndarray.__setstate__` would make of its state."""
    if dtype.args[0] in ("O", "O8", "O4") and shape == ():  # np.savez of what is no array
        return array_of(raw[0])
    return _from_bytes(raw, _dtype_of(dtype), shape, "F" if fortran else "C")


def _from_bytes(raw: Any, dtype: np.dtype, shape: tuple[int, ...], order: Any) -> NDArray[Any]:
    if isinstance(raw, Held):  # _codecs.encode(text, "latin1"), bytes() and bytearray(bytes)
        raw = raw.args[0] if raw.args else b""
    if isinstance(raw, str):  # bytes of Python 2
        raw = raw.encode("latin1")
    return np.frombuffer(raw, dtype).reshape(shape, order=order).copy()


def _dtype_of(held: Held) -> np.dtype:
    code, order = str(held.args[0]).lstrip("<>=|"), "="
    if held.state is not None:
        order = held.state[1]
    if not _DTYPE.fullmatch(code):
        raise InputError(f"an array of {held.args[0]!r:.40}; must be numbers")
    return np.dtype(f"{order if order in ('<', '>') else '='}{code}")


def _dense(state: dict[str, Any]) -> NDArray[Any]:
    """A CSC matrix's entries, with every index checked before it is used."""
    data, rows, starts = (array_of(state[key]) for key in ("data", "indices", "indptr"))
    height, width = (int(array_of(extent)) for extent in state.get("_shape", state.get("shape", ())))
    fits = starts.shape == (width + 1,) and rows.shape == data.shape == (len(data),) and height * width <= LARGEST
    if not fits or starts[0] != 0 or starts[-1] != len(rows) or (np.diff(starts) < 0).any():
        raise InputError("a sparse matrix whose arrays do not fit its shape")
    if len(rows) and (rows.min() < 0 or rows.max() >= height):
        raise InputError("a sparse matrix with entries outside its shape")
    dense = np.zeros((height, width), data.dtype)
    columns = np.repeat(np.arange(width), np.diff(starts))
    np.add.at(dense, (rows, columns), data)
    return dense


def _chumpy_array(name: str, state: dict[str, Any]) -> NDArray[Any]:
    """What chumpy would compute: a `Ch` is its array, a `Select` the entries of another at given places."""
    kind = name.rpartition(".")[2]
    if kind == "Ch" and "x" in state:
        return array_of(state["x"])
    if kind == "Select" and {"a", "idxs"} <= state.keys():
        chosen = array_of(state["a"]).ravel()[array_of(state["idxs"])]
        return chosen.reshape(array_of(state["preferred_shape"])) if "preferred_shape" in state else chosen
    raise InputError(f"a {name}; only chumpy's Ch and Select hold their array")
