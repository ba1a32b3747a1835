"""What can be said about a run without any truth: time, laps, status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.record import Record
from conegraph.io.run_folder import StatusRows
from conegraph.types import Array, Status


@dataclass(frozen=True, slots=True)
class LatencyStats(Record):
    """Time per frame of one stage in ms: percentiles (linear) and the greatest."""

    count: int
    p50: float
    p95: float
    p99: float
    max: float


@dataclass(frozen=True, slots=True)
class ClosureMetrics(Record):
    """Loop closures and laps as the run counted them.

    Attributes:
        laps: completed laps.
        lap_times_s: their durations, s, where the run wrote them down.
        accepted: loop closures that were trusted.
        rejected: loop closures that were refused.
    """

    laps: int
    lap_times_s: tuple[float, ...]
    accepted: int
    rejected: int


@dataclass(frozen=True, slots=True)
class StatusMetrics(Record):
    """How long the run trusted itself.

    Attributes:
        frames: frames in all.
        by_status: frames by status, in the order INIT, OK, DEGRADED, LOST.
        resets: jumps of the estimate.
    """

    frames: int
    by_status: Mapping[str, int]
    resets: int


def latency_stats(timing_ms: Mapping[str, Array]) -> dict[str, LatencyStats]:
    """Summarise the times of each stage; stages without a time are left out."""
    return {stage: _latency(ms) for stage, ms in timing_ms.items() if len(ms)}


def _latency(ms: Array) -> LatencyStats:
    p50, p95, p99 = np.percentile(ms, (50, 95, 99)).tolist()
    return LatencyStats(len(ms), p50, p95, p99, float(np.max(ms)))


def status_metrics(rows: StatusRows) -> StatusMetrics:
    """Count frames by status, and resets."""
    return StatusMetrics(
        frames=len(rows),
        by_status={s.value: int((rows.status == s.value).sum()) for s in Status},
        resets=int(rows.reset_counter.max()) if len(rows) else 0,
    )


def closure_metrics(summary: Mapping[str, object]) -> ClosureMetrics:
    """Read laps and loop closures from a run's summary.

    ``laps`` is a number, or a list with one entry a lap whose ``duration_s`` is its
    time; ``loop_closures`` is a list whose entries say whether they were
    ``accepted``. What is missing counts as none.
    """
    laps = summary.get("laps", 0)
    entries = _mappings(laps)
    times = [entry.get("duration_s") for entry in entries]
    closures = _mappings(summary.get("loop_closures", ()))
    accepted = sum(entry.get("accepted") is True for entry in closures)
    return ClosureMetrics(
        laps=laps if isinstance(laps, int) else len(entries),
        lap_times_s=tuple(float(t) for t in times if isinstance(t, int | float)),
        accepted=accepted,
        rejected=len(closures) - accepted,
    )


def _mappings(value: object) -> list[Mapping[str, object]]:
    if not isinstance(value, Sequence):
        return []
    return [entry for entry in value if isinstance(entry, Mapping)]
