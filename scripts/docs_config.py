"""The reference of all config keys, made from `hoi.config`, the files of `conf/` and what they compose to.

`python scripts/docs_config.py` prints the page, as Markdown.
"""

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import yaml
from omegaconf import DictConfig, OmegaConf

from hoi.config import CONF, SCHEMAS, Config, compose

GIVEN = {
    "object=from_file": ["object.path=thing.ply", "object.size=0.4"],
    "human=avatar": ["human.path=lab"],
    "human=smpl": ["human.path=SMPL_NEUTRAL.npz"],
    "stage/motion=file": ["stage.motion.path=kick.bvh"],
}
"""What an option asks for beside itself."""
NO_KEYS = ("experiment", "ablation")
"""Groups that only set the keys of others."""
INTRODUCTION = """\
# Every config key

A run is composed from `conf/config.yaml` and one file of each group below; everything can be set on the command line,
`python -m hoi.run object.size=0.3 stage/refine=geometric`: a slash chooses a file, a dot sets a value. `???` has no
default and must be given; `null` is none. *paper* is what `experiment=paper` takes, where that differs; *unit* is - for
a number that has none. What is out of range is refused in one line before anything is computed.

This page is made from the schemas in `hoi/config/` and the options in `hoi/stages/`, named under each heading, and the
files in `conf/`, with their comments as the sources.
"""


class Setting(NamedTuple):
    """Where a value stands in `conf/`, and what the file says of it."""

    file: str
    comment: str


@dataclass(frozen=True)
class Key:
    """A row of the reference."""

    path: str
    unit: str
    default: str
    paper: str
    about: str
    source: str


@dataclass(frozen=True)
class Section:
    """The keys of a schema, where it stands in the config."""

    group: str
    title: str
    about: str
    keys: tuple[Key, ...]


def composed(*overrides: str) -> DictConfig:
    """The config of a command line, with Hydra's part, and what needs a value given."""
    given = [value for option, values in GIVEN.items() if option in overrides for value in values]
    return compose.composed(*overrides, *given, with_hydra=True)


@cache
def descriptions(schema: type) -> dict[str, str]:
    """Field -> the docstring under it; where there is none, that of the type that "See `...`" in the class names."""
    found = {}
    for cls in reversed(schema.__mro__[:-1]):
        (tree,) = ast.parse(inspect.cleandoc(inspect.getsource(cls))).body
        assert isinstance(tree, ast.ClassDef)
        if named := re.search(r"[Ss]ee `(\w+\.\w+)\.(\w+)`", cls.__doc__ or ""):
            found |= descriptions(getattr(import_module(named[1]), named[2]))
        for line, after in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name) and isinstance(after, ast.Expr):
                found[line.target.id] = " ".join(ast.literal_eval(after.value).split())
    return found


def unit_and_text(description: str) -> tuple[str, str]:
    """ "Largest extent [m]." -> "m", "Largest extent."; shapes are left out."""
    description = re.sub(r", shape \([^)]*\)", "", description)
    unit = re.search(r" ?\[([^\[\],]+)\]", description)
    return (unit[1], description.replace(unit[0], "", 1)) if unit else ("", description)


def settings(file: Path, package: str) -> Iterator[tuple[str, Setting]]:
    """Path in the config -> where it is set, of a file and those it is built on."""
    text = file.read_text()
    lines = text.splitlines()
    parts = yaml.safe_load(text) or {}
    for parent in parts.get("defaults", []):
        if isinstance(parent, str) and (file.parent / f"{parent}.yaml").is_file():
            yield from settings(file.parent / f"{parent}.yaml", package)
    if "@package _global_" in lines[0]:
        package = ""

    def walk(node: yaml.Node, prefix: str) -> Iterator[tuple[str, Setting]]:
        if not isinstance(node, yaml.MappingNode):
            return
        for key, value in node.value:
            path = f"{prefix}.{key.value}" if prefix else key.value
            if path.split(".")[-1] == "defaults" or path.startswith("hydra"):
                continue
            number = key.start_mark.line
            above = []
            while number > 0 and lines[number - 1].lstrip().startswith("#"):
                number -= 1
                above.insert(0, lines[number].strip().lstrip("# "))
            if number == 0:  # the title of the file
                above = []
            beside = re.search(r"\s#\s(.*)$", lines[key.start_mark.line])
            said = " ".join([*above, *([beside[1].strip()] if beside else [])])
            yield path, Setting(str(file.relative_to(CONF.parent)), re.sub(r"\[[^\[\],]+\][,;:]? ?", "", said))
            yield from walk(value, path)

    yield from walk(yaml.compose(text), package)


