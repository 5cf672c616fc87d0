"""The opinion scores that `analysis.study score` wrote, as tables take them."""

from pathlib import Path

import pandas as pd

from hoi.errors import InputError

from .questions import QUESTIONS


def read_opinions(file: Path) -> pd.DataFrame:
    """A row an experiment and variant (empty for other systems): mean opinion scores q1 to q4, NaN where nobody rated.

    Raises:
        InputError: the file is not there, or no such table.
    """
    questions = [question.key for question in QUESTIONS]
    columns = ["experiment", "variant", *questions]
    try:
        scores = pd.read_csv(file, dtype={"experiment": str, "variant": str, **dict.fromkeys(questions, float)})
    except (OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: {' '.join(str(error).split())[:200]}") from error
    if missing := [name for name in columns if name not in scores]:
        raise InputError(f"{file} lacks the column {missing[0]}; must have {', '.join(columns)}")
    if scores.duplicated(["experiment", "variant"]).any():
        raise InputError(f"{file} has a variant twice")
    named = scores.loc[:, columns].fillna({"experiment": "", "variant": ""})
    return named.set_axis([name.lower() for name in columns], axis="columns")
