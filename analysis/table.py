"""The table of a folder of runs, one row a variant: `python -m analysis.table runs [-o table.csv]`.

Mean over the variant's runs, n of them; an empty cell has no value in any of them. Failed runs are counted, not hidden.
"""

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.metrics import METRICS
from hoi.errors import InputError
from hoi.record import posed_points, read

KEYS = ["scene", "experiment", "variant"]


def collect(folder: Path) -> pd.DataFrame:
    """One row a record below `folder`.

    Raises:
        InputError: no record there, or one that cannot be read.
    """
    files = sorted([*folder.rglob("run.mcap"), *folder.rglob("run.failed.mcap")])
    if not files:
        raise InputError(f"{folder}: no run.mcap below it")
    rows = []
    for file in files:
        run = read(file)
        row: dict[str, object] = {key: (run.provenance | run.result)[key] for key in KEYS}
        row["failed"] = run.result["status"] != "done"
        if not row["failed"]:
            points, _ = posed_points(file)
            row |= {name: metric(run, points) for name, metric in METRICS.items()}
        rows.append(row)
    return pd.DataFrame(rows)


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean of each metric by variant, with n and the number of failed runs."""
    groups = runs.groupby(KEYS, sort=True)
    names = [name for name in METRICS if name in runs]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the mean of nothing is an empty cell
        means = groups[names].agg(lambda values: np.nanmean(values.astype(float)))
    return pd.concat([groups["failed"].agg(n="size", failed="sum"), means], axis=1).reset_index()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m analysis.table", description="The table of a folder of runs.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("runs"))
    parser.add_argument("-o", "--out", type=Path, help="also write it as CSV")
    arguments = parser.parse_args()
    try:
        table = summarise(collect(arguments.folder))
        if arguments.out:
            arguments.out.parent.mkdir(parents=True, exist_ok=True)
            table.to_csv(arguments.out, index=False)
    except (InputError, OSError) as error:
        print(f"analysis.table: {error}", file=sys.stderr)
        sys.exit(2)
    print(table.to_string(index=False, na_rep="", float_format=lambda value: f"{value:.3g}"))


if __name__ == "__main__":
    main()
