"""Which GPUs are there, asked of NVIDIA's driver: without torch, in milliseconds."""

import ctypes
from dataclasses import dataclass

LIBRARY = "libcuda.so.1"


@dataclass(frozen=True)
class GPU:
    """A CUDA device."""

    name: str
    memory: int
    """All that it has [bytes]."""


def gpus(library: str = LIBRARY) -> list[GPU]:
    """The CUDA devices of this machine; none where there is no driver, or it does not answer."""
    try:
        cuda = ctypes.CDLL(library)
    except OSError:
        return []
    count = ctypes.c_int()
    if cuda.cuInit(0) != 0 or cuda.cuDeviceGetCount(ctypes.byref(count)) != 0:
        return []
    found = []
    for index in range(count.value):
        device, name, memory = ctypes.c_int(), ctypes.create_string_buffer(100), ctypes.c_size_t()
        answers = (
            cuda.cuDeviceGet(ctypes.byref(device), index),
            cuda.cuDeviceGetName(name, len(name), device),
            cuda.cuDeviceTotalMem_v2(ctypes.byref(memory), device),
        )
        if not any(answers):
            found.append(GPU(name.value.decode(), memory.value))
    return found
