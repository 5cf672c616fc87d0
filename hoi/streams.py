"""One named random stream a stage, so that leaving a stage out does not shift the others: ablations stay paired."""

import zlib

import numpy as np


def stream_seed(seed: int, name: str) -> int:
    """A 63-bit seed for the stream `name` of a run with `seed`."""
    words = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)).generate_state(2, np.uint32)
    return (int(words[0]) << 31) ^ int(words[1])
