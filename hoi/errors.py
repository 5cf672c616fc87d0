"""The ways a run, or a stage that it can do without, ends early.

Whoever finds a value wrong names the field alone, whoever opened the config for it adds the key:

    with under("stage.motion", "start_time", "up"):
        read_motion(path, body, frames, fps, start_time=conf.start_time)  # start_time must be in [0, 2] s, got 3
    # stage.motion.start_time must be in [0, 2] s, got 3
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager

PROPOSED = re.compile(r"(; |say |set )(?=[a-z_.]+=)")
"""What stands before a field to which a line proposes another value: `; checkpoint=null takes the one ...`."""


class InputError(ValueError):
    """What the user gave is wrong: one line with the field or file, the value and what is allowed. Exit code 2.

    Args:
        said: the whole line, or the field where the other two are given.
        value, rule: read as `FIELD must be RULE, got VALUE`.
    """

    has_subject = False
    """Whether the line says what file or thing it is about (see `about`): `under` leaves it as it is."""

    def __init__(self, said: object, value: object = None, rule: str | None = None) -> None:
        super().__init__(str(said) if rule is None else f"{said} must be {rule}, got {value}")


class RunError(RuntimeError):
    """The run itself failed (diverged, left the domain, out of memory): one line with the remedy. Exit code 3."""


class RefineStopped(RuntimeError):
    """Stage 3 cannot go on (something not finite, no memory): one line. The run goes on with the motion it had."""


@contextmanager
def under(key: str, *fields: str) -> Iterator[None]:
    """Puts `KEY.` before the field with which an `InputError` from inside begins, and before those that it proposes.

    Args:
        fields: which ones are the key's, where files are read inside too; none: whatever is said is.
    """
    try:
        yield
    except InputError as error:
        line = str(error)
        if fields:
            line = re.sub(rf"(such as )(?=({'|'.join(fields)})=)", rf"\1{key}.", line)
            error.args = (line,)
        if not error.has_subject and (not fields or re.match(rf"({'|'.join(fields)})[ :=,]", line)):
            error.args = (f"{key}." + PROPOSED.sub(rf"\1{key}.", line),)
        raise


@contextmanager
def about(subject: object) -> Iterator[None]:
    """Puts `SUBJECT: ` before the line of an `InputError` from inside: a file or part, and no field."""
    try:
        yield
    except InputError as error:
        error.args = (f"{subject}: {error}",)
        error.has_subject = True
        raise