def groups() -> list[str]:
    """The folders of options, in the order of the defaults list."""
    order = yaml.safe_load((CONF / "config.yaml").read_text())["defaults"]
    return [group for entry in order if isinstance(entry, dict) for group in entry if (CONF / group).is_dir()]


def value_text(value: Any) -> str:
    """A value as the command line takes it."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def inner_type(hint: Any) -> Any:
    """The type of which a field holds one, or None, or a list."""
    arguments = [each for each in get_args(hint) if each is not NoneType]
    return inner_type(arguments[0]) if arguments else hint


def is_list(hint: Any) -> bool:
    return any(get_origin(each) is list for each in (hint, *get_args(hint)))


@dataclass(frozen=True)
class Sources:
    """Where defaults are read: the composed config, that of experiment=paper, and which file sets what."""

    config: DictConfig
    paper: DictConfig
    files: dict[str, Setting]

    def keys(self, schema: type, path: str = "") -> Iterator[Key]:
        """The rows of a schema and of what it holds; but the groups, which have sections of their own."""
        hints, texts = get_type_hints(schema), descriptions(schema)
        for field in fields(schema):
            name, kind = f"{path}.{field.name}".lstrip("."), inner_type(hints[field.name])
            nested, many = is_dataclass(kind), is_list(hints[field.name])
            if many or not nested:
                yield self._key(name, field, kind, texts.get(field.name, ""), file_of(schema))
            if nested and path:
                yield from self.keys(kind, f"{name}[]" if many else name)

    def _key(self, path: str, field: Field, kind: Any, description: str, schema_file: str) -> Key:
        unit, about = unit_and_text(description)
        if isinstance(kind, type) and issubclass(kind, Enum):
            about = f"{about} Choices: {', '.join(f'`{choice.value}`' for choice in kind)}."
        if "[]" in path:  # of an entry of a list, which is empty by default
            default = field.default if field.default is not MISSING else field.default_factory()  # pyright: ignore
            return Key(path, unit, "" if is_dataclass(default) else value_text(default), "", about, f"`{schema_file}`")
        default, papers = (value_text(written(config, path)) for config in (self.config, self.paper))
        file, comment = self.files.get(path, Setting(schema_file, ""))
        source = f"`{file}`: {comment}" if comment and not about.startswith(comment) else f"`{file}`"
        return Key(path, unit, default, papers if papers != default else "", about, source)


def written(config: DictConfig, path: str) -> Any:
    """A value as it was written, interpolations unresolved; ??? where there is none."""
    node = OmegaConf.select(config, path.rpartition(".")[0]) if "." in path else config
    values = OmegaConf.to_container(node, resolve=False)
    assert isinstance(values, dict)
    return values[path.rpartition(".")[2]]


def schema_of(group: str, option: str) -> type:
    """What an option's file is checked against, as its defaults list or that of its parent says."""
    for entry in yaml.safe_load((CONF / group / f"{option}.yaml").read_text())["defaults"]:
        if isinstance(entry, str) and entry.startswith("/schema/"):
            return SCHEMAS[tuple(entry.partition("@")[0].lstrip("/").rsplit("/", 1))]  # pyright: ignore[reportArgumentType]
        if isinstance(entry, str) and entry in options(group):
            return schema_of(group, entry)
    raise ValueError(f"conf/{group}/{option}.yaml names no schema")


