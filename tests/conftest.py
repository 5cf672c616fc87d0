"""Which tests are slow, and shared fixtures: composed configs, and the optional folder of data beside the project."""

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig

from hoi.config.compose import composed

ROOT = Path(__file__).parents[1]
SLOW = Path(__file__).with_name("slow.txt")


def listed_slow() -> dict[str, set[str]]:
    """File -> the tests in it that `slow.txt` names; none where it names the file alone, which means all."""
    lines = [line.partition(":") for line in SLOW.read_text().splitlines() if line and not line.startswith("#")]
    return {file: set(names.split()) for file, _, names in lines}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Function]) -> None:
    """Marks the slow ones, before `-m` looks at the marks."""
    slow = listed_slow()
    for item in items:
        names = slow.get(item.path.relative_to(SLOW.parent).as_posix())
        if names is not None and (not names or item.originalname in names):
            item.add_marker("slow")


@pytest.fixture(name="composed")
def composed_fixture() -> Callable[..., DictConfig]:
    """compose(*overrides) -> the config that the command line would give."""
    return composed


@pytest.fixture
def shared_objects() -> Path:
    """Captured 3DGS objects, where they are at hand."""
    folder = ROOT.parent / "shared" / "data" / "objects"
    if not folder.is_dir():
        pytest.skip("the captured objects are not beside this checkout")
    return folder
