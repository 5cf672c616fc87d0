"""Starting Taichi for the simulation and the renderer, which share one runtime."""

import contextlib
import io
from typing import Literal

import taichi as ti
from taichi.lang import impl
from taichi.lang.misc import is_arch_supported

from hoi.errors import InputError

Precision = Literal["float32", "float64"]
Device = Literal["cpu", "cuda"]

CPU_TASK = 512
"""Turns of a parallel loop that Taichi gives a CPU thread at the least, whatever block_dim says (measured): a thread's
share of the work hangs on the first of so many."""


def start_taichi(precision: Precision, threads: int, device: Device) -> None:
    """Starts Taichi, unless it runs with just these settings: then its compiled kernels are kept.

    On a CPU vectors are kept whole, so that each is one register.

    Raises:
        InputError: a value that is not allowed, or no CUDA device.
    """
    real = {"float32": ti.f32, "float64": ti.f64}.get(precision)
    arch = {"cpu": ti.cpu, "cuda": ti.cuda}.get(device)
    if real is None:
        raise InputError(f"precision must be float32 or float64, got {precision!r}")
    if arch is None:
        raise InputError(f"device must be cpu or cuda, got {device!r}")
    if not (isinstance(threads, int) and threads >= 1):
        raise InputError(f"threads must be a positive integer, got {threads!r}")
    if impl.get_runtime().prog is not None:
        config = impl.current_cfg()
        on_cpu = config.arch != ti.cuda
        if (on_cpu, config.default_fp, config.cpu_max_num_threads) == (device == "cpu", real, threads):
            return
    if device == "cuda" and not is_arch_supported(ti.cuda):
        raise InputError("device is cuda, but Taichi finds no CUDA device; use cpu")
    with contextlib.redirect_stdout(io.StringIO()):  # ti.init prints the device it starts on
        ti.init(
            arch=arch, default_fp=real, default_ip=ti.i32, cpu_max_num_threads=threads, log_level=ti.ERROR,
            enable_fallback=False, real_matrix_scalarize=device == "cuda",
        )  # fmt: skip
