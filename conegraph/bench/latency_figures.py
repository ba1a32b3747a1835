"""Figures of time and memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conegraph.bench.accuracy_figures import EKF, ISAM2, in_group, of
from conegraph.bench.figure import Figure, not_measured
from conegraph.bench.plan import LARGE, LONG, LONG_LAPS, MANY_CONES, USUAL_CONES
from conegraph.bench.rows import CostRow, RunRow


def latency_figures(runs: Sequence[RunRow], costs: Sequence[CostRow]) -> list[Figure]:
    """Return the figures of frame times, growth and memory."""
    long, large = in_group(runs, LONG), in_group(runs, LARGE)
    usual = f"{USUAL_CONES} cones, worst of {LONG_LAPS} laps"
    figures = [
        _p99(f"EKF: frame p99, {usual}", of(long, EKF), 2.0),
        _p99(f"iSAM2: frame p99, {usual}", of(long, ISAM2), 3.0),
        _p99(f"iSAM2: frame p99, {MANY_CONES} cones", of(large, ISAM2), 5.0),
    ]
    for backend in (EKF, ISAM2):
        own = of(long, backend)
        figures += [_growth(backend, own), _memory(backend, own)]
    return [*figures, _exponent(costs)]


def _p99(name: str, rows: Sequence[RunRow], limit_ms: float) -> Figure:
    target = f"≤ {limit_ms:g} ms"
    laps = [lap for row in rows for lap in row.laps]
    if not laps:
        return not_measured(name, target)
    worst = max(lap.p99_ms for lap in laps)
    median = float(np.median([lap.p50_ms for lap in laps]))
    greatest = max(lap.max_ms for lap in laps)
    measured = f"{worst:.2f} ms (median {median:.2f}, max {greatest:.1f})"
    found = {"p99_ms": worst, "p50_ms": median, "max_ms": greatest}
    return Figure(name, target, measured, worst <= limit_ms, found)


def _growth(backend: str, rows: Sequence[RunRow]) -> Figure:
    name = f"{backend}: frame p99, lap {LONG_LAPS} / lap 1"
    p99 = _by_lap(rows, "p99_ms")
    if not {1, LONG_LAPS} <= p99.keys():
        return not_measured(name, "≤ 1.2")
    ratio = p99[LONG_LAPS] / p99[1]
    return Figure(name, "≤ 1.2", f"{ratio:.2f}", ratio <= 1.2, {"ratio": ratio})


def _memory(backend: str, rows: Sequence[RunRow]) -> Figure:
    name = f"{backend}: peak memory, lap {LONG_LAPS} / lap 2"
    peak = _by_lap(rows, "peak_mb")
    if not {2, LONG_LAPS} <= peak.keys():
        return not_measured(name, "≤ 1.5")
    ratio = peak[LONG_LAPS] / peak[2]
    measured = f"{ratio:.2f} ({peak[2]:.0f} → {peak[LONG_LAPS]:.0f} MB)"
    found = {"ratio": ratio, "lap_2_mb": peak[2], "last_mb": peak[LONG_LAPS]}
    return Figure(name, "≤ 1.5", measured, ratio <= 1.5, found)


def _by_lap(rows: Sequence[RunRow], what: str) -> dict[int, float]:
    return {lap.number: float(getattr(lap, what)) for row in rows for lap in row.laps}


def _exponent(costs: Sequence[CostRow]) -> Figure:
    """Fit ``ms = a n^p``, so that p is the slope in logarithms."""
    name, target = "EKF: frame time over n cones, exponent", "≤ 2.2"
    known = sorted((row.cones, row.frame_ms) for row in costs if not row.reason)
    if len(known) < 2:
        return not_measured(name, target)
    n, ms = np.log(np.array(known)).T
    slope = float(np.polyfit(n, ms, 1)[0])
    times = ", ".join(f"{ms:.2f} ms at {n}" for n, ms in known)
    return Figure(name, target, f"{slope:.2f} ({times})", slope <= 2.2, {"p": slope})
