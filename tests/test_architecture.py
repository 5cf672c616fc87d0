"""What may depend on what in the source, read from the files alone."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
COMPILERS = {"taichi", "quadrants"}


def imported(source: str) -> Iterator[str]:
    """Top-level packages that a file imports, anywhere in it, with `import` or `import_module`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield str(node.module).partition(".")[0]
        elif isinstance(node, ast.Call) and "import" in ast.unparse(node.func):
            yield from (str(name.value).partition(".")[0] for name in node.args if isinstance(name, ast.Constant))


def test_one_module_names_the_kernel_compiler() -> None:
    """All others have it as `from hoi.compute import ti`, so that they run with either."""
    folders = ("hoi", "analysis", "hydra_plugins", "scripts", "tests", "docs")
    files = {path for folder in folders for path in (ROOT / folder).rglob("*.py")}
    assert len(files) > 300
    named = {path for path in files if COMPILERS & set(imported(path.read_text()))}
    assert not named - {ROOT / "hoi" / "compute.py"}
