"""Two contenders over the same streams: effects, intervals, and what they show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from conegraph.eval.record import Record
from conegraph.eval.statistics import (
    Estimate,
    Middle,
    Rate,
    estimate,
    holm,
    mcnemar,
    rate_over,
    signed_rank,
)
from conegraph.eval.suite_metrics import MAIN, METRICS, Metric
from conegraph.eval.suite_rows import SuiteRow
from conegraph.eval.words import counted

LEAST_P = 0.05
NO_DIFFERENCE = "no difference shown"
Pair = tuple[SuiteRow, SuiteRow]


@dataclass(frozen=True, slots=True)
class Effect(Record):
    """How one metric differs between two contenders over the same streams.

    Attributes:
        metric: what was measured.
        names: the first and the second contender.
        size: the second's over the first's (median of the ratios, by their logarithms)
            or less the first's (mean of the differences), as the metric has it.
        p: of the signed-rank test, corrected for the metrics of its family (`MAIN`, or
            all others).
        left_out: pairs without a number, or without a logarithm, of one of the two.
        least: fewest drives, or tracks of a general size, whose p can show anything.
    """

    metric: Metric
    names: tuple[str, str]
    size: Estimate
    p: float
    left_out: int
    least: int = 1

    @property
    def none(self) -> float:
        """The size of no difference."""
        return 1.0 if self.metric.effect == "ratio" else 0.0

    @property
    def known(self) -> bool:
        """Whether there are enough pairs to say how certain it is."""
        return math.isfinite(self.size.interval.low)

    @property
    def worth(self) -> int:
        """How many independent drives, or tracks of a general size, there are."""
        return self.size.groups if self.size.general else self.size.count

    @property
    def enough(self) -> bool:
        """Whether a difference could be shown at all, however large it is."""
        return self.known and self.worth >= self.least

    @property
    def shown(self) -> bool:
        """Whether there is a difference: by the interval and by the corrected test.

        The interval is of this metric alone, so that it may leave out "no difference"
        where the test, which is corrected for all that are looked at, shows none.
        """
        return self.size.interval.excludes(self.none) and self.p < LEAST_P

    @property
    def better(self) -> str:
        """Which of the two is shown to be better, by interval and test; or neither."""
        if not self.shown or self.metric.better is None:
            return ""
        second = (self.size.value > self.none) == (self.metric.better == "high")
        return self.names[1] if second else self.names[0]

    @property
    def says(self) -> str:
        """What size, interval and test say together."""
        if not self.enough:
            units = counted(self.worth, "track" if self.size.general else "drive")
            return f"{units} cannot show a difference: it takes {self.least}"
        return f"{self.better} is better" if self.better else NO_DIFFERENCE

    @property
    def sentence(self) -> str:
        """What there is to say: effect first."""
        first, second = self.names
        sign = "/" if self.metric.effect == "ratio" else " - "
        size = (
            f"{self.metric.label}: {second}{sign}{first} {self.text(self.size.value)}"
        )
        if not self.known:
            return f"{size}: {self.says}"
        low, high = (
            self.text(self.size.interval.low),
            self.text(self.size.interval.high),
        )
        return f"{size} (95 % interval {low} to {high}, {p_text(self.p)}): {self.says}"

    def text(self, size: float) -> str:
        """Return a size or an end of its interval as it is written."""
        if self.metric.effect == "ratio":
            return f"{size:.2f}" if abs(size - 1.0) >= 0.1 else f"{size:.3f}"
        return f"{size:+.{max(self.metric.digits, 2)}f}"


@dataclass(frozen=True, slots=True)
class Failures(Record):
    """How often each of two contenders failed over the same streams.

    Attributes:
        rates: of both.
        only: streams on which only the first, and only the second failed.
        p: of McNemar's exact test, by track where there are enough.
    """

    names: tuple[str, str]
    rates: tuple[Rate, Rate]
    only: tuple[int, int]
    p: float

    @property
    def enough(self) -> bool:
        """Whether so many drives could show a difference at all."""
        return self.rates[0].of >= least_to_show(1)

    @property
    def shown(self) -> bool:
        """Whether one fails more often than the other."""
        return self.p < LEAST_P

    @property
    def sentence(self) -> str:
        """What there is to say: effect first."""
        said = "; ".join(
            f"{name} failed in {rate_text(r)}"
            for name, r in zip(self.names, self.rates, strict=True)
        )
        level = "" if self.shown else f", {NO_DIFFERENCE}"
        if not self.enough:
            drives = counted(self.rates[0].of, "drive")
            level = f": {drives} cannot show a difference, it takes {least_to_show(1)}"
        return f"failures: {said} ({p_text(self.p)}{level})"


@dataclass(frozen=True, slots=True)
class Duel(Record):
    """Two contenders over the streams that both were run on.

    Attributes:
        names: the first and the second.
        streams: how many streams both were run on.
        tracks: on how many tracks.
        failures: how often they failed.
        left_out: streams that say nothing of errors because one or both failed.
        effects: by metric, of the streams that are left, the main ones first.
    """

    names: tuple[str, str]
    streams: int
    tracks: int
    failures: Failures
    left_out: int
    effects: tuple[Effect, ...]

    @property
    def scope(self) -> str:
        """What was compared, and how far it holds."""
        first, second = self.names
        said = f"{second} against {first} over {counted(self.streams, 'stream')}"
        if self.left_out:
            said += f", {self.left_out} of them left out of what follows for a failure"
        if self.general:
            return f"{said}; it holds for tracks like these {self.tracks}"
        return f"{said}; it holds for {these_tracks(self.tracks)} only"

    @property
    def general(self) -> bool:
        """Whether there are enough tracks to speak of others like them."""
        return any(effect.size.general for effect in self.effects)


def duel(names: tuple[str, str], pairs: Sequence[Pair], seed: int = 0) -> Duel:
    """Compare two contenders over the same streams.

    Args:
        names: of the first and the second of each pair.
        pairs: their rows, of one stream each.
        seed: of the resamples.
    """
    rng = np.random.default_rng(seed)
    fine = [pair for pair in pairs if not (pair[0].failed or pair[1].failed)]
    found = [
        effect
        for metric in METRICS
        if metric.effect is not None
        and (effect := _effect(metric, names, fine, rng)) is not None
    ]
    main = [effect for effect in found if effect.metric.name in MAIN]
    others = [effect for effect in found if effect.metric.name not in MAIN]
    return Duel(
        names=names,
        streams=len(pairs),
        tracks=len({first.track for first, _ in pairs}),
        failures=_failures(names, pairs),
        left_out=len(pairs) - len(fine),
        effects=(*_corrected(main), *_corrected(others)),
    )


def duels(rows: Sequence[SuiteRow]) -> tuple[Duel, ...]:
    """Compare every two contenders, in the order in which they first appear."""
    by_name: dict[str, dict[str, SuiteRow]] = {}
    for row in rows:
        by_name.setdefault(row.contender, {})[row.stream] = row
    names = list(by_name)
    return tuple(
        duel((first, second), _paired(by_name[first], by_name[second]))
        for k, first in enumerate(names)
        for second in names[k + 1 :]
    )


def least_to_show(tests: int) -> int:
    """Return the fewest drives that can show a difference in one of so many figures.

    All n are on one side by chance in 2 of 2^n cases, times the number of tests.
    """
    return math.floor(math.log2(tests / LEAST_P)) + 2


def these_tracks(count: int) -> str:
    """Return how those tracks are called that were driven on."""
    return "this track" if count == 1 else f"these {count} tracks"


def p_text(p: float) -> str:
    """Return a probability as it is written."""
    return f"p {p:.3f}" if p >= 0.001 else "p < .001"


def rate_text(found: Rate) -> str:
    """Return a failure rate with its interval in words."""
    low, high = 100.0 * found.interval.low, 100.0 * found.interval.high
    return f"{found.count} of {found.of} ({low:.0f} to {high:.0f} %)"


def _paired(
    first: Mapping[str, SuiteRow], second: Mapping[str, SuiteRow]
) -> list[Pair]:
    return [(row, second[stream]) for stream, row in first.items() if stream in second]


def _corrected(effects: Sequence[Effect]) -> list[Effect]:
    p = holm([effect.p for effect in effects])
    least = least_to_show(len(effects)) if effects else 1
    return [replace(e, p=own, least=least) for e, own in zip(effects, p, strict=True)]


def _effect(
    metric: Metric,
    names: tuple[str, str],
    pairs: Sequence[Pair],
    rng: np.random.Generator,
) -> Effect | None:
    """Return None where no pair has the metric."""
    values = np.array([[row.metrics[metric.name] for row in pair] for pair in pairs])
    first, second = values.reshape(-1, 2).T
    ratio = metric.effect == "ratio"
    known = np.isfinite(first) & np.isfinite(second)
    if ratio:
        known &= (first > 0.0) & (second > 0.0)
    if not known.any():
        return None
    first, second = first[known], second[known]
    off = np.log(second / first) if ratio else second - first
    tracks = [a.track for (a, _), k in zip(pairs, known, strict=True) if k]
    middle: Middle = "median" if ratio else "mean"
    size = estimate(off, tracks, middle, rng)
    p = signed_rank(off, tracks, middle)
    return Effect(
        metric, names, size.mapped(np.exp) if ratio else size, p, int((~known).sum())
    )


def _failures(names: tuple[str, str], pairs: Sequence[Pair]) -> Failures:
    failed = np.array([[row.failed for row in pair] for pair in pairs], dtype=np.bool_)
    first, second = failed.reshape(-1, 2).T
    only = int((first & ~second).sum()), int((second & ~first).sum())
    tracks = [row.track for row, _ in pairs]
    rates = rate_over(first, tracks), rate_over(second, tracks)
    return Failures(names, rates, only, mcnemar(first, second, tracks))
