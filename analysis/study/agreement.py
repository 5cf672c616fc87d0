"""Krippendorff's alpha: how far raters agree beyond chance.

K. Krippendorff, "Computing Krippendorff's Alpha-Reliability", 2011. 1 is full agreement, 0 what chance
gives, below 0 worse than chance.
"""

import numpy as np

from hoi.data import Array

LEVELS = ("nominal", "ordinal", "interval")


def alpha(ratings: Array, level: str = "ordinal") -> float:
    """Krippendorff's alpha, 1 - D_o / D_e.

    Args:
        ratings: Shape (raters, units), NaN where a rater did not rate a unit.
        level: What the values are: names, ranks or lengths; see `LEVELS`.

    Returns:
        NaN where it is not defined: no unit with two ratings, or one and the same rating everywhere.

    Raises:
        ValueError: no such level.
    """
    if level not in LEVELS:
        raise ValueError(f"level {level!r}: allowed are {', '.join(LEVELS)}")
    values = np.unique(ratings[~np.isnan(ratings)])
    counts = (ratings[:, :, None] == values).sum(axis=0).astype(float)  # n_uc: how often unit u got value c
    counts = counts[counts.sum(axis=1) >= 2]
    # Coincidences o_ck: the pairs of ratings within each unit, each unit weighing as much as it has ratings.
    pairs = counts[:, :, None] * counts[:, None, :]
    pairs -= np.eye(len(values)) * counts[:, :, None]
    observed = (pairs / (counts.sum(axis=1) - 1)[:, None, None]).sum(axis=0)
    n = observed.sum(axis=1)
    expected = np.outer(n, n) - np.diag(n)
    squares = _squared_differences(values, n, level)
    if (expected * squares).sum() == 0:
        return float("nan")
    return float(1 - (n.sum() - 1) * (observed * squares).sum() / (expected * squares).sum())


def _squared_differences(values: Array, n: Array, level: str) -> Array:
    """delta^2_ck between values, shape (V, V); `n` is how often each value is in a pair."""
    if level == "nominal":
        return 1.0 - np.eye(len(values))
    if level == "interval":
        return (values[:, None] - values) ** 2
    rank = np.cumsum(n) - n / 2  # mid-ranks: the sum of n_g from c to k less (n_c + n_k) / 2 is their difference
    return (rank[:, None] - rank) ** 2
