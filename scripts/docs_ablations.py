"""The page that says what each ablation differs in from the full method, made from composed configs and their plans.

`python scripts/docs_ablations.py` prints it, as Markdown.
"""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any

from hoi.config import Ablation, Config
from hoi.config.compose import config_of
from hoi.data import Plan
from hoi.plan import make_plan
from hoi.stages.contract import Option

NAMES = {
    Ablation.no_attraction: "w/o Attraction",
    Ablation.no_contact: "w/o Contact",
    Ablation.no_mdm: "w/o MDM",
    Ablation.no_mpm: "w/o MPM",
    Ablation.no_video_sds: "w/o Video-SDS",
}
EXPERIMENTS = ("laptop", "paper")
SCENES = ("kick_soccer_ball", "knee_clay")
"""One whose contact is an impulse in every experiment, and one with a collider in `laptop`."""
LABELS = ("ablation", "out")
"""Keys that name the ablation and change nothing."""
INTRODUCTION = """\
# What each ablation leaves out

One thing each: an ablation chooses another option of one stage, and everything else (placement, contact, the random
stream of every stage) is as in the full method. This page is made from the composed configs and their plans. A test
composes every experiment with every ablation in every scene and finds no key outside that one stage that differs.

*Placement* (`scene.approach`) is no part of the attraction. It is on in all variants of `experiment=laptop`, off in all
of `experiment=paper`, since the paper says nothing of it, and a factor of its own: `experiment=unplaced` is laptop
without it.
"""


@cache
def composed(*overrides: str) -> tuple[Config, Plan]:
    """The config of a command line and its plan."""
    config = config_of(*overrides)
    return config, make_plan(config)


def values(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key of a config with its value; an option of a stage is its name first, then its values."""
    if isinstance(node, Option):
        yield f"{node.group}", node.name
    for each in fields(node):
        value, key = getattr(node, each.name), f"{path}.{each.name}".lstrip(".")
        if is_dataclass(value):
            yield from values(value, key)
        else:
            yield key, value.value if isinstance(value, Enum) else value


def chosen(full: Config, ablated: Config) -> list[tuple[str, str, str]]:
    """Key, value in full, value without: the options that differ, or, where none does, the keys."""
    before, after = dict(values(full)), dict(values(ablated))
    keys = [key for key in before | after if before.get(key) != after.get(key) and key not in LABELS]
    options = [key for key in keys if "/" in key]
    inside = {key.replace("/", ".") for key in options}
    rest = [key for key in keys if key not in options and key.rpartition(".")[0] not in inside]
    return [(key, str(before.get(key)), str(after.get(key))) for key in (*options, *rest)]


def steps(full: Plan, ablated: Plan) -> list[tuple[str, str, str]]:
    """Step, what it is in full, what it is without: those of the plan that differ."""
    before, after = ({step.name: f"{step.implementation}: {step.reason}" for step in p.steps} for p in (full, ablated))
    names = [name for name in before | after if before.get(name) != after.get(name)]
    return [(name, before.get(name, "-"), after.get(name, "-")) for name in names]


def omissions(full: Plan, ablated: Plan) -> list[str]:
    """What the plan leaves out beside what full leaves out, and why."""
    known = {omission.what for omission in full.omissions}
    return [f"{each.what}: {each.because}" for each in ablated.omissions if each.what not in known]


def table(head: tuple[str, ...], rows: list[tuple[str, str, str]]) -> str:
    escaped = [tuple(cell.replace("|", "\\|").replace("*", "\\*") for cell in row) for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ("---",) * len(head), *escaped))


def section(ablation: Ablation) -> Iterator[str]:
    """Of one ablation, the same differences of several experiments and scenes told once."""
    told: dict[str, list[str]] = {}
    for experiment in EXPERIMENTS:
        for scene in SCENES:
            where = (f"experiment={experiment}", f"scene={scene}")
            (full, full_plan), (ablated, ablated_plan) = composed(*where), composed(*where, f"ablation={ablation}")
            head = ("", "full", NAMES[ablation])
            config = [(f"`{key}`", f"`{before}`", f"`{after}`") for key, before, after in chosen(full, ablated)]
            text = table(head, [*config, *steps(full_plan, ablated_plan)])
            left_out = [f"- {line}" for line in omissions(full_plan, ablated_plan)]
            told.setdefault("\n".join([text, "", *left_out]), []).append(" ".join(f"`{each}`" for each in where))
    for text, places in told.items():
        yield f"{'; '.join(places)}:"
        yield text


def page() -> str:
    """The page, as Markdown."""
    parts = [INTRODUCTION]
    for ablation, name in NAMES.items():
        parts += [f"## {name}", f"`ablation={ablation.value}`", *section(ablation)]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    print(page(), end="")
