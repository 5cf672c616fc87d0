"""The two ways a run ends early, each with its exit code."""


class InputError(ValueError):
    """What the user gave is wrong: one line with the field or file, the value and what is allowed. Exit code 2."""


class RunError(RuntimeError):
    """The run itself failed (diverged, left the domain, out of memory): one line with the remedy. Exit code 3."""
