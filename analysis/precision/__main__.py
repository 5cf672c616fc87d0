"""Error against run time: `python -m analysis.precision [--quick] [--problems NAMES] [-o FOLDER]`.

NAMES are physics, renderer, contacts, or single problems; the default is all.

Of the object's physics: problems with known answers and benchmark scenes, each computed in many ways; see
`analysis.precision.problems`, `.scenes`, `.run` for the ways and `.convergence` for the orders. Writes precision.csv,
precision.md and precision.png. Of the renderer: pictures, each made in many ways; see `analysis.precision.pictures`.
Writes rendering.csv, rendering.md and rendering.png. Of stage 3: contacts, each refined in many ways; see
`analysis.precision.contacts`. Writes contacts.csv, contacts.md, contacts.png and closeups.png.
"""

import argparse
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hoi.errors import InputError
from hoi.terminal.program import program

from .. import command, sheets

if TYPE_CHECKING:
    from .pictures import View
    from .problems import Problem

DEFAULT_OUT = Path("runs/precision")
CONTACTS = "contacts"
STARTS = ".starts"
"""Hidden: the runs that contacts are refined from are none of the table's."""


Study = tuple[list[str], str, list[Path]]
"""What to say of it, what was done, the files."""


def refuse(message: str) -> NoReturn:
    raise InputError(message)


@command.exit_code("analysis.precision")
def main() -> None:
    parser = command.parser(
        "analysis.precision",
        "Error against run time, of physics, renderer and stage 3: tables, reports, pictures.",
        "--problems physics --quick",
    )
    parser.error = refuse  # in one line, without the usage
    parser.add_argument("-o", "--out", type=Path, default=DEFAULT_OUT, help=f"folder (default {DEFAULT_OUT})")
    parser.add_argument("--problems", help="names, physics, renderer or contacts, separated by commas")
    parser.add_argument("--quick", action="store_true", help="few and small variants of two problems and of pictures")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each short variant (default 3)")
    parser.add_argument("--threads", type=int, default=1, help="of each run (default 1)")
    arguments = parser.parse_args()
    from .pictures import VIEWS
    from .problems import EXACT
    from .scenes import SCENES

    cores = os.cpu_count() or 1
    if arguments.repeats < 1:
        raise InputError(f"--repeats must be 1 or more, got {arguments.repeats}")
    if not 1 <= arguments.threads <= cores:
        raise InputError(f"--threads must be from 1 to the {cores} cores of this machine, got {arguments.threads}")
    problems = {problem.__name__: problem for problem in (*EXACT, *SCENES)}
    views = {view.__name__: view for view in VIEWS}
    physics = ["waves", "punch"] if arguments.quick else list(problems)
    groups = {"physics": physics, "renderer": list(views), CONTACTS: [CONTACTS]}
    given = (arguments.problems or ",".join(groups)).split(",")
    names = dict.fromkeys(name for word in given for name in groups.get(word, [word]))
    known = [*problems, *views, CONTACTS]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"--problems must be of {', '.join([*groups, *known])}, got {', '.join(unknown)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    studies: list[tuple[Callable[[argparse.Namespace, Any], Study], list[Any]]] = [
        (_physics, [problems[name] for name in names if name in problems]),
        (_renderer, [views[name] for name in names if name in views]),
        (_contacts, [CONTACTS] if CONTACTS in names else []),
    ]
    for study, chosen in studies:
        if chosen:
            began = time.perf_counter()
            said, done, paths = study(arguments, chosen)
            print(*said, f"{done} in {time.perf_counter() - began:.0f} s", *paths, sep="\n")


def _physics(arguments: argparse.Namespace, chosen: "Sequence[Callable[[], Problem]]") -> Study:
    from . import convergence, report, run

    problems = [make() for make in chosen]
    orders = convergence.manufactured(arguments.quick) if "waves" in [problem.name for problem in problems] else []
    table = run.study(
        problems, quick=arguments.quick, repeats=arguments.repeats, threads=arguments.threads, cores=os.cpu_count() or 1
    )
    orders += convergence.by_grid(table)
    paths = report.write(arguments.out, problems, table, orders, sheets.facts(arguments.threads))
    said = [f"order    {order.series} ({order.quantity}): {order.observed:.2f} {order.verdict}" for order in orders]
    return said, f"{len(table)} runs", paths


def _renderer(arguments: argparse.Namespace, chosen: "Sequence[Callable[[bool], View]]") -> Study:
    from . import picture_report, pictures

    views = [make(arguments.quick) for make in chosen]
    table, off, truths = pictures.study(
        views, quick=arguments.quick, repeats=arguments.repeats, threads=arguments.threads
    )
    paths = picture_report.write(arguments.out, views, table, off, truths, sheets.facts(arguments.threads))
    said = [
        f"{name:8} float64 against brute force: {difference:.1e} {picture_report.verdict(difference)}"
        for name, difference in off.items()
    ]
    return said, f"{len(table)} ways to make a picture", paths


def _contacts(arguments: argparse.Namespace, _: Sequence[str]) -> Study:
    from . import closeups, contact_report, contacts

    folder, threads = arguments.out / STARTS, arguments.threads
    scenes, seeds = (
        (contacts.QUICK_SCENES, contacts.QUICK_SEEDS) if arguments.quick else (contacts.SCENES, contacts.SEEDS)
    )
    table = contacts.study(folder, scenes, seeds, threads, arguments.quick)
    paths = contact_report.write(arguments.out, table, sheets.facts(threads))
    if not arguments.quick:
        shown = contacts.starts(folder, closeups.SCENES, seeds, threads)
        first = [start for start in shown if start.setting == "paper" and start.seed == 0]
        best = [way for way in contacts.ways() if way.name in closeups.WAYS]
        paths.append(closeups.draw(first, best, arguments.out / "closeups.png"))
    return [], f"{len(table)} contacts refined", paths


if __name__ == "__main__":
    program(main)
