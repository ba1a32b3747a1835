"""A benchmark's figures in tables: medians with their intervals, and failures."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from conegraph.eval.document import Facts, Table, TableRow
from conegraph.eval.statistics import Estimate
from conegraph.eval.suite_comparison import SuiteComparison, median_of
from conegraph.eval.suite_metrics import BY_NAME, Metric
from conegraph.eval.suite_pictures import (
    MAP_ERROR,
    NONE,
    Grouped,
    number_text,
    stream_kind,
    where,
)
from conegraph.eval.suite_rows import SuiteRow

GROUPS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Map", (MAP_ERROR, "precision", "recall", "duplicates", "colour_errors")),
    ("Path while driving", ("ate_aligned_m", "ate_start_m", "yaw_rmse_deg")),
    ("Honesty of the covariances, 1 is right", ("nees_pose", "nees_map", "nis")),
    ("Loop closures", ("closure_precision", "closures_accepted")),
    (
        "Cost on the machine at hand",
        ("frame_p50_ms", "frame_p99_ms", "frame_max_ms", "real_time_factor", "peak_mb"),
    ),
)


def facts(rows: Sequence[SuiteRow], grouped: Grouped) -> Facts:
    """Return what was run."""
    tracks = sorted({row.track for row in rows})
    seeds = sorted({row.seed for row in rows})
    streams = {row.stream for row in rows}
    said = (
        ("Runs", f"{len(rows)}, over {len(streams)} streams"),
        ("Back ends", ", ".join(f"{n} ({len(r)})" for n, r in grouped.items())),
        ("Tracks", f"{len(tracks)}: {', '.join(tracks)}"),
        ("Sensors", _each(stream_kind(row) for row in rows)),
        ("Faults", _each(row.faults for row in rows)),
        ("Seeds", f"{len(seeds)}, from {seeds[0]} to {seeds[-1]}"),
        ("Laps", _each(str(row.laps) for row in rows)),
        ("Settings", _each(row.settings for row in rows)),
        ("Code", _each(row.code_version for row in rows)),
    )
    return Facts(tuple((name, what) for name, what in said if what))


def _each(words: Iterable[str]) -> str:
    """Return the different words in order, nothing where all are empty."""
    found = sorted(set(words))
    return "; ".join(word or "none" for word in found) if any(found) else ""


def contender_table(comparison: SuiteComparison) -> Table:
    """Return the median of each figure of each contender's sound runs."""
    place = {metric.name: i for i, metric in enumerate(comparison.metrics)}
    rows = [
        TableRow(
            _title(BY_NAME[name]),
            tuple(
                _shown(contender.medians[place[name]], BY_NAME[name])
                for contender in comparison.contenders
            ),
            group=group,
        )
        for group, names in GROUPS
        for name in names
    ]
    return Table(
        "Median over all runs that did not fail, and the interval that holds it with "
        "95 % confidence.",
        tuple(contender.name for contender in comparison.contenders),
        tuple(row for row in rows if set(row.cells) != {NONE}),
    )


def stream_table(grouped: Grouped) -> Table:
    """Return the median map error by track and kind of stream."""
    rng, error = np.random.default_rng(0), BY_NAME[MAP_ERROR]
    places = sorted(
        {(r.track, stream_kind(r), r.faults) for rows in grouped.values() for r in rows}
    )
    found = []
    for track, kind, faults in places:
        here = {
            name: [
                r
                for r in rows
                if (r.track, stream_kind(r), r.faults) == (track, kind, faults)
            ]
            for name, rows in grouped.items()
        }
        title = f"{kind}, {faults}" if faults else kind
        cells = tuple(_with_failures(rows, error, rng) for rows in here.values())
        found.append(TableRow(title, cells, group=track))
    return Table(
        f"Median {error.label} [{error.unit}] over the seeds, its 95 % interval, and "
        "how many runs failed.",
        tuple(grouped),
        tuple(found),
        corner="track, sensor",
    )


def failure_table(comparison: SuiteComparison, grouped: Grouped) -> Table:
    """Return how often each contender failed, and on what."""
    found = []
    for contender in comparison.contenders:
        share = contender.failures
        low, high = 100 * share.interval.low, 100 * share.interval.high
        percent = f"{100 * share.count / share.of:.1f} % [{low:.1f}, {high:.1f}]"
        reasons = [row.reason for row in grouped[contender.name] if row.failed]
        kinds = Counter(_kind(reason) for reason in reasons)
        why = ", ".join(f"{kind} {n}" for kind, n in kinds.most_common())
        cells = (str(share.of), str(share.count), percent, why or NONE)
        found.append(TableRow(contender.name, cells))
    return Table(
        "A run fails if it breaks off, is ever 2 m or more off its way, if more than a "
        "tenth of its map is false, or if it misses a lap.",
        ("runs", "failed", "rate, 95 % interval", "why"),
        tuple(found),
        corner="back end",
        words=frozenset({3}),
    )


def worst_table(ranked: Sequence[SuiteRow]) -> Table:
    """Return runs, the worst first, with their errors and why they failed."""
    return Table(
        "Failed runs first, then those with the largest error of the map.",
        ("back end", "map error [m]", "greatest path error [m]", "why it failed"),
        tuple(
            TableRow(
                f"{number}. {where(row)}",
                (
                    row.contender,
                    number_text(row.metrics[MAP_ERROR], 3),
                    number_text(row.metrics["pose_max_m"], 2),
                    row.reason or NONE,
                ),
            )
            for number, row in enumerate(ranked, 1)
        ),
        corner="stream",
        words=frozenset({0, 3}),
    )


def _title(metric: Metric) -> str:
    return f"{metric.label} [{metric.unit}]" if metric.unit else metric.label


def _shown(found: Estimate | None, metric: Metric) -> str:
    if found is None:
        return NONE
    digits, interval = metric.digits, found.interval
    value = f"{found.value:.{digits}f}"
    if not math.isfinite(interval.low):
        return value
    return f"{value} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def _with_failures(
    rows: Sequence[SuiteRow], metric: Metric, rng: np.random.Generator
) -> str:
    """Return the median of the rows that did not fail, and how many did."""
    fine = [row for row in rows if not row.failed]
    median = _shown(median_of(metric, fine, rng), metric)
    failed = len(rows) - len(fine)
    if not failed:
        return median
    lost = f"{failed} of {len(rows)} failed"
    return lost if failed == len(rows) else f"{median}, {lost}"


def _kind(reason: str) -> str:
    """Return a reason without its figures, so that alike ones can be counted."""
    return " ".join(re.findall("[A-Za-z]{3,}", reason.split(": ")[0]))
