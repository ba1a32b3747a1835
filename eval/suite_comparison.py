"""What a suite's runs say of each contender, and of every two of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.paired import Duel, Pair, duel, duels
from conegraph.eval.record import Record
from conegraph.eval.statistics import Estimate, Rate, estimate, rate_over
from conegraph.eval.suite_metrics import METRICS, Metric
from conegraph.eval.suite_rows import SuiteRow
from conegraph.eval.suite_verdict import findings

_Key = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Contender(Record):
    """All runs of one contender.

    Attributes:
        name: what it is called.
        failures: how often it failed.
        medians: of the runs that did not fail, by metric; None where no run has it.
    """

    name: str
    failures: Rate
    medians: tuple[Estimate | None, ...]


@dataclass(frozen=True, slots=True)
class SuiteComparison(Record):
    """All runs of a suite.

    Attributes:
        findings: what they show in sentences, effect first.
        contenders: each by itself, their medians in the order of `metrics`.
        metrics: what was measured.
        duels: every two of them over the same streams.
        notes: what is odd about the rows.
    """

    findings: tuple[str, ...]
    contenders: tuple[Contender, ...]
    metrics: tuple[Metric, ...]
    duels: tuple[Duel, ...]
    notes: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """All that the runs show."""
        return " ".join(self.findings)


@dataclass(frozen=True, slots=True)
class VersionDiff(Record):
    """Two results of the same streams: two versions of the code, or configurations.

    Attributes:
        duels: by contender, the old one first.
        only_old: runs that only the old results have, by stream and contender.
        only_new: runs that only the new ones have.
        same: how many pairs agree in every metric that does not measure time.
        notes: what is odd about the rows.
    """

    duels: tuple[Duel, ...]
    only_old: tuple[str, ...]
    only_new: tuple[str, ...]
    same: int
    notes: tuple[str, ...]


def compare_suite(rows: Sequence[SuiteRow]) -> SuiteComparison:
    """Compare the contenders of a suite; the same rows give the same answer."""
    by_name: dict[str, list[SuiteRow]] = {}
    for row in rows:
        by_name.setdefault(row.contender, []).append(row)
    pairs = duels(rows)
    contenders = tuple(_contender(name, own) for name, own in by_name.items())
    return SuiteComparison(
        findings=findings({c.name: c.failures for c in contenders}, pairs, rows),
        contenders=contenders,
        metrics=METRICS,
        duels=pairs,
        notes=_notes(rows),
    )


def compare_versions(old: Sequence[SuiteRow], new: Sequence[SuiteRow]) -> VersionDiff:
    """Compare two results run by run: same stream, same back end and profile.

    The two sides are called by their settings where these differ, else old and new.
    """
    before = {(row.stream, row.contender): row for row in old}
    after = {(row.stream, row.contender): row for row in new}
    both: dict[str, list[Pair]] = {}
    for key, row in before.items():
        if key in after:
            both.setdefault(row.contender, []).append((row, after[key]))
    before_is, after_is = _sides(old, new)
    fixed = [metric.name for metric in METRICS if not metric.varies]
    return VersionDiff(
        duels=tuple(
            duel((f"{name} ({before_is})", f"{name} ({after_is})"), pairs)
            for name, pairs in both.items()
        ),
        only_old=_only(before, after),
        only_new=_only(after, before),
        same=sum(
            np.array_equal(
                [a.metrics[name] for name in fixed],
                [b.metrics[name] for name in fixed],
                equal_nan=True,
            )
            for pairs in both.values()
            for a, b in pairs
        ),
        notes=(
            *(f"{before_is}: {note}" for note in _notes(old)),
            *(f"{after_is}: {note}" for note in _notes(new)),
        ),
    )


def _sides(old: Sequence[SuiteRow], new: Sequence[SuiteRow]) -> tuple[str, str]:
    """Return what to call two results."""
    one, other = ({row.settings for row in rows} for rows in (old, new))
    if one == other or len(one) != 1 or len(other) != 1:
        return "old", "new"
    return one.pop() or "as shipped", other.pop() or "as shipped"


def _only(
    these: Mapping[_Key, SuiteRow], others: Mapping[_Key, SuiteRow]
) -> tuple[str, ...]:
    return tuple(" ".join(key) for key in these if key not in others)


def _contender(name: str, rows: Sequence[SuiteRow]) -> Contender:
    rng = np.random.default_rng(0)
    fine = [row for row in rows if not row.failed]
    return Contender(
        name,
        rate_over(
            np.array([row.failed for row in rows], dtype=np.bool_),
            [row.track for row in rows],
        ),
        tuple(median_of(metric, fine, rng) for metric in METRICS),
    )


def median_of(
    metric: Metric, rows: Sequence[SuiteRow], rng: np.random.Generator
) -> Estimate | None:
    """Return the median of rows with its interval, None where no row has the metric."""
    values = np.array([row.metrics[metric.name] for row in rows], dtype=np.float64)
    known = np.isfinite(values)
    if not known.any():
        return None
    tracks = [row.track for row, k in zip(rows, known, strict=True) if k]
    return estimate(values[known], tracks, "median", rng)


def _notes(rows: Sequence[SuiteRow]) -> tuple[str, ...]:
    versions = sorted({row.code_version for row in rows})
    if len(versions) < 2:
        return ()
    return (f"the rows are of {len(versions)} versions: {', '.join(versions)}",)
