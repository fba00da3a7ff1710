"""Summaries of scores, with intervals."""

from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy import stats

# Training episodes, after each of which the source report gives scores
MILESTONES = (500, 1000, 1500, 2000, 2500, 3000)


def trailing_mean(scores: pd.Series, window: int) -> pd.Series:
    """Mean of the last `window` scores at every episode, from the `window`-th on."""
    return scores.rolling(window).mean()


def stratified_interval(
    statistic: Callable[..., np.ndarray], *groups: np.ndarray
) -> tuple[float, float]:
    """95% bootstrap interval of `statistic(*groups, axis)`, where each group is resampled by itself
    (Agarwal et al., 2021): seeds of one agent in one game are never drawn for another's.

    With three values per group such an interval is too narrow; `welch_interval` is not.
    """
    result = stats.bootstrap(
        groups,
        statistic,
        vectorized=True,
        confidence_level=0.95,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = result.confidence_interval
    return float(low), float(high)


def iqm(*groups: np.ndarray, axis: int = -1) -> np.ndarray:
    """Interquartile mean: the mean of the middle half of all values (Agarwal et al., 2021)."""
    return np.asarray(stats.trim_mean(np.concatenate(groups, axis), 0.25, axis))


def probability_of_improvement(one: np.ndarray, other: np.ndarray, axis: int = -1) -> np.ndarray:
    """How often a value of the first group is above one of the second; a tie counts half."""
    one, other = (np.moveaxis(np.asarray(values), axis, -1) for values in (one, other))
    gaps = one[..., :, None] - other[..., None, :]
    return np.mean(gaps > 0, (-2, -1)) + np.mean(gaps == 0, (-2, -1)) / 2


BLOCK = 50  # training episodes; an agent changes little within them


def blocks(scores: np.ndarray) -> np.ndarray:
    """Means of successive blocks of training episodes, float64 [..., episodes // BLOCK].

    Successive episodes resemble one another: an interval over them as if they were independent
    would be far too narrow. Episodes that fill no block are left out, the oldest first.
    """
    scores = np.asarray(scores, float)
    count = scores.shape[-1] // BLOCK
    whole = scores[..., scores.shape[-1] - count * BLOCK :]
    return whole.reshape(*scores.shape[:-1], count, BLOCK).mean(axis=-1)


def by_cluster(values: np.ndarray, clusters: np.ndarray) -> np.ndarray:
    """A value per cluster, such that their mean is that of all `values`, and the interval of their
    mean is right though values of one cluster resemble one another: the cluster's own mean, its
    distance from the mean of all weighted by how many values it has."""
    frame = pd.DataFrame({"value": np.asarray(values, float), "cluster": clusters})
    found = frame.groupby("cluster").value.agg(["mean", "size"])
    overall = frame.value.mean()
    return np.asarray(overall + (found["mean"] - overall) * found["size"] / found["size"].mean())


def cluster_interval(values: np.ndarray, clusters: np.ndarray) -> tuple[float, float]:
    """95% interval of the mean of values of which those of one cluster resemble one another
    (Student's t over `by_cluster`). Raises ValueError for a single cluster."""
    return student_interval(by_cluster(values, clusters))


def student_interval(values: np.ndarray) -> tuple[float, float]:
    """95% interval of the mean (Student's t); two values at the least."""
    if len(values) < 2:
        raise ValueError("an interval needs at least two values")
    half = np.std(values, ddof=1) / np.sqrt(len(values)) * stats.t.ppf(0.975, len(values) - 1)
    return float(np.mean(values) - half), float(np.mean(values) + half)


def series_interval(values: np.ndarray) -> tuple[float, float]:
    """95% interval of the mean of values in their order of time (Student's t).

    What counts as noise is how far the values lie from a straight line through them: a difference
    that grows is no reason for doubt. Neighbours that resemble one another count for less: n values
    are worth n (1 - r) / (1 + r) independent ones, in the standard error and in the degrees of
    freedom, which are two at the least. Here r is the first autocorrelation, raised by half its
    standard error, because few values show too little of it. Simulated (`coverage`), the interval
    of ten values holds the mean in 97% of cases if they are independent, in 90% at r = 0.5, in 86%
    at 0.7 and in 71% at 0.9; that of sixty values in 97%, 94%, 94% and 91%.
    Raises ValueError for fewer than three values.
    """
    values, number = np.asarray(values, float), len(values)
    noise = _noise(values)
    r = min(max(_autocorrelation(noise) + 0.5 / np.sqrt(number), 0.0), 1 - 2 / number)
    worth = number * (1 - r) / (1 + r)
    error = np.sqrt(noise @ noise / (number - 2) / worth)
    freedom = min(max(worth - 1, 2), number - 2)
    half = float(stats.t.ppf(0.975, freedom) * error)
    return float(values.mean()) - half, float(values.mean()) + half


def likeness(values: np.ndarray) -> float:
    """How much neighbours in a series resemble one another: the first autocorrelation of what lies
    off a straight line through them, from 0 to 1 - 2 / n.

    Raises ValueError for fewer than three values.
    """
    r = _autocorrelation(_noise(np.asarray(values, float)))
    return min(max(r, 0.0), 1 - 2 / len(values))


def coverage(r: float, number: int) -> float:
    """How often `series_interval` holds the true mean of `number` values whose neighbours resemble
    one another by `r`, simulated with 1,000 series."""
    shocks = np.random.default_rng(0).normal(size=(number, 1000))
    series = [shocks[0]]
    for shock in shocks[1:]:
        series.append(r * series[-1] + np.sqrt(1 - r**2) * shock)
    found = (series_interval(values) for values in np.transpose(series))
    return float(np.mean([low < 0 < high for low, high in found]))


def _autocorrelation(noise: np.ndarray) -> float:
    """Of neighbours, corrected for its bias in short series."""
    power, number = float(noise @ noise), len(noise)
    r = float(noise[1:] @ noise[:-1]) / power if power else 0.0
    return (number * r + 2) / (number - 4) if number > 4 else r


def _noise(values: np.ndarray) -> np.ndarray:
    """How far values lie from a straight line through them."""
    if len(values) < 3:
        raise ValueError("an interval about a line needs at least three values")
    times = np.arange(len(values))
    return values - np.polynomial.Polynomial.fit(times, values, 1)(times)


def welch_interval(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """95% interval of the difference of two independent means (Welch's t).

    Raises ValueError if either has fewer than two values.
    """
    if min(len(first), len(second)) < 2:
        raise ValueError("a difference needs at least two values on each side")
    gap = float(np.mean(first) - np.mean(second))
    numbers = np.array([len(first), len(second)])
    errors = np.array([np.var(first, ddof=1), np.var(second, ddof=1)]) / numbers  # squared
    if not errors.any():
        return gap, gap
    freedom = errors.sum() ** 2 / (errors**2 / (numbers - 1)).sum()
    half = float(stats.t.ppf(0.975, freedom) * np.sqrt(errors.sum()))
    return gap - half, gap + half


def scores_at_milestones(
    episodes: pd.DataFrame, milestones: tuple[int, ...], window: int
) -> pd.DataFrame:
    """Mean score of the `window` episodes up to each milestone, a row per agent and seed.

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
