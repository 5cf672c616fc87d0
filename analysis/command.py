"""How the commands of `analysis` present themselves, end, and time what they measure. Python's own modules alone."""

import argparse
import functools
import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ParamSpec

from hoi.errors import InputError, RunError

Given = ParamSpec("Given")


def parser(module: str, description: str, example: str) -> argparse.ArgumentParser:
    """Of `python -m module`; the example is what may follow that."""
    name = f"python -m {module}"
    return argparse.ArgumentParser(prog=name, description=description, epilog=f"example: {name} {example}")


def exit_code(module: str) -> Callable[[Callable[Given, int | None]], Callable[Given, int]]:
    """Makes `main` return the exit code: its own or 0; after one line on standard error 2 for bad input, 3 for a failed
    run."""

    def of(main: Callable[Given, int | None]) -> Callable[Given, int]:
        @functools.wraps(main)
        def ended(*args: Given.args, **kwargs: Given.kwargs) -> int:
            try:
                return main(*args, **kwargs) or 0
            except (InputError, RunError, OSError) as error:
                print(f"{module}: {error}", file=sys.stderr)
                return 3 if isinstance(error, RunError) else 2

        return ended

    return of


def timed(
    step: Callable[[], object], turns: int, warm_up: int = 1, clock: Callable[[], float] = time.perf_counter
) -> list[float]:
    """What each of `turns` turns takes [s], after `warm_up` that do not count."""
    spent = []
    for _ in range(warm_up + turns):
        began = clock()
        step()
        spent.append(clock() - began)
    return spent[warm_up:]


def add_peer(parser: argparse.ArgumentParser, package: str, name: str) -> None:
    """--peer: the Python that has another system to measure beside ours."""
    parser.add_argument("--peer", default=sys.executable if importlib.util.find_spec(package) else None,
                        metavar="PYTHON", help=f"one with {name} (default: this one, if it has it)")  # fmt: skip


def called_in(
    python: str, call: str, says: Callable[[list[str]], str], environment: Mapping[str, str] | None = None
) -> Any:
    """What `call`, "module.function(...)" of this package, returns in a process of that Python, by way of JSON.

    Raises:
        InputError: it failed; `says` words it, given the last line that it wrote, if any.
    """
    code = f"import json; from {__package__} import {call.partition('.')[0]}; print(json.dumps({call}))"
    root, environment = (
        Path(__file__).parents[len((__package__ or "").split("."))],
        os.environ | dict(environment or {}),
    )
    done = subprocess.run([python, "-c", code], cwd=root, capture_output=True, text=True, env=environment)
    if done.returncode != 0:
        raise InputError(says(done.stderr.strip().splitlines()[-1:]))
    return json.loads(done.stdout.strip().splitlines()[-1])
