"""The metrics as a table for docs/benchmark.md: `python -m analysis.metrics`."""

from hoi.terminal.program import program

from . import GROUPS, METRICS


def table() -> str:
    """Name, unit, direction and definition of each, by topic, in Markdown."""
    parts = []
    for group in GROUPS:
        rows = ["| column | heading | unit | better | what it is |", "|---|---|---|---|---|"]
        for metric in METRICS.values():
            if metric.group == group:
                cells = (f"`{metric.key}`", metric.title, metric.unit, metric.better, metric.definition)
                rows.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        parts.append("\n".join([f"### {group}", "", *rows, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    program(lambda: print(table(), end=""))
