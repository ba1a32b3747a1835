"""The figures of a run that a suite compares, and when a run counts as failed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from conegraph.io.plain import Plain

DIVERGED_M = 2.0
"""A causal pose that is ever this far off, in the start frame, has lost the track."""

LEAST_PRECISION = 0.9
"""A map with more than a tenth of false cones cannot be driven by."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A column of results.

    Attributes:
        name: of the column, with its unit.
        label: what it is, in words.
        unit: its unit, empty for counts and shares.
        digits: decimals to show.
        better: which direction is better, None if neither is as such.
        path: where a run's summary and judgement have it, keys joined by dots.
        effect: whether two back ends differ by a ``ratio`` (errors, times) or by a
            ``difference`` (shares, counts), None if they are not compared.
        varies: whether another run with the same seed gives another value.
    """

    name: str
    label: str
    unit: str
    digits: int
    better: Literal["low", "high"] | None
    path: str
    effect: Literal["ratio", "difference"] | None
    varies: bool = False

    def of(self, plain: Plain) -> float:
        """Look it up in nested dicts and lists; NaN where it is missing."""
        value = plain
        for key in self.path.split("."):
            if isinstance(value, dict):
                value = value.get(key)
            elif isinstance(value, list) and int(key) < len(value):
                value = value[int(key)]
            else:
                return math.nan
        return float(value) if isinstance(value, int | float) else math.nan


def _error(name: str, label: str, digits: int, path: str, unit: str = "m") -> Metric:
    return Metric(name, label, unit, digits, "low", path, "ratio")


def _share(name: str, label: str, path: str) -> Metric:
    return Metric(name, label, "", 3, "high", path, "difference")


def _count(name: str, label: str, path: str, compared: bool = False) -> Metric:
    effect: Literal["difference"] | None = "difference" if compared else None
    return Metric(name, label, "", 0, "low" if compared else None, path, effect)


def _scale(name: str, label: str, path: str) -> Metric:
    return Metric(name, label, "", 2, None, path, None)


def _cost(name: str, label: str, unit: str, path: str) -> Metric:
    return Metric(name, label, unit, 2, "low", path, "ratio", varies=True)


METRICS: tuple[Metric, ...] = (
    _error("map_rmse_aligned_m", "map RMSE, aligned", 4, "map.rmse_aligned_m"),
    _error("map_rmse_start_m", "map RMSE, start frame", 4, "map.start_frame.rmse_m"),
    _error(
        "ate_aligned_m", "path while driving, aligned", 4, "trajectory.ate_se2.rmse_m"
    ),
    _error(
        "ate_start_m",
        "path while driving, start frame",
        4,
        "trajectory.ate_first_pose.rmse_m",
    ),
    _error("yaw_rmse_deg", "heading", 3, "trajectory.yaw_rmse_deg", "deg"),
    _error("rpe_10m_m", "drift over 10 m", 4, "trajectory.rpe.1.rmse_m"),
    _share("precision", "cone precision", "map.precision"),
    _share("recall", "cone recall", "map.recall"),
    _count("duplicates", "duplicate cones", "map.duplicates", compared=True),
    _count("false_cones", "false cones", "map.false_cones", compared=True),
    _count("colour_errors", "colour errors", "map.colour.errors", compared=True),
    _scale("nees_pose", "pose NEES per dof", "pose_consistency.nees_per_dof"),
    _scale("nees_map", "map NEES per dof", "map.start_frame.nees_per_dof"),
    _scale("nis", "NIS per dof", "consistency.nis_per_dof"),
    _count("laps_true", "laps driven", "closures.laps_true"),
    _count("laps_counted", "laps counted", "closures.laps"),
    _count("closures_accepted", "closures accepted", "closures.accepted"),
    _count("closures_in_time", "lap ends closed in time", "closures.in_time"),
    Metric(
        "closure_precision",
        "closure precision",
        "",
        3,
        "high",
        "closures.precision",
        None,
    ),
    Metric(
        "pose_max_m",
        "greatest error, start frame",
        "m",
        3,
        "low",
        "trajectory.ate_first_pose.max_m",
        None,
    ),
    _count("frames", "frames", "status.frames"),
    _count("cones_true", "true cones", "map.true"),
    _count("cones_observable", "cones that recall asks for", "map.observable"),
    _count("cones_map", "cones in the map", "map.estimated"),
    _cost("frame_p50_ms", "frame, median", "ms", "latency_ms.frame.p50"),
    _cost("frame_p95_ms", "frame, p95", "ms", "latency_ms.frame.p95"),
    _cost("frame_p99_ms", "frame, p99", "ms", "latency_ms.frame.p99"),
    _cost("frame_max_ms", "frame, longest", "ms", "latency_ms.frame.max"),
    Metric(
        "real_time_factor",
        "times faster than the stream",
        "",
        1,
        "high",
        "cost.real_time_factor",
        "ratio",
        varies=True,
    ),
    _cost("cpu_s", "processor time of the run", "s", "cpu_s"),
    _cost("wall_s", "time of the run", "s", "wall_s"),
    _cost("peak_mb", "memory that the run added", "MB", "peak_mb"),
)
"""The columns, in the order in which they are shown."""

MAIN = ("map_rmse_aligned_m", "ate_start_m", "recall", "frame_p99_ms")
"""What a verdict speaks of. They are tested as a family of their own, so that looking
at all the others as well costs no certainty about these."""

BY_NAME: Mapping[str, Metric] = {metric.name: metric for metric in METRICS}


def why_failed(metrics: Mapping[str, float]) -> str:
    """Return why a run that came to its end is of no use, empty if it is.

    It is not if the pose was ever off by 2 m or more (diverged), if more than a tenth
    of the map is false, or if a lap was not counted. What is not a number is no
    success, but a stream without laps has none to miss.
    """
    if not metrics["pose_max_m"] < DIVERGED_M:
        return f"diverged: {metrics['pose_max_m']:.1f} m off"
    if not metrics["precision"] >= LEAST_PRECISION:
        return f"map precision {metrics['precision']:.3f}"
    if metrics["laps_counted"] < metrics["laps_true"]:
        missed = metrics["laps_true"] - metrics["laps_counted"]
        return f"{missed:.0f} of {metrics['laps_true']:.0f} laps missed"
    return ""
