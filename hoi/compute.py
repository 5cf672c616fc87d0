"""The compiler of the kernels, for the simulation and the renderer, which share one runtime. No other module names it.

It is Taichi, or from Python 3.14 on, for which Taichi has no wheels, its maintained successor Quadrants, whose language
is the same. Where both are installed HOI_COMPILER=taichi or HOI_COMPILER=quadrants in the environment chooses. It is
imported when `ti` is first asked for; what `ti` does not give are the functions here.
"""

import contextlib
import functools
import gc
import importlib
import inspect
import io
import locale
import os
import sys
from typing import Any, Literal

import numpy as np

from hoi.caches import caches
from hoi.errors import InputError

Precision = Literal["float32", "float64"]
Device = Literal["cpu", "cuda"]

CPU_TASK = 512
"""Turns of a parallel loop that the compiler gives a CPU thread at the least, whatever block_dim says (measured): a
thread's share of the work hangs on the first of so many."""
# Read when the compiler is imported: no banner, no look for a newer version on the network.
QUIET = {
    "ENABLE_TAICHI_HEADER_PRINT": "False",
    "TI_SKIP_VERSION_CHECK": "ON",
    "ENABLE_QUADRANTS_HEADER_PRINT": "False",
}


def compiler() -> str:
    """The package that compiles the kernels, "taichi" or "quadrants".

    Raises:
        InputError: HOI_COMPILER names another.
    """
    name = os.environ.get("HOI_COMPILER") or ("taichi" if sys.version_info < (3, 14) else "quadrants")
    if name not in ("taichi", "quadrants"):
        raise InputError(f"HOI_COMPILER must be taichi or quadrants, got {name!r}")
    return name


@functools.cache
def _compiler() -> Any:
    """The package, imported.

    Its core aborts the process where it has no home to keep its cache in, and crashes at the end where it may not write
    there: it is told another one before it looks.

    Raises:
        InputError: there is none, or it cannot be imported here.
    """
    for variable, value in QUIET.items():
        os.environ.setdefault(variable, value)
    _skip_the_importer()
    if (folder := caches()) is None:
        raise InputError("XDG_CACHE_HOME", os.environ.get("XDG_CACHE_HOME", "nothing"),
                         "a folder that can be written to: neither home nor the temporary folder can")  # fmt: skip
    os.environ["XDG_CACHE_HOME"] = str(folder)
    try:
        locale.getdefaultlocale()
    except ValueError:  # one that this machine has not, and the compiler asks for its encoding
        os.environ["LC_ALL"] = "C.UTF-8"
    try:
        return importlib.import_module(compiler())
    except ImportError as error:
        said = " ".join(str(error).split())
        raise InputError(f"{compiler()}, which compiles the kernels, cannot be imported: {said}") from error


def _skip_the_importer() -> None:
    """Spares `inspect` the search through all modules for the source of Python's importer, which has none.

    Each kernel's decorator asks for it where the module is being imported: together half of the compiler's import.
    """
    look = inspect.getframeinfo

    def getframeinfo(frame: Any, context: int = 1) -> Any:
        code = getattr(frame, "f_code", None)
        if code is None or not code.co_filename.startswith("<frozen importlib"):
            return look(frame, context)
        return inspect.Traceback(code.co_filename, frame.f_lineno, code.co_name, None, None)

    inspect.getframeinfo = getframeinfo


def __getattr__(name: str) -> Any:
    """`ti`, imported when it is asked for."""
    if name == "ti":
        return _compiler()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def start_compiler(precision: Precision, threads: int, device: Device) -> None:
    """Starts the compiler, unless it runs with just these settings: then its compiled kernels are kept.

    On a CPU vectors are kept whole, so that each is one register. Arrays of before are lost by a start.

    Raises:
        InputError: a value that is not allowed, or no CUDA device.
    """
    ti = _compiler()
    real = {"float32": ti.f32, "float64": ti.f64}.get(precision)
    arch = {"cpu": ti.cpu, "cuda": ti.cuda}.get(device)
    if real is None:
        raise InputError(f"precision must be float32 or float64, got {precision!r}")
    if arch is None:
        raise InputError(f"device must be cpu or cuda, got {device!r}")
    if not (isinstance(threads, int) and threads >= 1):
        raise InputError(f"threads must be a positive integer, got {threads!r}")
    runtime = vars(ti.lang.impl.get_runtime())
    program = runtime["prog" if "prog" in runtime else "_prog"]
    if program is not None:
        config = program.config()
        on_cpu = config.arch != ti.cuda
        if (on_cpu, config.default_fp, config.cpu_max_num_threads) == (device == "cpu", real, threads):
            return
    if device == "cuda" and not ti.lang.misc.is_arch_supported(ti.cuda):
        raise InputError(f"device is cuda, but {compiler().capitalize()} finds no CUDA device; use cpu")
    if program is not None:
        _disown_arrays(ti)
    with contextlib.redirect_stdout(io.StringIO()):  # ti.init prints the device it starts on
        ti.init(
            arch=arch, default_fp=real, default_ip=ti.i32, cpu_max_num_threads=threads, log_level=ti.ERROR,
            enable_fallback=False, real_matrix_scalarize=device == "cuda",
        )  # fmt: skip


def _disown_arrays(ti: Any) -> None:
    """Cuts the arrays of the program that ends off from its memory.

    An array's end frees what lies at its address in the program of that time, which may by then be another's.
    """
    for thing in gc.get_objects():
        if issubclass(type(thing), ti.Ndarray):  # a proxy would have isinstance ask what it stands for
            thing.arr = None


def default_float() -> type[np.floating[Any]]:
    """The float type that kernels are being compiled for."""
    ti = _compiler()
    return np.float64 if ti.lang.impl.get_runtime().default_fp == ti.f64 else np.float32
