"""Figures of how near maps come to the truth and to the optimum."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from conegraph.bench.figure import (
    Figure,
    at_least,
    at_most,
    none_of,
    not_measured,
)
from conegraph.bench.plan import (
    ACCURACY,
    KNOWN,
    KNOWN_IDS,
    REAL,
    STRESS,
    STRESS_KNOWN,
)
from conegraph.bench.rows import ReferenceRow, RunRow

EKF, ISAM2 = "ekf", "isam2"
MAP_LIMIT = {
    (EKF, False): 1.5,
    (EKF, True): 1.1,
    (ISAM2, False): 1.1,
    (ISAM2, True): 1.05,
}


def accuracy_figures(
    runs: Sequence[RunRow], references: Sequence[ReferenceRow]
) -> list[Figure]:
    """Return the figures of maps, of associations and of robustness."""
    plain = in_group(runs, ACCURACY)
    return [
        *_optimum(references),
        *_headline(plain),
        *_association(runs),
        *_completeness(runs),
        *_robustness(runs),
        *_map_by_sensor(plain),
        *_real(in_group(runs, REAL)),
    ]


def in_group(runs: Iterable[RunRow], group: str) -> list[RunRow]:
    """Return the runs of a group."""
    return [run for run in runs if run.job.group == group]


def of(
    runs: Iterable[RunRow],
    backend: str,
    sensor: str | None = None,
    odometry: bool | None = None,
) -> list[RunRow]:
    """Return the runs of a back end, of a sensor, with or without odometry."""
    return [
        run
        for run in runs
        if run.job.backend == backend
        and sensor in (None, run.job.stream.sensor)
        and odometry in (None, run.job.stream.odometry)
    ]


def _optimum(references: Sequence[ReferenceRow]) -> list[Figure]:
    """Check the yardstick: squared ratios to the bound have mean 1 and a known spread.

    The bound takes the motion model for true, and the simulator's car is steadier
    than that, so that with odometry the ratio may be below.
    """
    name = "batch optimum / Cramér-Rao bound, map RMSE aligned, rms over streams"
    solved = [row for row in references if not row.reason]
    if not solved:
        return [not_measured(name, "≈ 1")]
    squared = np.array([(row.map_rmse_m / row.map_bound_m) ** 2 for row in solved])
    spread = np.array([row.map_bound_sigma for row in solved])
    sigma = float(np.sqrt(np.sum(spread**2)) / len(solved))
    low, high = np.sqrt(max(1 - 2 * sigma, 0.0)), np.sqrt(1 + 2 * sigma)
    ratio = float(np.sqrt(squared.mean()))
    target = f"{low:.2f} to {high:.2f} (95 %)"
    found = {"ratio": ratio, "low": float(low), "high": float(high)}
    measured = f"{ratio:.3g} (n {len(solved)})"
    return [Figure(name, target, measured, bool(low <= ratio <= high), found)]


def _headline(plain: Sequence[RunRow]) -> list[Figure]:
    """Return the map's ratios on the camera without odometry."""
    ekf, isam2 = (of(plain, b, "camera", False) for b in (EKF, ISAM2))
    what = "map RMSE aligned / batch optimum, camera, vision only"
    numbers = sorted({lap.number for run in isam2 for lap in run.laps})
    by_lap = [
        at_most(
            f"iSAM2: {what}, at the end of lap {n}",
            [
                lap.map_rmse_m / lap.batch_rmse_m
                for run in isam2
                for lap in run.laps
                if lap.number == n
            ],
            1.05,
        )
        for n in numbers
    ]
    return [
        at_most(f"EKF: {what}, final", [run.map_ratio for run in ekf], 1.1),
        *by_lap,
        at_most(f"iSAM2: {what}, final", [run.map_ratio for run in isam2], 1.01),
    ]


def _association(runs: Sequence[RunRow]) -> list[Figure]:
    figures = []
    for backend in (EKF, ISAM2):
        for unknown, known, what in (
            (ACCURACY, KNOWN, "right colours"),
            (STRESS, STRESS_KNOWN, "2 % wrong and 20 % unknown colours"),
        ):
            with_ids = {
                run.job.stream: run.map_rmse_m
                for run in of(in_group(runs, known), backend)
            }
            ratios = [
                run.map_rmse_m / with_ids[run.job.stream]
                for run in of(in_group(runs, unknown), backend)
                if run.job.stream in with_ids
            ]
            name = f"{backend}: map RMSE, unknown / known association, {what}"
            figures.append(at_most(name, ratios, 1.1))
    return figures


def _completeness(runs: Sequence[RunRow]) -> list[Figure]:
    """Return shares of cones over all unknown associations, means of runs."""
    figures = []
    for backend in (EKF, ISAM2):
        rows = of([*in_group(runs, ACCURACY), *in_group(runs, STRESS)], backend)
        ended = [run for run in rows if not run.reason]
        precision = [run.precision for run in rows]
        recall = [run.recall for run in rows]
        figures += [
            at_least(f"{backend}: cone precision, mean of runs", precision, 0.99),
            at_least(f"{backend}: cone recall, mean of runs", recall, 0.99),
            none_of(f"{backend}: duplicates", [run.duplicates for run in ended]),
            none_of(
                f"{backend}: false closures", [run.false_closures for run in ended]
            ),
            _closures(f"{backend}: closures within 1 s of the start line", ended),
        ]
    return figures


def _closures(name: str, rows: Sequence[RunRow]) -> Figure:
    due = sum(run.closures_due for run in rows)
    if due == 0:
        return not_measured(name, "≥ 0.95")
    share = sum(run.closures_in_time for run in rows) / due
    found = {"share": share, "due": float(due)}
    return Figure(name, "≥ 0.95", f"{share:.3f} (of {due})", share >= 0.95, found)


def _robustness(runs: Sequence[RunRow]) -> list[Figure]:
    figures = []
    for backend in (EKF, ISAM2):
        for group, what in ((ACCURACY, "all streams"), (STRESS, "with colour errors")):
            rows = of(in_group(runs, group), backend)
            name = f"{backend}: divergences, {what}"
            figures.append(none_of(name, [int(run.diverged) for run in rows]))
    return figures


def _map_by_sensor(plain: Sequence[RunRow]) -> list[Figure]:
    return [
        at_most(
            f"{backend}: map RMSE aligned / batch, {sensor}, {drive_of(odometry)}, "
            "final",
            [run.map_ratio for run in of(plain, backend, sensor, odometry)],
            MAP_LIMIT[backend, odometry],
        )
        for backend in (EKF, ISAM2)
        for odometry in (False, True)
        for sensor in ("camera", "lidar")
    ]


def drive_of(odometry: bool) -> str:
    """Return what a drive had to go by, in words."""
    return "with odometry" if odometry else "vision only"


def _real(rows: Sequence[RunRow]) -> list[Figure]:
    """Return the ratio of unknown to known ids on the real robots."""
    figures = []
    for backend in (EKF, ISAM2):
        own = of(rows, backend)
        known = {r.job.stream: r for r in own if r.job.settings[-1:] == KNOWN_IDS}
        pairs = [
            (run, known[run.job.stream])
            for run in own
            if run.job.settings[-1:] != KNOWN_IDS and run.job.stream in known
        ]
        for what, ratios in (
            ("map RMSE", [a.map_rmse_m / b.map_rmse_m for a, b in pairs]),
            ("causal ATE", [a.ate_m / b.ate_m for a, b in pairs]),
        ):
            name = f"{backend}: MRCLAM 6, robots 1 to 3, {what}, unknown / known"
            figures.append(at_most(name, ratios, 1.1))
    return figures
