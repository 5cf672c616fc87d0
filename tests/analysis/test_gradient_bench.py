"""The benchmark of gradients: its rows, and what it says of bad arguments."""

import subprocess
import sys

from analysis import gradient_bench


def test_a_row_counts_what_was_measured() -> None:
    row = gradient_bench.measure(200, 40, "neo_hookean", "float64", True)
    assert row["particles"] == 200 and float(row["gradient / forward"]) > 1
    assert 34 < float(row["states kept"]) < 45


def test_bad_arguments_are_one_line() -> None:
    command = [sys.executable, "-m", "analysis.gradient_bench", "--steps", "0"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "analysis.gradient_bench: --particles and --steps must be 1 or more\n"
