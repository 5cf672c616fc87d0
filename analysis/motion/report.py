"""What a study of motions leaves behind: motion.csv, strikes.csv and motion.md."""

import argparse
from pathlib import Path

import pandas as pd

from .. import sheets


def write(folder: Path, table: pd.DataFrame, strikes: pd.DataFrame, options: argparse.Namespace) -> list[Path]:
    """The three files, in `folder`, which is made when it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    noted = sheets.facts(options.threads) | {"seed": str(options.seed)}
    paths = [folder / name for name in ("motion.csv", "strikes.csv", "motion.md")]
    table.assign(**noted).to_csv(paths[0], index=False)
    strikes.assign(**noted).to_csv(paths[1], index=False)
    parts = ["# Motion priors against real clips", sheets.markdown_list(noted)]
    for title, shown in (("Held-out sentences", table), ("Strikes", _side_by_side(strikes))):
        parts += [f"## {title}", sheets.markdown_table(shown.to_dict("records"))]
    paths[2].write_text(sheets.markdown(parts), encoding="utf-8")
    return paths


def _side_by_side(strikes: pd.DataFrame) -> pd.DataFrame:
    """One row a strike: for each source the share with the named limb, the speed with its range, the skating."""
    cells = strikes.assign(
        cell=[
            f"{row['named limb']:.0%}, {row['speed [m/s]']:.1f} ({row['10 %']:.1f} to {row['90 %']:.1f}) m/s,"
            f" {row['skating [m/s]']:.2f}"
            for row in strikes.to_dict("records")
        ]
    )
    wide = cells.pivot(index="strike", columns="motions", values="cell")
    wide = wide.loc[strikes["strike"].unique(), strikes["motions"].unique()]
    return wide.reset_index()
