"""What studies leave behind: where and with what they measured, and their tables as text and files."""

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from hoi.compute import compiler
from hoi.runner.provenance import git_state

if TYPE_CHECKING:
    import pandas as pd


def facts(threads: int) -> dict[str, str]:
    """Where and with what the times were measured."""
    return {
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.system()}",
        "threads": str(threads),
        "python": platform.python_version(),
        **{name: version(name) for name in ("hoi", compiler(), "numpy")},
        "commit": git_state() or "not a checkout",
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def write(
    folder: Path, name: str, table: "pd.DataFrame", noted: dict[str, str], text: str, draw: Callable[[Path], object]
) -> list[Path]:
    """`name`.csv with what is noted in every row, .md and .png, in `folder`, which is made when it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.{ending}" for ending in ("csv", "md", "png")]
    table.assign(**noted).to_csv(paths[0], index=False)
    paths[1].write_text(text, encoding="utf-8")
    draw(paths[2])
    return paths


def markdown(parts: Sequence[str]) -> str:
    """A text of these paragraphs."""
    return "\n\n".join(parts) + "\n"


def markdown_table(rows: Sequence[Mapping[str, object]], heads: Sequence[str] = ()) -> str:
    """A Markdown table, its columns aligned; numbers with three digits.

    Args:
        rows: heading -> cell, alike. heads: the headings, where there may be no row.
    """
    lines = [list(heads or rows[0])]
    lines += [[f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)) + " |" for line in lines]
    return "\n".join([text[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *text[1:]])


def markdown_list(values: Mapping[str, object]) -> str:
    return "\n".join(f"- {name}: {value}" for name, value in values.items())


def plain(table: "pd.DataFrame", digits: int = 2, na_rep: str = "NaN") -> str:
    """The table as a terminal shows it, so many digits behind the point."""
    return table.to_string(index=False, na_rep=na_rep, float_format=lambda value: f"{value:.{digits}f}")
