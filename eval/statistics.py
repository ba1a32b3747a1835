"""Intervals and tests for runs that come in groups: drives on the same track.

Drives on one track are more alike than drives on two, so they are not so many
independent observations. With at least `LEAST_GROUPS` tracks, tracks are what is
drawn again (the cluster bootstrap) and what is ranked, and what is found holds for
tracks like these. With fewer no interval could hold for others: 4 tracks are all on
one side in one of 8 cases by chance alone. Then drives are drawn again within each
track, and what is found holds for these tracks only.

Sources: B. Efron and R. Tibshirani, "An Introduction to the Bootstrap", 1993;
A. Davison and D. Hinkley, "Bootstrap Methods and their Application", 1997, sections
3.2 (strata) and 3.8 (clusters); T. Hesterberg, "What teachers should know about the
bootstrap", The American Statistician 69(4), 2015 (percentiles expanded where there
are few observations).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from conegraph.eval.record import Record
from conegraph.types import Array, Mask

CONFIDENCE = 0.95

LEAST_GROUPS = 8
"""All of 8 are on one side by chance in 1 of 128 cases: shown even for one of four."""

RESAMPLES = 4000
Middle = Literal["median", "mean"]
_NAN = math.nan


@dataclass(frozen=True, slots=True)
class Interval(Record):
    """Where a figure lies with 95 % confidence; NaN where nothing can be said."""

    low: float
    high: float

    def excludes(self, value: float) -> bool:
        """Whether a value lies outside; nothing does where nothing can be said."""
        return value < self.low or value > self.high


@dataclass(frozen=True, slots=True)
class Estimate(Record):
    """The middle of some values.

    Attributes:
        value: their median or mean, NaN without any.
        interval: for it.
        count: how many values.
        groups: how many groups they come in.
        general: whether the interval holds for other groups too.
    """

    value: float
    interval: Interval
    count: int
    groups: int
    general: bool

    def mapped(self, function: Callable[[float], float]) -> Self:
        """Return it with its numbers passed through a growing function."""
        low, high = function(self.interval.low), function(self.interval.high)
        return replace(
            self,
            value=float(function(self.value)),
            interval=Interval(float(low), float(high)),
        )


@dataclass(frozen=True, slots=True)
class Rate(Record):
    """How often something happened.

    Attributes:
        count: how often.
        of: in how many runs.
        interval: Wilson's for the probability.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical
    inference", JASA 22, 1927.
    """

    count: int
    of: int
    interval: Interval


def estimate(
    values: Array, groups: Sequence[str], middle: Middle, rng: np.random.Generator
) -> Estimate:
    """Return the middle of values (N,) with its bootstrap interval.

    Percentiles of resamples are too narrow for few observations: they are taken farther
    out, at the normal probability of ``-sqrt(n / (n - s)) t`` with t the quantile of
    Student's distribution of n - s degrees of freedom, n observations in s strata.

    Args:
        values: finite numbers.
        groups: (N,) what each value belongs to.
        middle: of what kind.
        rng: draws the resamples.
    """
    own, of_group = np.unique(np.array(groups, dtype=np.str_), return_inverse=True)
    value = float(_middle(values, middle, -1)) if len(values) else _NAN
    general = len(own) >= LEAST_GROUPS
    samples = _by_group(values, of_group)
    if general:
        interval = _clustered(samples, middle, rng)
    else:
        interval = _stratified(samples, middle, rng)
    return Estimate(value, interval, len(values), len(own), general)


def signed_rank(values: Array, groups: Sequence[str], middle: Middle) -> float:
    """Return how likely values (N,) as far from 0 are if their middle is 0.

    Wilcoxon's signed-rank test, two-sided, of the groups' middles where there are
    enough groups, and of the values otherwise. Zeros say nothing; 1 with nothing else.
    It is exact also where values are equal, up to 13 of them, and up to 50 where none
    are (`scipy.stats.wilcoxon`).

    Source: F. Wilcoxon, "Individual comparisons by ranking methods", 1945.
    """
    samples = _units(values, groups)
    ranked = np.array([float(_middle(s, middle, -1)) for s in samples])
    ranked = ranked[ranked != 0.0]
    return float(stats.wilcoxon(ranked).pvalue) if len(ranked) else 1.0


def mcnemar(first: Mask, second: Mask, groups: Sequence[str]) -> float:
    """Return how likely failures (N,) of two are as uneven if both fail as often.

    Pairs of which one failed are counted for the other (McNemar); where there are
    enough groups, each group counts once, for whom it has more.

    Source: Q. McNemar, "Note on the sampling error of the difference between
    correlated proportions or percentages", Psychometrika 12, 1947.
    """
    off = second.astype(np.float64) - first
    more = np.array([sample.sum() for sample in _units(off, groups)])
    return sign_test(int((more < 0).sum()), int((more > 0).sum()))


def sign_test(fewer: int, more: int) -> float:
    """Return how likely so uneven a split is if both sides are as likely, two-sided."""
    total = fewer + more
    return float(stats.binomtest(fewer, total).pvalue) if total else 1.0


def rate(count: int, of: int, worth: float | None = None) -> Rate:
    """Return a share with its interval.

    Args:
        count: how often something happened.
        of: in how many runs.
        worth: how many independent runs they are worth, all of them by default.
    """
    if of == 0:
        return Rate(0, 0, Interval(_NAN, _NAN))
    n, p = of if worth is None else worth, count / of
    z = float(stats.norm.isf(0.5 * (1.0 - CONFIDENCE)))
    middle = (p + z**2 / (2.0 * n)) / (1.0 + z**2 / n)
    half = z / (1.0 + z**2 / n) * math.sqrt(p * (1.0 - p) / n + (0.5 * z / n) ** 2)
    return Rate(count, of, Interval(max(middle - half, 0.0), min(middle + half, 1.0)))


def rate_over(happened: Mask, groups: Sequence[str]) -> Rate:
    """Return how often something happened (N,) in runs that come in groups.

    Runs of one group are alike: where there are enough groups, N runs are worth
    N / deff independent ones, deff the variance of the share over the groups beside
    that of independent runs. Where it never or always happened nothing tells.

    Source: the design effect, L. Kish, "Survey Sampling", 1965.
    """
    count, of = int(happened.sum()), len(happened)
    samples = _units(happened.astype(np.float64), groups)
    if not 0 < count < of or len(samples) == of:
        return rate(count, of)
    share, n = count / of, len(samples)
    off = np.array([(sample - share).sum() for sample in samples])
    variance = n / (n - 1) * float((off**2).sum()) / of**2
    worth = share * (1.0 - share) / variance if variance > 0.0 else of
    return rate(count, of, min(max(worth, 1.0), of))


def holm(p: Sequence[float]) -> list[float]:
    """Return probabilities corrected for being many, in the order given.

    With all of them below .05 so corrected, the probability that any is so by chance
    is below .05.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure",
    Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(p)
    steps = np.array(p)[order] * np.arange(len(p), 0, -1)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    found: list[float] = corrected.tolist()
    return found


