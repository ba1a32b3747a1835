"""What can be said about a run without any truth: time, memory, status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.record import Record
from conegraph.io.run_folder import StatusRows
from conegraph.types import Array, Status

FRAME = "frame"
"""The stage that is the whole of a frame, but for the detector."""

DETECT = "detect"
"""The stage that finds cones in pictures, ahead of the frame."""

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class LatencyStats(Record):
    """Time per frame of one stage in ms: percentiles (linear) and the greatest."""

    count: int
    p50: float
    p95: float
    p99: float
    max: float


@dataclass(frozen=True, slots=True)
class CostMetrics(Record):
    """What a run took of the computer.

    Attributes:
        log_s: time from the first to the last frame of the stream, s.
        processing_s: time spent on frames, detection included, s; what a mapper does
            in a process of its own, and odometry between frames, is not in it.
        real_time_factor: `log_s` / `processing_s`; above 1 keeps up with the sensor.
        lap_p99_ms: 99th percentile of the time per frame, ms, one entry a lap that
            the run counted.
        p99_growth: the last lap's over the first's; about 1 where the time per frame
            does not grow with the run. NaN with less than two laps.
        peak_memory_mb: greatest resident memory of the process, MiB, since it began:
            of runs in one process a later one is never below an earlier.
        mapping: where the graph was solved: ``inline``, between two frames, or in a
            ``process`` of its own; empty of a back end without a graph.
    """

    log_s: float
    processing_s: float
    real_time_factor: float
    lap_p99_ms: tuple[float, ...]
    p99_growth: float
    peak_memory_mb: float
    mapping: str = ""


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


def cost_metrics(
    stamp_s: Array, timing_ms: Mapping[str, Array], summary: Mapping[str, object]
) -> CostMetrics:
    """Relate times to the stream's own time and to its laps.

    Args:
        stamp_s: (N,) stamps of the frames.
        timing_ms: times by stage; of a killed run a last row may be missing.
        summary: ``summary.json``; empty of a killed run.
    """
    log_s = float(np.ptp(stamp_s)) if len(stamp_s) else _NAN
    stages = (timing_ms[stage] for stage in (FRAME, DETECT) if stage in timing_ms)
    processing_s = sum(float(ms.sum()) for ms in stages) / 1e3
    lap_p99_ms = _lap_p99(stamp_s, timing_ms.get(FRAME, np.zeros(0)), summary)
    grown = len(lap_p99_ms) > 1 and lap_p99_ms[0] > 0
    return CostMetrics(
        log_s=log_s,
        processing_s=processing_s,
        real_time_factor=log_s / processing_s if processing_s > 0 else _NAN,
        lap_p99_ms=lap_p99_ms,
        p99_growth=lap_p99_ms[-1] / lap_p99_ms[0] if grown else _NAN,
        peak_memory_mb=number(summary, "peak_memory_mb"),
        mapping=str(summary.get("mapping", "")),
    )


def _lap_p99(
    stamp_s: Array, frame_ms: Array, summary: Mapping[str, object]
) -> tuple[float, ...]:
    n = min(len(stamp_s), len(frame_ms))
    found = []
    for lap in mappings(summary.get("laps")):
        end_s = number(lap, "end_s")
        start_s = end_s - number(lap, "duration_s")
        in_lap = (stamp_s[:n] > start_s) & (stamp_s[:n] <= end_s)
        if in_lap.any():
            found.append(float(np.percentile(frame_ms[:n][in_lap], 99)))
    return tuple(found)


def number(entry: Mapping[str, object], key: str) -> float:
    """Return an entry of a summary that should be a number, NaN if it is none."""
    value = entry.get(key)
    return float(value) if isinstance(value, int | float) else _NAN


def mappings(value: object) -> list[Mapping[str, object]]:
    """Return the objects in an entry of a summary that should be a list of them."""
    if not isinstance(value, Sequence):
        return []
    return [entry for entry in value if isinstance(entry, Mapping)]
