"""The ways a run, or a stage that it can do without, ends early."""


class InputError(ValueError):
    """What the user gave is wrong: one line with the field or file, the value and what is allowed. Exit code 2."""


class RunError(RuntimeError):
    """The run itself failed (diverged, left the domain, out of memory): one line with the remedy. Exit code 3."""


class RefineStopped(RuntimeError):
    """Stage 3 cannot go on (something not finite, no memory): one line. The run goes on with the motion it had."""
