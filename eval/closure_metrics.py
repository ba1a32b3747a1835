"""Laps and loop closures: what the run says of them, and what is true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import rms
from conegraph.eval.association_metrics import right_rows
from conegraph.eval.record import Record
from conegraph.eval.run_metrics import mappings, number
from conegraph.io.run_folder import AssociationRows
from conegraph.types import Array, IntArray, Lap, MatchStatus

CLOSURE_BEFORE_S = 6.0
"""A lidar sees the start cones some seconds before the car is at the line."""

CLOSURE_AFTER_S = 1.0
"""A closure later than this after the crossing is not in time."""

SAME_LAP_S = 3.0
"""A counted lap is the true one that ends within this time of it."""

SAME_FRAME_S = 1e-6
"""Files round stamps to nanoseconds."""

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class ClosureMetrics(Record):
    """Loop closures and laps; what needs the truth is NaN or None without it.

    Attributes:
        laps: completed laps, as the run counted them.
        lap_times_s: their durations, s, where the run wrote them down.
        accepted: loop closures that were trusted.
        rejected: loop closures that were refused.
        undone: of the accepted, those taken back later on.
        precision: right closures / accepted ones that were not taken back; a closure
            is right if at least half of its frame's matches show the landmark's own
            cone. NaN without true ids.
        laps_true: laps that the car truly drove; None without a true path.
        in_time: of their ends, those with a closure from 6 s before to 1 s after
            the true car crossed the start line; None likewise.
        delay_s: median time from the true crossing to the closure, s; negative where
            the sensor sees the start cones from afar.
        delay_max_s: the greatest, s.
        lap_time_error_s: RMS difference between counted and true lap times, s.

    Source: precision as in C. van Rijsbergen, "Information Retrieval", 1979, and for
    closures M. Cummins and P. Newman, "FAB-MAP", IJRR 27(6), 2008.
    """

    laps: int
    lap_times_s: tuple[float, ...]
    accepted: int
    rejected: int
    undone: int = 0
    precision: float = _NAN
    laps_true: int | None = None
    in_time: int | None = None
    delay_s: float = _NAN
    delay_max_s: float = _NAN
    lap_time_error_s: float = _NAN


def closure_metrics(
    summary: Mapping[str, object],
    true_laps: Sequence[Lap] | None = None,
    rows: AssociationRows | None = None,
    truth_id: IntArray | None = None,
) -> ClosureMetrics:
    """Judge laps and loop closures in a run's summary.

    ``laps`` is a number, or a list with one entry a lap whose ``duration_s`` is its
    time and ``end_s`` its end; ``loop_closures`` is a list whose entries say when
    (``stamp_s``) and whether they were ``accepted``; a refused one at the stamp of an
    accepted one takes that back. What is missing counts as none.

    Args:
        summary: ``summary.json``.
        true_laps: the laps that were driven, None where nobody knows.
        rows: what became of each observation.
        truth_id: (N,) the true id of each, -1 for a false detection.
    """
    laps = summary.get("laps", 0)
    entries = mappings(laps)
    times = [entry.get("duration_s") for entry in entries]
    closures = mappings(summary.get("loop_closures", ()))
    accepted_s, refused_s = (_stamps(closures, kind) for kind in (True, False))
    accepted = sum(entry.get("accepted") is True for entry in closures)
    stands_s = accepted_s[~np.isin(accepted_s, refused_s)]
    driven = true_laps or ()
    delay_s = _delays(stands_s, np.array([lap.end_s for lap in driven]))
    known = delay_s[np.isfinite(delay_s)]
    in_time = int((known <= CLOSURE_AFTER_S).sum())
    return ClosureMetrics(
        laps=laps if isinstance(laps, int) else len(entries),
        lap_times_s=tuple(float(t) for t in times if isinstance(t, int | float)),
        accepted=accepted,
        rejected=len(closures) - accepted,
        undone=len(accepted_s) - len(stands_s),
        precision=_precision(stands_s, rows, truth_id),
        laps_true=None if true_laps is None else len(driven),
        in_time=None if true_laps is None else in_time,
        delay_s=float(np.median(known)) if len(known) else _NAN,
        delay_max_s=float(known.max()) if len(known) else _NAN,
        lap_time_error_s=_lap_time_error(entries, driven),
    )


def _delays(closed_s: Array, ends_s: Array) -> Array:
    """Return (n,) from each lap's end to its first closure, NaN without one.

    A closure belongs to the latest end that was at most 6 s ahead of it.
    """
    lap = np.searchsorted(ends_s - CLOSURE_BEFORE_S, closed_s, side="right") - 1
    delay = np.full(len(ends_s), np.nan)
    # Later closures first, so that a lap's first one is what remains.
    for k in np.flatnonzero(lap >= 0)[::-1]:
        delay[lap[k]] = closed_s[k] - ends_s[lap[k]]
    return delay


def _precision(
    closed_s: Array, rows: AssociationRows | None, truth_id: IntArray | None
) -> float:
    if rows is None or truth_id is None:
        return _NAN
    right = right_rows(rows, truth_id)
    matched = rows.status == MatchStatus.MATCHED
    verdicts = []
    for stamp_s in closed_s.tolist():
        of_frame = matched & (np.abs(rows.stamp_s - stamp_s) < SAME_FRAME_S)
        if of_frame.any():
            verdicts.append(float(right[of_frame].mean()) >= 0.5)
    return float(np.mean(verdicts)) if verdicts else _NAN


def _lap_time_error(
    entries: Sequence[Mapping[str, object]], true_laps: Sequence[Lap]
) -> float:
    counted = [(number(e, "end_s"), number(e, "duration_s")) for e in entries]
    if not counted or not true_laps:
        return _NAN
    end_s, time_s = np.array(counted).T
    true_end_s = np.array([lap.end_s for lap in true_laps])
    true_time_s = np.array([lap.duration_s for lap in true_laps])
    apart_s = np.abs(end_s[:, None] - true_end_s)
    nearest = np.argmin(np.nan_to_num(apart_s, nan=np.inf), axis=1)
    same = apart_s[np.arange(len(end_s)), nearest] <= SAME_LAP_S
    error_s = (time_s - true_time_s[nearest])[same]
    return rms(error_s[np.isfinite(error_s)])


def _stamps(closures: Sequence[Mapping[str, object]], accepted: bool) -> Array:
    """Return when closures were accepted, or refused, in order of time."""
    stamps = [number(c, "stamp_s") for c in closures if c.get("accepted") is accepted]
    found = np.array(stamps, dtype=np.float64)
    return np.sort(found[np.isfinite(found)])
