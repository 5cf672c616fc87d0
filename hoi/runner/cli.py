"""The command `hoi`: what there is to do, and the way to it. `hoi run ...` is `python -m hoi.run ...`, and so on.

Nothing heavy is imported: every command is a program that this one becomes.
"""

import os
import re
import runpy
import shlex
import sys
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import NoReturn

from hoi import __version__
from hoi.terminal.program import arrived, lasting_console


@dataclass(frozen=True)
class Command:
    """What one can do."""

    module: str
    """`python -m` of this is the same."""
    does: str
    """One line."""


COMMANDS = {
    "Make": {
        "run": Command("hoi.run", "a scene, or a sweep of them: the record run.mcap and its video"),
        "doctor": Command("hoi.runner.doctor", "what this machine can do, and what each experiment still lacks here"),
        "sample": Command("hoi.runner.sample", "a motion from a sentence: .npz, or a record to look at"),
    },
    "Look": {
        "view": Command("hoi.view", "runs in the browser, in 3D; two side by side; --live: one that is being set up"),
        "video": Command("hoi.render.video", "a video or filmstrip from any side; runs side by side"),
        "strip": Command("analysis.strip", "one picture of a run: frames, contact, speeds"),
        "layouts": Command("hoi.view.layouts", "how Foxglove and Rerun show a record"),
    },
    "Take away": {
        "export": Command("hoi.export", "GLB, splats, motion, tables and more of a run"),
    },
    "Bring": {
        "convert": Command("hoi.importers.convert", "a person: SMPL body or HUGS checkpoint"),
        "rest-joints": Command(
            "hoi.importers.rest_joints", "the published motion prior's skeleton, of your SMPL-H file"
        ),
        "import-scene": Command("hoi.importers.scene", "a scene file of PhysGaussian or DreamPhysics"),
        "ingest": Command("analysis.ingest", "another system's video or meshes, as a record"),
    },
    "Compare": {
        "table": Command("analysis.table", "all runs in one table"),
        "report": Command("analysis.report", "all runs on one HTML page"),
        "study": Command("analysis.study", "a user study: the page for raters, and their scores"),
        "variations": Command("analysis.variations", "what each variation of a scene does to the strike"),
        "learned": Command("analysis.learned", "learned metrics of videos: CLIP, VQA and the like"),
        "baseline": Command("analysis.baseline", "kinematic replay, to compare with"),
    },
    "Measure": {
        "bench": Command("analysis.bench", "seconds by stage"),
        "bench-mpm": Command("analysis.mpm_bench", "milliseconds of an MPM step"),
        "bench-render": Command("analysis.render_bench", "milliseconds of a picture"),
        "precision": Command("analysis.precision", "error against run time"),
        "stability": Command("analysis.stability", "extreme cases of the MPM"),
        "motion": Command("analysis.motion", "motion priors against real clips"),
        "reach": Command("analysis.reach", "how near the limb comes to objects all around"),
        "placement": Command("analysis.placement", "who strikes, with and without attraction, placement and prior"),
        "strikes": Command("analysis.strikes", "what stage 2 does to motions"),
        "bench-prior": Command("analysis.video_prior_bench", "stage 3 with video priors, over scenes and seeds"),
        "probe-prior": Command("analysis.video_prior_probe", "what a video prior asks for at contacts"),
    },
    "Train": {
        "train": Command("hoi.training.motion.train", "a motion prior"),
        "train-evaluator": Command("hoi.training.motion.train_evaluator", "the judge of motions"),
        "train-video": Command("hoi.training.video.train", "a video prior"),
    },
}
"""By heading and name."""

INSIDE = "hoi." if (Path(__file__).parents[1] / "analysis").is_dir() else ""
"""A wheel carries the folder `analysis` in the package, as it does `conf`; in a checkout it stands beside it."""

LIVE = "--live"
"""`hoi view --live` is `python -m hoi.live`."""

COMPLETION = ("-sc", "--shell-completion")
"""Hydra's flags."""


def modules() -> dict[str, str]:
    """Name -> module of every command."""
    return {
        name: f"{INSIDE if command.module.startswith('analysis.') else ''}{command.module}"
        for group in COMMANDS.values()
        for name, command in group.items()
    }


def overview() -> str:
    """All commands, a line each, and how to begin."""
    width = max(map(len, modules())) + 2
    lines = ["Physically-aware 4D human-object interaction from a sentence and two Gaussian clouds.", ""]
    lines += ["usage: hoi COMMAND ...       hoi COMMAND --help tells more, with an example", ""]
    for heading, group in COMMANDS.items():
        lines += [heading, *(f"  {name:{width}}{command.does}" for name, command in group.items()), ""]
    lines += [
        "Example",
        "  hoi run scene=kick_soccer_ball seed=1",
        "  hoi view runs/kick_soccer_ball/laptop/full/s1/run.mcap",
        "",
        'Completion in this shell: eval "$(hoi run -sc install=bash)"',
    ]
    return "\n".join(lines)


def main() -> None:
    """Entry point of `hoi`. Exit codes are the command's own; 2 for a command that is not there."""
    lasting_console()
    first, *rest = sys.argv[1:] or ["--help"]
    if first in ("-h", "--help", "help", "-V", "--version"):
        print(f"hoi {__version__}" if first in ("-V", "--version") else overview())
        if code := arrived():
            sys.exit(code)
    elif first in COMPLETION:
        _complete([first, *rest])
    elif first == "run" and rest[:1] and rest[0] in COMPLETION:
        _complete(rest)
    elif first == "view" and LIVE in rest:
        _become("hoi.live", [word for word in rest if word != LIVE])
    elif first in modules():
        _become(modules()[first], rest)
    else:
        sys.exit(_unknown(first))


def _become(module: str, arguments: list[str]) -> NoReturn:
    """This process goes on as `python -m module`: its signals, output and exit code are that program's."""
    sys.stdout.flush()
    if not sys.executable:  # Python was not told where it is
        sys.argv = [module, *arguments]
        runpy.run_module(module, run_name="__main__", alter_sys=True)
        sys.exit(0)
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])


def _unknown(word: str) -> int:
    if "=" in word:
        meant = f"hoi run {word}"
    elif " " in word.strip():
        meant = f"hoi run {shlex.quote(word)}"
    else:
        meant = f"hoi {get_close_matches(word, modules(), 1, cutoff=0)[0]}"
    print(f"hoi: no command {word}; the nearest is {meant} (hoi --help lists them all)", file=sys.stderr)
    return 2


def _complete(flags: list[str]) -> None:
    """What Hydra's completion asks of a program: a script for the shell, or what may come next in COMP_LINE."""
    line = re.match(r"\s*\S+\s+(\S+)\s(.*)", os.environ.get("COMP_LINE", ""), re.DOTALL)
    if any(word.startswith("query=") for word in flags):
        if line is None:
            print(*modules())
            return
        if line[1] != "run":
            return  # the shell completes files
        os.environ["COMP_LINE"] = f"hoi {line[2]}"
    from hoi.runner.main import main as run

    sys.argv = ["hoi", *flags]
    run()
