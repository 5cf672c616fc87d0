"""Shared fixtures: composed configs, and the optional folder of reference data beside the project."""

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig

from hoi.config.compose import composed

ROOT = Path(__file__).parents[1]


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
