"""The user study.

    python -m analysis.study make DIR... -o OUT [--key KEY] [--seed N]
    python -m analysis.study score ANSWERS... --key KEY [-o FOLDER]

`make` writes a page that works from a file: OUT is a folder, or a file *.html with the videos inside. The key, which
says which video is whose, goes beside it and stays with you. `score` reads what raters send back.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from hoi.errors import InputError, RunError
from hoi.terminal.program import program


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog=f"python -m {__package__}",
        description=__doc__,
        epilog="example: %(prog)s make runs -o study.html",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    page = commands.add_parser("make", help="a page from the videos of recorded runs")
    page.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="every run.mcap with a run.mp4 below it")
    page.add_argument("-o", "--out", type=Path, required=True, help="a new folder, or a new file *.html")
    page.add_argument("--key", type=Path, help="where the key goes (default: OUT.key.json)")
    page.add_argument("--seed", type=int, help="of the videos' names (default: one that nobody can guess)")
    table = commands.add_parser("score", help="mean opinion scores from answers")
    table.add_argument("answers", type=Path, nargs="+", metavar="ANSWERS", help="what raters saved: *.json or *.csv")
    table.add_argument("--key", type=Path, required=True, help="the key of the study")
    table.add_argument("-o", "--out", type=Path, help="a folder for study.csv, study_agreement.csv and study.md")
    arguments = parser.parse_args(argv)
    try:
        return _make(arguments) if arguments.command == "make" else _score(arguments)
    except (InputError, RunError) as error:
        print(f"analysis.study: {' '.join(str(error).split())}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3


def _make(arguments: argparse.Namespace) -> int:
    from .make import find_clips, make

    clips, without = find_clips(arguments.folders)
    print(make(clips, arguments.out, arguments.key, arguments.seed))
    for record in without:
        print(f"left out, no run.mp4 beside it: {record}")
    return 0


def _score(arguments: argparse.Namespace) -> int:
    from .answers import read_answers, read_key
    from .score import opinion_scores, rater_agreement, to_markdown, write

    key = read_key(arguments.key)
    answers = read_answers(arguments.answers, key)
    scores, agreement = opinion_scores(answers, key), rater_agreement(answers)
    if arguments.out:
        write(scores, agreement, arguments.out)
    print(to_markdown(scores, agreement), end="")
    return 0


if __name__ == "__main__":
    program(main)