def _units(values: Array, groups: Sequence[str]) -> list[Array]:
    """Return what is independent: the groups if there are enough, else each value."""
    own, of_group = np.unique(np.array(groups, dtype=np.str_), return_inverse=True)
    if len(own) >= LEAST_GROUPS:
        return _by_group(values, of_group)
    return list(values[:, None])


def _by_group(values: Array, of_group: NDArray[np.intp]) -> list[Array]:
    return [values[of_group == k] for k in range(int(of_group.max(initial=-1)) + 1)]


def _clustered(
    samples: Sequence[Array], middle: Middle, rng: np.random.Generator
) -> Interval:
    """Draw whole groups again; rows of the table are groups, padded with NaN."""
    longest = max(len(sample) for sample in samples)
    table = np.full((len(samples), longest), np.nan)
    for row, sample in zip(table, samples, strict=True):
        row[: len(sample)] = sample

    def of_groups(rows: Array, axis: int) -> Array:
        drawn = table[np.moveaxis(rows, axis, -1).astype(np.int64)]
        return _middle(drawn.reshape(*drawn.shape[:-2], -1), middle, -1)

    units = [np.arange(len(samples), dtype=np.float64)]
    return _bootstrap(units, of_groups, len(samples) - 1, len(samples), rng)


def _stratified(
    samples: Sequence[Array], middle: Middle, rng: np.random.Generator
) -> Interval:
    """Draw again within each group; those of one value are one group together."""
    alone = [sample for sample in samples if len(sample) == 1]
    strata = [sample for sample in samples if len(sample) > 1]
    if len(alone) > 1:
        strata.append(np.concatenate(alone))
    elif alone and strata:
        strata[0] = np.concatenate([strata[0], alone[0]])
    if not strata:
        return Interval(_NAN, _NAN)

    def of_values(*drawn: Array, axis: int) -> Array:
        return _middle(np.concatenate(drawn, axis=axis), middle, axis)

    count = sum(len(stratum) for stratum in strata)
    return _bootstrap(strata, of_values, count - len(strata), count, rng)


def _bootstrap(
    data: Sequence[Array],
    statistic: Callable[..., Array],
    dof: int,
    count: int,
    rng: np.random.Generator,
) -> Interval:
    tail = 0.5 * (1.0 - CONFIDENCE)
    farther = math.sqrt(count / dof) * float(stats.t.isf(tail, dof))
    found = stats.bootstrap(
        data,
        statistic,
        n_resamples=RESAMPLES,
        vectorized=True,
        axis=-1,
        confidence_level=1.0 - 2.0 * float(stats.norm.sf(farther)),
        method="percentile",
        rng=rng,
    ).confidence_interval
    return Interval(float(found.low), float(found.high))


def _middle(values: Array, middle: Middle, axis: int) -> Array:
    """Return the median or mean along an axis; NaN is padding."""
    if middle == "mean":
        mean: Array = np.nanmean(values, axis=axis)
        return mean
    ranked = np.sort(values, axis=axis)
    count = np.isfinite(values).sum(axis=axis, keepdims=True)
    low = np.take_along_axis(ranked, (count - 1) // 2, axis)
    high = np.take_along_axis(ranked, count // 2, axis)
    median: Array = (0.5 * (low + high)).squeeze(axis)
    return median
