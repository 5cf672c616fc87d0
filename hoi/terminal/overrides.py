"""KEY=VALUE in Hydra's grammar, of values that mean themselves."""

import re

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException

OURS = re.compile(r"\$\{(?!(seed|scene|object|human|material|experiment|ablation|now|hydra|oc)\b[\w.:%-]*\})")
"""The start of an interpolation of nothing that a config has."""


def quoted(text: str) -> str:
    """The text as a value of Hydra's that means itself."""
    text = " ".join(text.splitlines())
    return QuotedString(OURS.sub(lambda found: "\\" + found[0], text), Quote.single).with_quotes()


def as_override(key: str, value: object) -> str:
    """KEY=VALUE with a text that means itself, in Hydra's grammar; quoted for it only where need be."""
    plain = f"{key}={value}"
    read = read_override(plain)
    same = read is not None and not read.is_sweep_override() and read.value() == str(value)
    return plain if same and "${" not in plain else f"{key}={quoted(str(value))}"


def read_override(word: str) -> Override | None:
    """What Hydra's grammar makes of it; None where it is no sentence of that."""
    try:
        return OverridesParser.create().parse_override(word)
    except HydraException:
        return None
