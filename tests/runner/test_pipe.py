"""`| head`: nobody reads on, and nothing is said about it."""

import os
import subprocess
import sys

import pytest

COMMANDS = {
    "hoi": [],
    "hoi.run": ["plan_only=true"],
    "hoi.runner.doctor": [],
    "analysis.reach": ["--help"],
    "hoi.importers.rest_joints": ["--help"],
}


@pytest.mark.parametrize("module", COMMANDS)
def test_a_reader_that_has_seen_enough_ends_it_quietly(module, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", module, *COMMANDS[module]]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    os.close(writing)
    assert done.stderr == "" and done.returncode in (0, 141)  # argparse itself sees to its help
