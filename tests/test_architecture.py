"""What may depend on what in the source, read from the files alone."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.conftest import ROOT, listed_slow

COMPILERS = {"taichi", "quadrants"}
ROOMS = """
    hoi errors streams callable adam caches
    data files compute gpu
    frames reports gaussians mpm
    terminal body objects gradient
    motion record
    importers video_prior render
    refine export view
    method
    stages training
    config
    plan
    runner
    run api live __main__ hydra_plugins
    analysis
"""
"""From the lowest to the highest: a room imports from the lines above its own only. A room is a folder or a module in
hoi/, `hoi` is hoi/__init__.py itself."""
EXCEPTIONS = {
    (
        "hoi.callable",
        "hoi.api",
    ): "`hoi.run` and `hoi.render` are rooms and, called, the functions of that name in the API"
}
"""(module, what it imports, inside a function only) -> why it may."""


class Import(NamedTuple):
    by: str
    """A module of ours."""
    of: str
    """What it names: a module where that is one of ours, else as written."""
    at_once: bool
    """Whether importing `by` does it; otherwise a function does when it is called."""


def statements(node: ast.AST, at_once: bool = True) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    """All imports in a tree but those for the type checker alone."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, at_once
        elif not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
            yield from statements(child, at_once and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef))


@cache
def modules() -> dict[str, Path]:
    """Name -> file, of the package and what builds on it."""
    files = (file for folder in ("hoi", "analysis", "hydra_plugins") for file in (ROOT / folder).rglob("*.py"))
    return {".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file for file in files}


@cache
def imports() -> tuple[Import, ...]:
    """All that they import, each once a module."""
    found: dict[Import, None] = {}
    for name, file in modules().items():
        for node, at_once in statements(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                package = name if file.name == "__init__.py" else name.rpartition(".")[0]
                base = resolve_name("." * node.level + (node.module or ""), package)
                parts = [f"{base}.{alias.name}" for alias in node.names]
                names = [part if part in modules() else base for part in parts]
            found |= dict.fromkeys(Import(name, of, at_once) for of in names)
    assert len(found) > 1000
    return tuple(found)


def room(module: str) -> str:
    first, *rest = module.split(".")
    return rest[0] if first == "hoi" and rest else first


def packages(source: str) -> Iterator[str]:
    """Top-level packages that a file imports, anywhere in it, with `import` or `import_module`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield str(node.module).partition(".")[0]
        elif isinstance(node, ast.Call) and "import" in ast.unparse(node.func):
            yield from (str(name.value).partition(".")[0] for name in node.args if isinstance(name, ast.Constant))


def loaded_by(code: str) -> set[str]:
    """Top-level packages that a fresh Python has loaded after `code` and not before."""
    program = (
        f"import sys\nbefore = set(sys.modules)\n{code}\nprint(*{{m.split('.')[0] for m in set(sys.modules) - before}})"
    )
    return set(
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    )


def test_one_module_names_the_kernel_compiler() -> None:
    """All others have it as `from hoi.compute import ti`, so that they run with either."""
    folders = ("hoi", "analysis", "hydra_plugins", "scripts", "tests", "docs")
    files = {path for folder in folders for path in (ROOT / folder).rglob("*.py")}
    assert len(files) > 300
    named = {path for path in files if COMPILERS & set(packages(path.read_text()))}
    assert not named - {ROOT / "hoi" / "compute.py"}


def test_every_room_has_its_place() -> None:
    assert sorted(ROOMS.split()) == sorted({room(module) for module in modules()})


def test_rooms_import_from_below_only() -> None:
    height = {name: number for number, line in enumerate(ROOMS.strip().splitlines()) for name in line.split()}
    ours = [each for each in imports() if each.of in modules() and room(each.by) != room(each.of)]
    upwards = [each for each in ours if height[room(each.of)] >= height[room(each.by)]]
    assert {(each.by, each.of) for each in upwards} == set(EXCEPTIONS)
    assert not any(each.at_once for each in upwards)


def test_modules_import_each_other_in_no_circle() -> None:
    graph: dict[str, set[str]] = {}
    for each in imports():
        if each.at_once and each.of in modules() and each.of != each.by:
            graph.setdefault(each.by, set()).add(each.of)
    TopologicalSorter(graph).prepare()  # CycleError names the modules


@pytest.mark.parametrize(
    ("importers", "never"),
    [
        ("hoi.method", {"hydra", "omegaconf", "hoi.record", "hoi.runner"}),
        ("hoi.stages", {"hydra", "hoi.runner"}),
        ("hoi.api", {"hydra", "omegaconf"}),
    ],
)
def test_the_method_knows_no_command_line(importers, never) -> None:
    """Nothing of what it imports is one of `never`, or in it."""
    ours = [each for each in imports() if f"{each.by}.".startswith(f"{importers}.")]
    assert ours
    assert not [each for each in ours for name in never if f"{each.of}.".startswith(f"{name}.")]


@pytest.mark.parametrize("alone", ["training", "gradient"])
def test_what_is_for_analysis_alone(alone) -> None:
    """A run needs nothing of it."""
    users = {room(each.by) for each in imports() if room(each.of) == alone}
    assert users == {alone, "analysis"}


def test_the_package_alone_loads_nothing() -> None:
    assert loaded_by("import hoi") <= {"hoi", *sys.stdlib_module_names}


def test_the_options_of_all_stages_load_nothing_heavy() -> None:
    loaded = loaded_by("import hoi.stages\nassert len(hoi.stages.options()) > 10")
    assert "hoi" in loaded
    assert not loaded & {"torch", *COMPILERS, "scipy", "mcap", "av", "transformers", "trimesh", "pandas", "matplotlib"}


def test_the_slow_tests_are_there() -> None:
    """`slow.txt` names no test that has been renamed."""
    for file, names in listed_slow().items():
        tree = ast.parse((ROOT / "tests" / file).read_text())
        assert names <= {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, file
