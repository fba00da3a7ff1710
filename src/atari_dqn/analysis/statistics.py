"""Summaries of scores, with intervals."""

import numpy as np
import pandas as pd
from scipy import stats

# Games of training, after each of which the source report gives scores
MILESTONES = (500, 1000, 1500, 2000, 2500, 3000)


def trailing_mean(scores: pd.Series, window: int) -> pd.Series:
    """Mean of the last `window` scores at every game, from the `window`-th game on."""
    return scores.rolling(window).mean()


def interval(values: np.ndarray) -> tuple[float, float]:
    """95% bootstrap interval of the mean (percentile method, 9,999 resamples).

    Raises ValueError for fewer than two values, from which nothing can be resampled.
    """
    if len(values) < 2:
        raise ValueError("an interval needs at least two values")
    result = stats.bootstrap(
        (np.asarray(values, float),),
        np.mean,
        confidence_level=0.95,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = result.confidence_interval
    return float(low), float(high)


BLOCK = 50  # training games; an agent changes little within them


def blocks(scores: np.ndarray) -> np.ndarray:
    """Means of successive blocks of training games, float64 [games // BLOCK].

    Successive games resemble one another: an interval over them as if they were independent would
    be far too narrow. Games that fill no block are left out, the oldest first.
    """
    whole = len(scores) // BLOCK * BLOCK
    return np.asarray(scores, float)[len(scores) - whole :].reshape(-1, BLOCK).mean(axis=1)


def with_interval(values: np.ndarray) -> str:
    """Mean and bootstrap interval as text: "12.0 (10.1 to 13.9)"; one value goes without."""
    mean = f"{np.mean(values):.1f}"
    if len(values) < 2:
        return mean
    low, high = interval(values)
    return f"{mean} ({low:.1f} to {high:.1f})"


def student_interval(values: np.ndarray, distinct: int | None = None) -> tuple[float, float]:
    """95% interval of the mean (Student's t); two values at the least.

    `distinct` is how many of the values count, if some repeat others; by default all.
    """
    if len(values) < 2:
        raise ValueError("an interval needs at least two values")
    number = distinct or len(values)
    half = np.std(values, ddof=1) / np.sqrt(number) * stats.t.ppf(0.975, max(number - 1, 1))
    return float(np.mean(values) - half), float(np.mean(values) + half)


def series_interval(values: np.ndarray) -> tuple[float, float]:
    """95% interval of the mean of values in their order of time (Student's t).

    What counts as noise is how far the values lie from a straight line through them: a difference
    that grows is no reason for doubt. Neighbours that resemble one another count for less: the
    variance grows by (1 + r) / (1 - r), where r is the first autocorrelation of that noise, if it
    is above zero, corrected for its bias in short series. (Simulated with ten values, the interval
    covers the mean in 97% of cases if they are independent, in 86% at r = 0.5, in 75% at 0.7.)
    Raises ValueError for fewer than three values.
    """
    values, number = np.asarray(values, float), len(values)
    if number < 3:
        raise ValueError("an interval about a line needs at least three values")
    times = np.arange(number)
    noise = values - np.polynomial.Polynomial.fit(times, values, 1)(times)
    power = float(noise @ noise)
    r = float(noise[1:] @ noise[:-1]) / power if power else 0.0
    if number > 4:
        r = (number * r + 2) / (number - 4)
    r = min(max(r, 0.0), 1 - 2 / number)
    error = np.sqrt(power / (number - 2) / number * (1 + r) / (1 - r))
    half = float(stats.t.ppf(0.975, number - 2) * error)
    return float(values.mean()) - half, float(values.mean()) + half


def welch_interval(
    first: np.ndarray, second: np.ndarray, distinct: tuple[int, int] | None = None
) -> tuple[float, float]:
    """95% interval of the difference of two independent means (Welch's t).

    `distinct` is how many values of each side count, if some repeat others; by default all.
    Raises ValueError if either has fewer than two values.
    """
    if min(len(first), len(second)) < 2:
        raise ValueError("a difference needs at least two values on each side")
    gap = float(np.mean(first) - np.mean(second))
    numbers = np.array(distinct or (len(first), len(second)))
    errors = np.array([np.var(first, ddof=1), np.var(second, ddof=1)]) / numbers  # squared
    if not errors.any():
        return gap, gap
    freedom = errors.sum() ** 2 / (errors**2 / np.maximum(numbers - 1, 1)).sum()
    half = float(stats.t.ppf(0.975, freedom) * np.sqrt(errors.sum()))
    return gap - half, gap + half


def scores_at_milestones(
    episodes: pd.DataFrame, milestones: tuple[int, ...], window: int
) -> pd.DataFrame:
    """Mean score of the `window` games up to each milestone, a row an agent and seed.

    A milestone that a run has not reached is missing (nan).
    """
    rows = {}
    for key, games in episodes.groupby(["agent", "seed"], sort=False):
        scores = games.set_index("episode").score
        rows[key] = [
            scores.loc[max(1, last - window + 1) : last].mean() if last in scores.index else np.nan
            for last in milestones
        ]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=list(milestones))
    table.index = pd.MultiIndex.from_tuples(table.index, names=["agent", "seed"])
    return table
