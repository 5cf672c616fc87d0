"""What this machine can do: `hoi doctor [OVERRIDE ...]`.

Python, cores, memory, space, GPU and packages; then of each experiment whether all that it needs is there, and if not
what is missing, how large it is and where to get it. Nothing is computed, written or downloaded. Exit codes: 0 where
the default experiment can run, 2 where it cannot or an override is refused.
"""

import argparse
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hoi.compute import compiler
from hoi.config import CONF
from hoi.config.compose import config_of
from hoi.data import Plan
from hoi.errors import InputError
from hoi.gpu import GPU, gpus
from hoi.plan import make_plan
from hoi.terminal.program import program

DEFAULT = "laptop"
PYTHON = (3, 11)
MEMORY, SPACE = 2e9, 2e9
"""What a run takes of memory, and a sweep of the benchmark of the disk [bytes]."""
OPTIONAL = ("diffusers", "sentencepiece", "gsplat", "joblib")
"""Packages that some options ask for."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.runner.doctor",
        description="What this machine can do: of each experiment what it needs and what of it is missing here.",
        epilog="example: python -m hoi.runner.doctor mdm=weights/mdm-smpl cogvideox=weights/CogVideoX-5b",
    )
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="as of hoi run, such as mdm=FOLDER")
    return parser


def machine() -> Iterator[tuple[str, str, str]]:
    """What is looked at, what it is, and what is wrong with it; the last empty where nothing is."""
    python = platform.python_version()
    yield "Python", python, "" if sys.version_info >= PYTHON else f"{'.'.join(map(str, PYTHON))} or newer is needed"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield "cores", str(cores), ""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    yield "memory", gigabytes(memory), "" if memory > MEMORY else f"a run takes up to {gigabytes(MEMORY)}"
    space = shutil.disk_usage(Path.cwd()).free
    yield "free space here", gigabytes(space), "" if space > SPACE else f"the benchmark writes {gigabytes(SPACE)}"
    found = gpus()
    said = ", ".join(f"{gpu.name}, {gigabytes(gpu.memory)}" for gpu in found)
    yield "GPU", said or "none", ""
    for package in ("torch", compiler(), *OPTIONAL):
        try:
            yield package, version(package), ""
        except PackageNotFoundError:
            yield package, "not installed", "" if package in OPTIONAL else "is needed: pip install hoi"
    if found:
        import torch

        seen = torch.cuda.is_available()
        yield (
            "torch and the GPU",
            "work" if seen else "do not",
            "" if seen else f"torch {torch.__version__} sees no GPU",
        )


def gigabytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB"


def experiments() -> list[str]:
    """Their names, the default first."""
    names = sorted(file.stem for file in (CONF / "experiment").glob("*.yaml"))
    return sorted(names, key=lambda name: name != DEFAULT)


def verdict(plan: Plan, found: list[GPU]) -> list[str]:
    """Whether a plan can run here: "ready", or a line for each thing that is missing."""
    lines = [str(each) for each in plan.missing]
    wanted = next((float(c.value.split()[0]) * 1e9 for c in plan.checks if c.name == "gpu_memory"), 0.0)
    most = max((gpu.memory for gpu in found), default=0)
    if found and wanted > most:
        lines.append(
            f"stage 3 takes about {gigabytes(wanted)} of GPU memory, the largest here has {gigabytes(most)}; "
            "stage.refine.offload=true takes less, and so do smaller stage.refine.clip_frames, width and height"
        )
    ready = not any(each.needed for each in plan.missing) and len(lines) == len(plan.missing)
    return ["ready" if ready else "not yet", *lines]


def main() -> int:
    overrides = parser().parse_args().overrides
    wrong = False
    for name, value, problem in machine():
        print(f"{name:18}{value}{f'   <- {problem}' if problem else ''}")
        wrong |= bool(problem)
    print()
    for name in experiments():
        try:
            first, *lines = verdict(make_plan(config_of(f"experiment={name}", *overrides)), gpus())
        except InputError as error:
            print(f"doctor: {error}", file=sys.stderr)
            return 2
        print(f"{f'experiment={name}':28}{first}", *(f"  - {line}" for line in lines), sep="\n")
        wrong |= name == DEFAULT and first != "ready"
    return 2 if wrong else 0


if __name__ == "__main__":
    program(main)