def _sections() -> Iterator[Section]:
    """Of each group its default option's schema first, then those that have keys which that has not."""
    config, paper = composed(), composed("experiment=paper")
    choices = config.hydra.runtime.choices
    files = dict(settings(CONF / "config.yaml", ""))
    for group in groups():
        files |= settings(CONF / group / f"{choices[group]}.yaml", group.replace("/", "."))
    yield Section("", "The run", "", tuple(Sources(config, paper, files).keys(Config)))
    for group in groups():
        path = group.replace("/", ".")
        if group in NO_KEYS:
            continue
        shown: list[type] = []
        for option in sorted(options(group), key=lambda name: name != choices[group]):
            schema = schema_of(group, option)
            if any(issubclass(other, schema) for other in shown):
                continue
            shown.append(schema)
            chosen = config if option == choices[group] else composed(f"{group}={option}")
            papers = paper if OmegaConf.get_type(OmegaConf.select(paper, path)) is schema else chosen
            here = files | dict(settings(CONF / group / f"{option}.yaml", path))
            rows = tuple(Sources(chosen, papers, here).keys(schema, path))
            about = f"{' '.join((schema.__doc__ or '').split())} In `{file_of(schema)}`."
            yield Section(group, f"`{group}={option}`", about, rows)


def file_of(schema: type) -> str:
    """Where a schema, or an option with its checks, plan and run, stands in the repository."""
    return str(Path(inspect.getfile(schema)).relative_to(CONF.parent))


@cache
def sections() -> tuple[Section, ...]:
    """The whole reference."""
    return tuple(_sections())


def options(group: str) -> list[str]:
    """The files of a group."""
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))


def title_of(file: Path) -> str:
    """What an option's file says of itself in its first lines."""
    said = []
    for line in file.read_text().splitlines():
        if not line.startswith("#"):
            break
        if "@package" not in line:
            said.append(line.lstrip("# "))
    return " ".join(said)


def cell(text: str) -> str:
    """Text for a Markdown table."""
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")


def table(rows: tuple[Key, ...]) -> str:
    lines = ["| key | unit | default | paper | what it is | source |", "|---|---|---|---|---|---|"]
    for key in rows:
        code = [f"`{text}`" if text else "" for text in (key.path, key.default.replace("|", "\\|"), key.paper)]
        lines.append(f"| {code[0]} | {key.unit} | {code[1]} | {code[2]} | {cell(key.about)} | {cell(key.source)} |")
    return "\n".join(lines)


def option_list(group: str) -> str:
    """The options of a group: what each says of itself, and its file to unfold."""
    parts = []
    for option in options(group):
        file = CONF / group / f"{option}.yaml"
        body = "\n".join(f"    {line}".rstrip() for line in file.read_text().splitlines())
        title = title_of(file).replace('"', "'")
        title = title if title.startswith(f"{group}=") else f"{group}={option}: {title}"
        parts.append(f'??? note "{title.rstrip(".")}"\n\n    ```yaml\n{body}\n    ```\n')
    return "\n".join(parts)


def page() -> str:
    """The page, as Markdown."""
    parts, last = [INTRODUCTION], ""
    for section in sections():
        about = cell(section.about)
        if section.group == last and last:
            parts.append(f"### {section.title}")
        else:
            parts += [option_list(last)] if last else []
            parts.append(f"## {section.group or section.title}")
            about = f"{section.title}: {about}" if section.group else about
        last = section.group
        parts += [about, table(section.keys) if section.keys else ""]
    parts.append(option_list(last))
    for group in NO_KEYS:
        parts += [f"## {group}", option_list(group)]
    return "\n\n".join(part for part in parts if part) + "\n"


if __name__ == "__main__":
    print(page(), end="")
