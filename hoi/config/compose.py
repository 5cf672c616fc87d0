"""The config of a command line, composed in this process, whatever else in it uses Hydra."""

import re
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any, get_args

import hydra
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.core.utils import JobRuntime
from hydra.errors import HydraException
from hydra.version import VersionBase
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, Config, register
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.stages import options


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
    """Hydra's and OmegaConf's messages without their stack of context, and with the nearest name that there is."""
    message = str(error).partition("Config search path")[0]
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    cause = error.__cause__ or error.__context__
    if isinstance(error, HydraException) and isinstance(cause, OmegaConfBaseException):
        return one_line(cause)
    key = getattr(error, "full_key", None)
    text = " ".join(line for line in lines if not line.startswith(("full_key:", "object_type=", "reference_type=")))
    text = LINK.sub(f"hydra.cc/docs/{'.'.join(hydra.__version__.split('.')[:2])}", text)
    text = GRAMMAR.sub("cannot be read: ", text)
    text = f"{key}: {text}" if key and key not in text else text
    return text + _nearest(text)


LINK = re.compile(r"hydra\.cc/docs/\d+\.\d+")
GRAMMAR = re.compile(r"^Lexer\w+Exception: ")
UNKNOWN = (
    re.compile(r"^(?P<key>[\w.]+): Key '(?P<word>[^']+)' not in '(?P<schema>\w+)'"),
    re.compile(r"^Key '(?P<word>[^']+)' not in '(?P<schema>\w+)'"),
    re.compile(r"Could not find '(?P<group>[\w/]+)/(?P<word>[^'/]+)' Available options in '[^']*': (?P<known>.*)"),
    re.compile(r"Could not override '(?P<word>[^'@]+)(@[^']*)?'"),
)
"""What Hydra and OmegaConf say of names that are not there."""


def _nearest(text: str) -> str:
    """The name that may have been meant."""
    for found in filter(None, (pattern.search(text) for pattern in UNKNOWN)):
        word, groups = found["word"], found.groupdict()
        if groups.get("known"):
            known, before = groups["known"].split(), f"{groups['group']}="
        else:
            known, before = known_keys(), ""
            word = groups.get("key") or word
        near = get_close_matches(word, known, 1, cutoff=0.5)
        return f"; the nearest is {before}{near[0]}" if near else ""
    return ""


def known_keys() -> list[str]:
    """Every key that some config has, dotted, and every group."""

    def below(schema: type, prefix: str) -> Iterator[str]:
        for each in fields(schema):
            yield f"{prefix}{each.name}"
            inner = [part for part in (each.type, *get_args(each.type)) if is_dataclass(part)]
            for part in inner:
                yield from below(part, f"{prefix}{each.name}.")  # pyright: ignore[reportArgumentType]

    keys = list(below(Config, ""))
    for (group, _), option in options().items():
        keys += below(option, f"{group.replace('/', '.')}.")
    groups = [str(path.relative_to(CONF)) for path in CONF.rglob("[!.]*/") if "hydra" not in path.parts[-2:]]
    return sorted({*keys, *groups})


def raised_by_hydra(error: BaseException) -> bool:
    """Whether it comes from Hydra's own code: what it could not make sense of was typed."""
    innermost = traceback.extract_tb(error.__traceback__)[-1:]
    return any(f"/{name}/" in frame.filename for frame in innermost for name in ("hydra", "omegaconf"))


def settled(composed: DictConfig) -> DictConfig:
    """The same with the values of resolvers, such as ${now:%H} and ${hydra:job.num}, in their places.

    They mean something here and now, and are gone in another process; interpolations of keys stay.

    Raises:
        InputError: one that cannot be resolved.
    """
    values: Any = OmegaConf.to_container(composed, resolve=False)
    texts = [("", key, value) for key, value in values.items()]
    settled = composed.copy()
    while texts:
        above, key, value = texts.pop()
        name = f"{above}{key}"
        if isinstance(value, dict):
            texts += [(f"{name}.", inner, part) for inner, part in value.items()]
        elif isinstance(value, str) and RESOLVER.search(value):
            try:
                text = RESOLVER.sub(lambda found: str(OmegaConf.create({"it": found[0]}).it), value)
            except OmegaConfBaseException as error:
                raise InputError(f"{name}: {value} cannot be resolved: {str(error).splitlines()[0]}") from error
            OmegaConf.update(settled, name, text)
    return settled


RESOLVER = re.compile(r"(?<!\\)\$\{[\w.]+:[^{}]*\}")


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
