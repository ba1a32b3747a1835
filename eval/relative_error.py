"""How much error a path gathers over a metre, a second, a lap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import rms
from conegraph.eval.pose_pairs import PosePairs, path_length
from conegraph.eval.record import Record
from conegraph.geometry import between
from conegraph.types import Array, IntArray

SEGMENT_TOLERANCE = 0.1
STAMP_ROUNDING_S = 1e-6


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
