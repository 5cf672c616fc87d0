"""What was typed after `hoi run`, as Hydra reads it: sentences and paths quoted, flags before overrides.

Hydra reads a value by a grammar in which an apostrophe, a comma, a bracket or a letter with an accent mean something or
nothing. A sentence and a path mean themselves.
"""

import os
import re
from collections.abc import Iterable
from difflib import get_close_matches

from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.types import Sweep

from hoi.errors import InputError
from hoi.files import CONF
from hoi.terminal.overrides import as_override, quoted, read_override

SENTENCE = "scene.motion_prompt"
PROMPTS = (SENTENCE, "scene.scene_prompt", "scene.negative_prompt")
TEXTS = re.compile(r"out|(.*\.)?(path|skinning|checkpoint|names|name)")
"""Keys of paths and names."""
OVERRIDE = re.compile(r"(?s)(?P<key>(\+\+|\+|~)?[\w./@:$-]+)=(?P<value>.*)")
DELETION = re.compile(r"~[\w./@:$-]+")
ALONE = ("--run", "--multirun", "--cfg", "--info", "--shell-completion")
"""Flags of which there can be one."""


def arguments(typed: Iterable[str]) -> list[str]:
    """The command line for Hydra.

    Raises:
        InputError: two sentences, text that is none, or flags that do not go together.
    """
    words = [_text(word) for word in typed]
    flags, rest = _apart(words)
    many = bool({"--multirun"} & {name for name, _ in flags})
    sentences = [word for word in rest if not (OVERRIDE.fullmatch(word) or DELETION.fullmatch(word))]
    if len(sentences) > 1:
        raise InputError(
            f"two sentences: {sentences[0]!r} and {sentences[1]!r}; one is allowed, and the rest KEY=VALUE"
        )
    made = []
    for word in rest:
        if word in sentences:
            if any(other.startswith(f"{SENTENCE}=") for other in rest):
                raise InputError(f"two sentences: {word!r} and that of {SENTENCE}; one is allowed")
            made.append(as_override(SENTENCE, _sentence(word)))
        else:
            made.append(_override(word, many))
    return [part for _, parts in flags for part in parts] + made


def _sentence(word: str) -> str:
    if not word.strip():
        raise InputError(f"{SENTENCE} is empty; say what the person does")
    return word


def _text(word: str) -> str:
    """The word as it was typed, whatever the locale says of its bytes."""
    try:
        word.encode()
        return word
    except UnicodeEncodeError:
        pass
    try:
        return os.fsencode(word).decode()
    except (UnicodeDecodeError, UnicodeEncodeError):
        shown = word.encode(errors="backslashreplace").decode()
        raise InputError(f"{shown}: holds bytes that are no text in UTF-8") from None


def _override(word: str, many: bool) -> str:
    """The override with its value quoted, where it is a text, or nothing that Hydra could read."""
    found = OVERRIDE.fullmatch(word)
    if found is None:
        return word
    key, value = found["key"], found["value"]
    name = key.lstrip("+~")
    if name == SENTENCE and not key.startswith("~"):
        _sentence(value)
    read = read_override(word)
    if read is not None and (CONF / name).is_dir() and not isinstance(read.value(), str | list | Sweep):
        raise InputError(name, value, f"one of {', '.join(sorted(file.stem for file in (CONF / name).glob('*.yaml')))}")
    if name in PROMPTS or (TEXTS.fullmatch(name) and value not in ("", "null")):
        if _is_quoted(value) or (many and read is not None):
            return word
        return as_override(key, value)
    return word if read is not None or value[:1] in ("[", "{") else f"{key}={quoted(value)}"


def _is_quoted(value: str) -> bool:
    return re.fullmatch(r"'(\\'|[^'])*'|\"(\\\"|[^\"])*\"", value) is not None


def _apart(words: list[str]) -> tuple[list[tuple[str, list[str]]], list[str]]:
    """Hydra's flags, each with its name and its words, and the rest; Hydra wants them apart.

    Raises:
        InputError: a flag that Hydra has not, or two that do not go together.
    """
    known = get_args_parser()._option_string_actions
    flags, rest, left = [], [], list(words)
    while left:
        word = left.pop(0)
        name, equals, _ = word.partition("=")
        action = known.get(name) if word.startswith("-") else None
        if action is None:
            if re.fullmatch(r"--?[A-Za-z][\w-]*(=.*)?", word):
                near = get_close_matches(name, known, 1, cutoff=0)[0]
                raise InputError(f"no option {name}; the nearest is {near} (hoi run --help)")
            rest.append(word)
            continue
        parts = [word]
        wanted = action.nargs is None or (action.nargs == "?" and left[:1] and left[0] in (action.choices or ()))
        if wanted and not equals and left:
            parts.append(left.pop(0))
        flags.append((max(action.option_strings, key=len), parts))
    names = {name for name, _ in flags}
    if "--resolve" in names and not names & {"--cfg", "--help"}:
        raise InputError("--resolve goes with --cfg job, which prints the config; nothing is printed without it")
    if len(clash := [name for name in ALONE if name in names]) > 1:
        raise InputError(f"{' and '.join(clash)} do not go together; choose one")
    return flags, rest
