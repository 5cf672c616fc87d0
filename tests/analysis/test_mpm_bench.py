"""The benchmark of the MPM: its rows, and what it says of bad arguments."""

import subprocess
import sys

import pytest

from analysis import mpm_bench


def test_a_row_counts_what_was_measured() -> None:
    row = mpm_bench.measure(300, "neo_hookean", 1, "float32", "cpu")
    assert row["particles"] == 300 and float(row["ms/step"]) > 0
    assert float(row["M particle-steps/s"]) == pytest.approx(300 / float(row["ms/step"]) / 1e3)
    assert float(row["bytes/particle"]) > 4 * (8 + 4 + 12 + 12 + 2)
    assert "neo_hookean" in str(row["solver"]) and "1 thread" in str(row["solver"])


def test_bad_arguments_are_one_line() -> None:
    command = [sys.executable, "-m", "analysis.mpm_bench", "--particles", "0"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "analysis.mpm_bench: --particles and --threads must be 1 or more\n"
