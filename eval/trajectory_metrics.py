"""How far a path is from the true one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import align_first_pose, align_se2, distance, rms
from conegraph.eval.record import Record
from conegraph.geometry import between, compose, wrap_angle
from conegraph.types import Array, IntArray, Trajectory

MAX_TRUTH_GAP_S = 0.5
DEFAULT_SEGMENTS_M = (1.0, 10.0)
DEFAULT_INTERVALS_S = (1.0, 10.0)
SEGMENT_TOLERANCE = 0.1
STAMP_ROUNDING_S = 1e-6
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class ErrorStats(Record):
    """Distances in m: root mean square, mean, median and greatest."""

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class SegmentError(Record):
    """Relative pose error (RPE) over all segments of one length of true path.

    With P the true and Q the estimated pose at a segment's two ends, the error is
    E = (P_i^-1 P_j)^-1 (Q_i^-1 Q_j). It does not depend on any alignment.

    Attributes:
        length_m: length of true path that a segment spans, within 10 %.
        rmse_m: root mean square of the translation of E, m.
        per_metre: `rmse_m` divided by `length_m`, m per m.
        yaw_rmse_deg: root mean square of the rotation of E, degrees.
        segments: how many there are; one starts at each estimate that has an end.

    Source: J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM
    systems", IROS 2012, with segments by path length as in A. Geiger et al., "Are
    we ready for autonomous driving?", CVPR 2012.
    """

    length_m: float
    rmse_m: float
    per_metre: float
    yaw_rmse_deg: float
    segments: int


@dataclass(frozen=True, slots=True)
class IntervalError(Record):
    """Relative pose error, as in `SegmentError`, over all intervals of one duration.

    Attributes:
        duration_s: time that an interval spans, within 10 %.
        rmse_m: root mean square of the translation of E, m.
        per_second: `rmse_m` divided by `duration_s`, m per s.
        yaw_rmse_deg: root mean square of the rotation of E, degrees.
        intervals: how many there are; one starts at each estimate that has an end.

    Source: J. Sturm et al., IROS 2012, whose RPE is one of drift per second.
    """

    duration_s: float
    rmse_m: float
    per_second: float
    yaw_rmse_deg: float
    intervals: int


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


@dataclass(frozen=True, slots=True)
class PosePairs:
    """Estimated and true poses at common stamps.

    Attributes:
        stamp_s: (N,) the stamps of the estimate that have a truth.
        estimate: (N, 3) estimated poses.
        truth: (N, 3) true poses.
        stretch: (N,) number of the stretch of truth without a gap.
        left_out: estimates that have no truth.
    """

    stamp_s: Array
    estimate: Array
    truth: Array
    stretch: IntArray
    left_out: int


def pair_with_truth(
    estimate: Trajectory, truth: Trajectory, max_gap_s: float = MAX_TRUTH_GAP_S
) -> PosePairs:
    """Interpolate the truth at the estimate's stamps.

    Positions linearly, yaw along the shorter arc. Stamps outside the truth's span,
    and stamps strictly inside a gap of more than ``max_gap_s``, have no truth.
    """
    t = estimate.stamp_s
    if len(truth) == 0 or len(t) == 0:
        none = np.zeros((0, 3))
        return PosePairs(t[:0], none, none, np.zeros(0, dtype=np.int64), len(t))
    stamps = truth.stamp_s
    inside = (t >= stamps[0]) & (t <= stamps[-1])
    gap = np.diff(stamps) > max_gap_s
    gap_start, gap_end = stamps[:-1][gap], stamps[1:][gap]
    begun = np.searchsorted(gap_start, t, side="left")
    ended = np.searchsorted(gap_end, t, side="right")
    keep = inside & (begun == ended)
    x, y = (np.interp(t[keep], stamps, truth.pose[:, k]) for k in (0, 1))
    yaw = np.interp(t[keep], stamps, np.unwrap(truth.pose[:, 2]))
    return PosePairs(
        stamp_s=t[keep],
        estimate=estimate.pose[keep],
        truth=np.stack([x, y, wrap_angle(yaw)], axis=-1),
        stretch=ended[keep].astype(np.int64),
        left_out=int(np.count_nonzero(~keep)),
    )


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


def path_length(xy_m: Array) -> Array:
    """Return the distance driven up to each point (N, 2), starting at 0."""
    steps = distance(xy_m[1:], xy_m[:-1])
    return np.concatenate([np.zeros(min(len(xy_m), 1)), np.cumsum(steps)])


def starts_together(pairs: PosePairs) -> Array:
    """Return the estimated poses (N, 3) moved so that the first is the true one."""
    pose = align_first_pose(pairs.estimate[0], pairs.truth[0])
    return compose(pose, pairs.estimate)


def relative_error(pairs: PosePairs, i: IntArray, j: IntArray) -> Array:
    """Return E of `SegmentError` (K, 3) from the rows i (K,) to the rows j (K,)."""
    true_step = between(pairs.truth[i], pairs.truth[j])
    return between(true_step, between(pairs.estimate[i], pairs.estimate[j]))


def segment_error(pairs: PosePairs, length_m: float) -> SegmentError:
    """Return the relative pose error over segments of ``length_m`` of true path.

    From each pose the segment ends where the true path comes nearest to the length;
    ends that miss it by more than 10 %, or that lie beyond a gap in the truth, are
    left out.
    """
    i, j = _spans(path_length(pairs.truth[:, :2]), length_m, pairs.stretch)
    rmse_m, yaw_deg = _rms_error(pairs, i, j)
    return SegmentError(length_m, rmse_m, rmse_m / length_m, yaw_deg, len(i))


def interval_error(pairs: PosePairs, duration_s: float) -> IntervalError:
    """Return the relative pose error over intervals of ``duration_s``.

    Their ends are found as those of `segment_error` are, by time; what the end of the
    path cuts short is left out.
    """
    i, j = _spans(pairs.stamp_s, duration_s, pairs.stretch)
    whole = pairs.stamp_s[i] + duration_s <= pairs.stamp_s[-1:] + STAMP_ROUNDING_S
    i, j = i[whole], j[whole]
    rmse_m, yaw_deg = _rms_error(pairs, i, j)
    return IntervalError(duration_s, rmse_m, rmse_m / duration_s, yaw_deg, len(i))


def _spans(s: Array, length: float, stretch: IntArray) -> tuple[IntArray, IntArray]:
    """Return first and last rows of the spans of ``length`` along ascending s (N,)."""
    after = np.searchsorted(s, s + length)
    last = max(len(s) - 1, 0)
    later, sooner = np.minimum(after, last), np.minimum(after - 1, last)
    start = np.arange(len(s))
    overshoot, shortfall = s[later] - (s + length), (s + length) - s[sooner]
    end = np.where(overshoot < shortfall, later, sooner)
    fits = np.abs(s[end] - s - length) <= SEGMENT_TOLERANCE * length
    fits &= (end > start) & (stretch[end] == stretch[start])
    return start[fits], end[fits]


def _rms_error(pairs: PosePairs, i: IntArray, j: IntArray) -> tuple[float, float]:
    """Return the RMS translation (m) and rotation (degrees) of relative errors."""
    error = relative_error(pairs, i, j)
    return rms(np.hypot(error[:, 0], error[:, 1])), float(np.rad2deg(rms(error[:, 2])))


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
