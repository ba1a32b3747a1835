"""Runs side by side, row by row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from conegraph.eval.judge import RunMetrics
from conegraph.eval.record import Record
from conegraph.eval.verdict import differ, findings
from conegraph.io.plain import Plain

Better = Literal["low", "high"] | None


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that a report shows.

    Attributes:
        group: what it belongs to, such as ``Map``.
        label: what it is.
        unit: its unit, empty for counts and shares.
        digits: decimals to show.
        better: which direction is better, None if neither is as such.
        path: where `RunMetrics.to_dict` has it, keys joined by dots.
    """

    group: str
    label: str
    unit: str
    digits: int
    better: Better
    path: str

    @property
    def is_share(self) -> bool:
        """Whether it lies between 0 and 1."""
        return not self.unit and self.digits > 2


_MAP, _PATH, _SMOOTHED = "Map", "Path while driving", "Path, smoothed"
_CLOSE, _STATUS, _TIME = "Laps and loop closures", "Status", "Time per frame"
_HONEST, _TRACK, _COST = "Error² / covariance, 1 is right", "Track", "Cost"
FIGURES: tuple[Figure, ...] = (
    Figure(_MAP, "RMSE, aligned", "m", 3, "low", "map.rmse_aligned_m"),
    Figure(_MAP, "RMSE, start frame", "m", 3, "low", "map.start_frame.rmse_m"),
    Figure(_MAP, "greatest error, aligned", "m", 3, "low", "map.max_aligned_m"),
    Figure(_MAP, "precision", "", 3, "high", "map.precision"),
    Figure(_MAP, "recall, observable cones", "", 3, "high", "map.recall"),
    Figure(_MAP, "recall, all cones", "", 3, "high", "map.recall_all"),
    Figure(_MAP, "duplicates", "", 0, "low", "map.duplicates"),
    Figure(_MAP, "false cones", "", 0, "low", "map.false_cones"),
    Figure(_MAP, "colour errors", "", 0, "low", "map.colour.errors"),
    Figure(_MAP, "orange size confused", "", 0, "low", "map.colour.orange_size"),
    Figure(_MAP, "colour left unknown", "", 0, "low", "map.colour.unknown"),
    Figure(_MAP, "nearest RMSE (lenient)", "m", 3, None, "map.lenient_nearest_rmse_m"),
    Figure(_PATH, "ATE, aligned", "m", 3, "low", "trajectory.ate_se2.rmse_m"),
    Figure(
        _PATH, "ATE from first pose", "m", 3, "low", "trajectory.ate_first_pose.rmse_m"
    ),
    Figure(_PATH, "ATE as written", "m", 3, None, "trajectory.ate_as_written.rmse_m"),
    Figure(_PATH, "yaw error, aligned", "deg", 2, "low", "trajectory.yaw_rmse_deg"),
    Figure(_PATH, "RPE over 1 m", "m", 4, "low", "trajectory.rpe.0.rmse_m"),
    Figure(_PATH, "RPE over 10 m", "m", 3, "low", "trajectory.rpe.1.rmse_m"),
    Figure(_PATH, "RPE over 1 s", "m", 4, "low", "trajectory.rpe_time.0.rmse_m"),
    Figure(_PATH, "final drift", "%", 2, "low", "trajectory.final_drift_percent"),
    Figure(_SMOOTHED, "ATE, aligned", "m", 3, "low", "smoothed.ate_se2.rmse_m"),
    Figure(
        _SMOOTHED,
        "ATE from first pose",
        "m",
        3,
        "low",
        "smoothed.ate_first_pose.rmse_m",
    ),
    Figure(_SMOOTHED, "yaw error, aligned", "deg", 2, "low", "smoothed.yaw_rmse_deg"),
    Figure(_HONEST, "pose", "", 2, None, "pose_consistency.nees_per_dof"),
    Figure(_HONEST, "map", "", 2, None, "map.nees_per_dof"),
    Figure(_HONEST, "innovations", "", 2, None, "innovation_consistency.nis_per_dof"),
    Figure(_TRACK, "road shared, IoU", "", 3, "high", "track.road_iou"),
    Figure(_TRACK, "edges right", "", 3, "high", "track.edges_right"),
    Figure(_TRACK, "centre line off", "m", 3, "low", "track.lateral_rmse_m"),
    Figure("Association", "precision", "", 4, "high", "association.precision"),
    Figure("Association", "recall", "", 4, "high", "association.recall"),
    Figure("Association", "split cones", "", 0, "low", "association.split_cones"),
    Figure(_CLOSE, "laps driven", "", 0, None, "closures.laps_true"),
    Figure(_CLOSE, "laps counted", "", 0, None, "closures.laps"),
    Figure(_CLOSE, "lap time error", "s", 3, "low", "closures.lap_time_error_s"),
    Figure(_CLOSE, "drift a lap", "m", 3, "low", "lap_drift.rms_m"),
    Figure(_CLOSE, "lap ends closed in time", "", 0, "high", "closures.in_time"),
    Figure(_CLOSE, "closure delay, median", "s", 2, None, "closures.delay_s"),
    Figure(_CLOSE, "closure precision", "", 3, "high", "closures.precision"),
    Figure(_CLOSE, "closures accepted", "", 0, None, "closures.accepted"),
    Figure(_CLOSE, "closures rejected", "", 0, None, "closures.rejected"),
    Figure(_STATUS, "frames", "", 0, None, "status.frames"),
    Figure(_STATUS, "frames DEGRADED", "", 0, "low", "status.by_status.DEGRADED"),
    Figure(_STATUS, "frames LOST", "", 0, "low", "status.by_status.LOST"),
    Figure(_STATUS, "resets", "", 0, "low", "status.resets"),
    Figure(_TIME, "p50", "ms", 2, "low", "latency_ms.frame.p50"),
    Figure(_TIME, "p95", "ms", 2, "low", "latency_ms.frame.p95"),
    Figure(_TIME, "p99", "ms", 2, "low", "latency_ms.frame.p99"),
    Figure(_TIME, "max", "ms", 2, "low", "latency_ms.frame.max"),
    Figure(_TIME, "finding cones first, p50", "ms", 2, None, "latency_ms.detect.p50"),
    Figure(_COST, "faster than the stream", "x", 1, "high", "cost.real_time_factor"),
    Figure(_COST, "p99, last lap / first", "", 2, "low", "cost.p99_growth"),
    Figure(_COST, "peak memory so far", "MiB", 0, None, "cost.peak_memory_mb"),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of all runs: values in the order of the runs, None where missing."""

    figure: Figure
    values: tuple[float | None, ...]

    @property
    def title(self) -> str:
        """The label with its unit."""
        unit = self.figure.unit
        return f"{self.figure.label} [{unit}]" if unit else self.figure.label

    @property
    def cells(self) -> tuple[str, ...]:
        """The values as text, a dash where there is none."""
        digits = self.figure.digits
        return tuple("-" if v is None else f"{v:.{digits}f}" for v in self.values)

    @property
    def best(self) -> frozenset[int]:
        """Runs that stand out, by the rule of the verdict; empty where none does."""
        known = {i: value for i, value in enumerate(self.values) if value is not None}
        if self.figure.better is None or not known:
            return frozenset()
        unit, share = self.figure.unit, self.figure.is_share
        best = (min if self.figure.better == "low" else max)(known.values())
        level = {i for i, v in known.items() if not differ(v, best, unit, share=share)}
        return frozenset(level if len(level) < len(known) else ())


@dataclass(frozen=True, slots=True)
class Comparison(Record):
    """The runs side by side.

    Attributes:
        findings: what the runs show in sentences, effect first.
        names: the runs.
        rows: the figures that at least one run has.
        warnings: what is odd, with the run it concerns unless it concerns all.
        alarms: what makes the figures worth little, likewise; findings begin with it.
    """

    findings: tuple[str, ...]
    names: tuple[str, ...]
    rows: tuple[Row, ...]
    warnings: tuple[str, ...]
    alarms: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """All that the runs show."""
        return " ".join(self.findings)


def compare(metrics: Mapping[str, RunMetrics]) -> Comparison:
    """Put runs over the same stream side by side."""
    plain = {name: m.to_dict() for name, m in metrics.items()}
    rows = [
        Row(figure, tuple(_look_up(run, figure.path) for run in plain.values()))
        for figure in FIGURES
    ]
    alarms = _of_whom({name: m.alarms for name, m in metrics.items()})
    return Comparison(
        findings=(*(_ended(alarm) for alarm in alarms), *findings(metrics)),
        names=tuple(metrics),
        rows=tuple(row for row in rows if any(v is not None for v in row.values)),
        warnings=_of_whom({name: m.warnings for name, m in metrics.items()}),
        alarms=alarms,
    )


def _look_up(plain: Plain, path: str) -> float | None:
    value = plain
    for key in path.split("."):
        if isinstance(value, dict):
            value = value.get(key)
        elif isinstance(value, list):
            value = value[int(key)]
    return float(value) if isinstance(value, int | float) else None


def _ended(said: str) -> str:
    return said if said.endswith("?") else f"{said}."


def _of_whom(said: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Return each sentence once, with the runs it concerns unless it concerns all."""
    result = []
    for sentence in dict.fromkeys(s for sentences in said.values() for s in sentences):
        names = [name for name, sentences in said.items() if sentence in sentences]
        everyone = len(names) == len(said)
        result.append(sentence if everyone else f"{', '.join(names)}: {sentence}")
    return tuple(result)
