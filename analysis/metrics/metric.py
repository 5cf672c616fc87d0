"""What a metric is."""

from collections.abc import Callable
from dataclasses import dataclass

from ..records import Record

NAN = float("nan")


@dataclass(frozen=True)
class Metric:
    """One number of a run."""

    key: str
    """Its column in runs.csv."""
    title: str
    """Its heading in tables."""
    unit: str
    """"-" for what has none."""
    better: str
    """"lower", "higher", or "" where neither is."""
    function: Callable[[Record], float]
    """NaN where the run does not define it: no contact, no flight, no person."""
    group: str = ""
    """The table it stands in."""

    @property
    def heading(self) -> str:
        """Title, unit and the direction of better."""
        arrow = {"lower": " ↓", "higher": " ↑", "": ""}[self.better]
        unit = "" if self.unit == "-" else f" [{self.unit}]"
        return f"{self.title}{unit}{arrow}"

    @property
    def definition(self) -> str:
        """What it measures and how, from its function."""
        return " ".join((self.function.__doc__ or "").split())
