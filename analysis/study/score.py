"""Answers -> mean opinion scores with intervals, and how far the raters agree."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import t as student

from hoi.config.choices import Ablation
from hoi.data import Array
from hoi.errors import InputError
from hoi.files import whole_file

from ..writers import as_markdown, markdown_table, to_csv
from .agreement import alpha
from .answers import RATINGS, Key
from .questions import QUESTIONS, SCALE

CONFIDENCE = 0.95
METHOD = (
    "MOS: mean over raters of each rater's mean over the variant's videos. Interval: 95%, Student's t over the raters' "
    "means (n - 1 degrees of freedom), cut to the scale; with one rater there is none. Agreement: Krippendorff's alpha "
    "over all videos; 1 is agreement, 0 what chance gives."
)


def interval(means: Array) -> tuple[float, float, float]:
    """Mean and 95% confidence interval of raters' means, shape (R,), by Student's t; NaN limits where R is 1.

    Raters are the independent draws: the many ratings of one person are not, so they count as one mean.
    """
    mean, raters = float(np.mean(means)), len(means)
    if raters < 2:
        return mean, math.nan, math.nan
    half = float(student.ppf((1 + CONFIDENCE) / 2, raters - 1) * np.std(means, ddof=1) / math.sqrt(raters))
    return mean, max(mean - half, SCALE[0]), min(mean + half, SCALE[-1])


def opinion_scores(answers: pd.DataFrame, key: Key) -> pd.DataFrame:
    """One row an experiment and variant: raters, ratings, and of each question MOS, low and high (`Q1`, `Q1_low`, ...).

    Variants of the key that nobody rated stand there with empty cells.
    """
    rows = []
    groups = {(video["experiment"], video["variant"]) for video in key.videos.values()}
    for experiment, variant in sorted(groups, key=lambda group: (_place(group[1]), group)):
        names = [n for n, v in key.videos.items() if (v["experiment"], v["variant"]) == (experiment, variant)]
        own = answers.loc[answers["video"].isin(names)]
        means = own.groupby("rater")[list(RATINGS)].mean()
        row: dict[str, object] = {"experiment": experiment, "variant": variant, "videos": len(names)}
        row |= {"raters": len(means), "ratings": len(own)}
        for question in RATINGS:
            mos = interval(means[question].to_numpy(float)) if len(means) else (math.nan,) * 3
            row |= dict(zip((question, f"{question}_low", f"{question}_high"), mos, strict=True))
        rows.append(row)
    return pd.DataFrame(rows)


def rater_agreement(answers: pd.DataFrame) -> pd.DataFrame:
    """One row a question: Krippendorff's alpha for ranks and for lengths, raters and videos."""
    rows = []
    for question in QUESTIONS:
        ratings = answers.pivot(index="rater", columns="video", values=question.key).to_numpy(float)
        levels = {f"alpha_{level}": alpha(ratings, level) for level in ("ordinal", "interval")}
        sizes = {"raters": ratings.shape[0], "videos": ratings.shape[1]}
        rows.append({"question": question.key, "title": question.title} | levels | sizes)
    return pd.DataFrame(rows)


def to_markdown(scores: pd.DataFrame, agreement: pd.DataFrame) -> str:
    """Both tables, for people."""
    rows = [
        [
            *(_cell(row[name]) for name in ("experiment", "variant")),
            *(str(row[name]) for name in ("videos", "raters", "ratings")),
            *(_mos(row[q], row[f"{q}_low"], row[f"{q}_high"]) for q in RATINGS),
        ]
        for row in scores.to_dict("records")
    ]
    agreed = [
        [f"{row['question']} {row['title']}", *(_number(row[f"alpha_{level}"]) for level in ("ordinal", "interval"))]
        for row in agreement.to_dict("records")
    ]
    tables = [
        markdown_table(["experiment", "variant", "videos", "raters", "ratings", *RATINGS], *rows),
        markdown_table(["question", "alpha (ordinal)", "alpha (interval)"], *agreed),
    ]
    return "\n\n".join(["# User study", *tables, METHOD]) + "\n"


def write(scores: pd.DataFrame, agreement: pd.DataFrame, folder: Path) -> list[Path]:
    """`study.csv`, `study_agreement.csv` and `study.md` in `folder`, the same bytes for the same answers.

    Raises:
        InputError: they cannot be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror}") from error
    markdown = to_markdown(scores, agreement)
    texts = {"study.csv": to_csv(scores), "study_agreement.csv": to_csv(agreement), "study.md": markdown}
    for name, text in texts.items():
        with whole_file(folder / name) as part:
            part.write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def _place(variant: str) -> tuple[int, int, str]:
    """Ours first, in the paper's order, then what leaves out several, then other systems by name."""
    known = [ablation.value for ablation in Ablation]
    parts = variant.split("+")
    if not all(part in known for part in parts):
        return len(known) + 1, 0, variant
    return (known.index(variant), 0, "") if len(parts) == 1 else (len(known), len(parts), variant)


def _cell(name: object) -> str:
    """A name that is neither Markdown nor HTML."""
    return as_markdown(" ".join(str(name).split()), "\\`*[]|!")


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _mos(mean: float, low: float, high: float) -> str:
    return _number(mean) if math.isnan(low) else f"{mean:.2f} [{low:.2f}, {high:.2f}]"
