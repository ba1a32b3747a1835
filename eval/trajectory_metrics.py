"""How far a path is from the true one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import align_first_pose, align_se2, distance, rms
from conegraph.eval.pose_pairs import (
    MAX_TRUTH_GAP_S,
    pair_with_truth,
    path_length,
    starts_together,
)
from conegraph.eval.record import Record
from conegraph.eval.relative_error import (
    IntervalError,
    SegmentError,
    interval_error,
    segment_error,
)
from conegraph.geometry import compose, wrap_angle
from conegraph.types import Array, Trajectory

DEFAULT_SEGMENTS_M = (1.0, 10.0)
DEFAULT_INTERVALS_S = (1.0, 10.0)
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class ErrorStats(Record):
    """Distances in m: root mean square, mean, median and greatest."""

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class TrajectoryMetrics(Record):
    """Errors of one path against the truth, interpolated at the path's stamps.

    The absolute trajectory error (ATE) is the distance between estimated and true
    positions (Sturm et al. 2012).

    Attributes:
        poses: estimates that were compared.
        left_out: estimates outside the truth's span or in one of its gaps.
        path_m: length of the true path at the compared stamps, m.
        duration_s: from the first to the last compared stamp, s.
        ate_as_written: as both were written down; means something only where the
            run worked in the truth's own frame, as in localising in a given map.
        ate_first_pose: with the first compared poses brought to coincide; what a
            run that starts at its own origin has drifted.
        ate_se2: after the rotation and translation that fit the whole path best.
        yaw_rmse_deg: root mean square heading error after the SE(2) alignment.
        rpe: relative pose errors per metre, one entry a segment length.
        rpe_time: relative pose errors per second, one entry a duration.
        final_drift_m: distance at the last pose, aligned by the first pose.
        final_drift_percent: the same in percent of `path_m`.
        pose_truth_start: (3,) the run's frame in the truth's, by the first pose.
        pose_truth_run: (3,) the run's frame in the truth's, by SE(2) alignment.
    """

    poses: int
    left_out: int
    path_m: float
    duration_s: float
    ate_as_written: ErrorStats
    ate_first_pose: ErrorStats
    ate_se2: ErrorStats
    yaw_rmse_deg: float
    rpe: tuple[SegmentError, ...]
    rpe_time: tuple[IntervalError, ...]
    final_drift_m: float
    final_drift_percent: float
    pose_truth_start: Array
    pose_truth_run: Array


def error_stats(errors_m: Array) -> ErrorStats:
    """Summarise distances (N,); all NaN without any."""
    if len(errors_m) == 0:
        return ErrorStats(_NAN, _NAN, _NAN, _NAN)
    return ErrorStats(
        rmse_m=rms(errors_m),
        mean_m=float(np.mean(errors_m)),
        median_m=float(np.median(errors_m)),
        max_m=float(np.max(errors_m)),
    )


def trajectory_metrics(
    estimate: Trajectory,
    truth: Trajectory,
    *,
    segments_m: tuple[float, ...] = DEFAULT_SEGMENTS_M,
    intervals_s: tuple[float, ...] = DEFAULT_INTERVALS_S,
    max_gap_s: float = MAX_TRUTH_GAP_S,
) -> TrajectoryMetrics | None:
    """Compare a path with the truth; None where they have no stamp in common."""
    pairs = pair_with_truth(estimate, truth, max_gap_s)
    if len(pairs.stamp_s) == 0:
        return None
    true_xy, xy = pairs.truth[:, :2], pairs.estimate[:, :2]
    start_pose = align_first_pose(pairs.estimate[0], pairs.truth[0])
    best_pose = align_se2(xy, true_xy).pose
    fitted = compose(best_pose, pairs.estimate)
    drift = distance(starts_together(pairs)[:, :2], true_xy)
    path_m = float(path_length(true_xy)[-1])
    return TrajectoryMetrics(
        poses=len(pairs.stamp_s),
        left_out=pairs.left_out,
        path_m=path_m,
        duration_s=float(pairs.stamp_s[-1] - pairs.stamp_s[0]),
        ate_as_written=error_stats(distance(xy, true_xy)),
        ate_first_pose=error_stats(drift),
        ate_se2=error_stats(distance(fitted[:, :2], true_xy)),
        yaw_rmse_deg=float(
            np.rad2deg(rms(wrap_angle(fitted[:, 2] - pairs.truth[:, 2])))
        ),
        rpe=tuple(segment_error(pairs, length) for length in segments_m),
        rpe_time=tuple(interval_error(pairs, duration) for duration in intervals_s),
        final_drift_m=float(drift[-1]),
        final_drift_percent=100.0 * float(drift[-1]) / path_m if path_m > 0 else _NAN,
        pose_truth_start=start_pose,
        pose_truth_run=best_pose,
    )
