"""Figures of the pose while driving: its error, its bound, and its own sigma."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from conegraph.bench.accuracy_figures import EKF, ISAM2, drive_of, in_group, of
from conegraph.bench.figure import Figure, at_most, near_one
from conegraph.bench.plan import ACCURACY
from conegraph.bench.rows import ReferenceRow, RunRow
from conegraph.bench.worker import reference_of

HARD_SHARE = 0.25
EKF_POSE_LIMIT = {
    ("lidar", False): 3.0,
    ("camera", False): 5.0,
    ("lidar", True): 2.5,
    ("camera", True): 3.0,
}
ISAM2_POSE_SHARE = 0.8


def pose_figures(
    runs: Sequence[RunRow], references: Sequence[ReferenceRow]
) -> list[Figure]:
    """Return the figures of accuracy and consistency of the pose."""
    plain = in_group(runs, ACCURACY)
    return [
        *_ate(plain),
        *_consistency(plain),
        *_pose_by_sensor(plain, references),
    ]


def _ate(plain: Sequence[RunRow]) -> list[Figure]:
    """Return iSAM2's causal ATE over the EKF's, on hard streams and on all."""
    ekf = {run.job.stream: run.ate_2_laps_m for run in of(plain, EKF)}
    pairs = [
        (ekf[run.job.stream], run.ate_2_laps_m)
        for run in of(plain, ISAM2)
        if run.job.stream in ekf
    ]
    pairs.sort(key=lambda pair: -pair[0] if np.isfinite(pair[0]) else -np.inf)
    ratios = [isam2 / ekf for ekf, isam2 in pairs]
    hard = ratios[: int(np.ceil(HARD_SHARE * len(ratios)))]
    what = "iSAM2 causal ATE / EKF causal ATE over 2 laps"
    return [
        at_most(f"{what}, hardest quarter by EKF error", hard, 0.6),
        at_most(f"{what}, all streams", ratios, 1.0),
    ]


def _consistency(plain: Sequence[RunRow]) -> list[Figure]:
    """Return NEES with and without odometry apart: one may hide the other's.

    Where the sigma is the bound and NEES is not above one, no causal estimator can do
    better on average.
    """
    figures = []
    for backend in (EKF, ISAM2):
        for odometry in (False, True):
            rows = of(plain, backend, odometry=odometry)
            poses, maps = [r.pose_nees for r in rows], [r.map_nees for r in rows]
            how = drive_of(odometry)
            figures += [
                near_one(f"{backend}: pose NEES/dof, {how}", poses),
                near_one(f"{backend}: map NEES/dof, {how}", maps),
                near_one(
                    f"{backend}: sigma of the pose while driving / causal Cramér-Rao "
                    f"bound, {how}",
                    [r.sigma_over_bound for r in rows],
                ),
            ]
    return figures


def _pose_by_sensor(
    plain: Sequence[RunRow], references: Sequence[ReferenceRow]
) -> list[Figure]:
    """Return the ratio of the path while driving to the batch optimum's.

    Who looks back over the whole drive knows more than who drives: by how much, the
    two bounds say, and a target below their ratio asks for the impossible.
    """
    figures = []
    bounds = {row.key: row.causal_ratio for row in references if row.causal_bound_m}
    for (sensor, odometry), limit in EKF_POSE_LIMIT.items():
        name = f"pose RMSE while driving / batch, {sensor}, {drive_of(odometry)}"
        ekf = [run.pose_ratio for run in of(plain, EKF, sensor, odometry)]
        isam2 = [run.pose_ratio for run in of(plain, ISAM2, sensor, odometry)]
        figures.append(at_most(f"ekf: {name}", ekf, limit))
        goal = ISAM2_POSE_SHARE * EKF_POSE_LIMIT[sensor, False]
        figures.append(at_most(f"isam2: {name}", isam2, goal))
        keys = {reference_of(run.job).key for run in of(plain, EKF, sensor, odometry)}
        least = [bounds[key] for key in sorted(keys & bounds.keys())]
        title = f"Cramér-Rao bound: {name}"
        figures.append(replace(at_most(title, least, np.inf), target="", met=None))
    return figures
