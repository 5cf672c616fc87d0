"""The config of a command line, composed in this process, whatever else in it uses Hydra."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.core.utils import JobRuntime
from hydra.errors import HydraException
from hydra.version import VersionBase
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, Config, register
from hoi.config.validate import to_config
from hoi.errors import InputError


def composed(*overrides: str, with_hydra: bool = False) -> DictConfig:
    """What `python -m hoi.run OVERRIDES` starts from, not checked yet; nothing global is left behind.

    Args:
        with_hydra: with the part that is Hydra's own, under "hydra".

    Raises:
        HydraException, OmegaConfBaseException: a bad override; see `one_line`.
    """
    with _own_hydra():
        register()
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return compose("config", list(overrides), return_hydra_config=with_hydra)


def config_of(*overrides: str) -> Config:
    """The config of a command line, checked.

    Raises:
        InputError: a bad override, or one of the problems that `hoi.config.validate.to_config` finds.
    """
    try:
        return to_config(composed(*overrides))
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(one_line(error)) from error


def one_line(error: BaseException) -> str:
    """Hydra's and OmegaConf's messages without their stack of context lines."""
    message = str(error).partition("Config search path")[0]
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    cause = error.__cause__ or error.__context__
    if isinstance(error, HydraException) and isinstance(cause, OmegaConfBaseException):
        return one_line(cause)
    key = getattr(error, "full_key", None)
    text = " ".join(line for line in lines if not line.startswith(("full_key:", "object_type=", "reference_type=")))
    return f"{key}: {text}" if key and key not in text else text


@contextmanager
def _own_hydra() -> Iterator[None]:
    """Hydra as if nobody had used it yet, but for its plugins; afterwards as it was before."""
    ours, instances, groups = (GlobalHydra, JobRuntime, VersionBase), Singleton._instances, ConfigStore.instance().repo
    before: dict[Any, Any] = {kind: instances.pop(kind) for kind in ours if kind in instances}
    schema = groups.pop("schema", None)
    try:
        yield
    finally:
        for kind in ours:
            instances.pop(kind, None)
        instances.update(before)
        groups.pop("schema", None)
        if schema is not None:
            groups["schema"] = schema
