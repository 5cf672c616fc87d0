"""Shared fixtures: composed configs, and the optional folder of reference data beside the project."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from hoi.config import CONF, register

ROOT = Path(__file__).parents[1]


@pytest.fixture
def composed() -> Callable[..., DictConfig]:
    """compose(*overrides) -> the config that the command line would give."""

    def compose_with(*overrides: str) -> DictConfig:
        register()
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return compose("config", list(overrides))

    return compose_with


@pytest.fixture
def shared_objects() -> Path:
    """Captured 3DGS objects, where they are at hand."""
    folder = ROOT.parent / "shared" / "data" / "objects"
    if not folder.is_dir():
        pytest.skip("the captured objects are not beside this checkout")
    return folder
