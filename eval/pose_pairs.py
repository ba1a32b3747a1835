"""Estimated poses beside the true ones of the same time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import align_first_pose, distance
from conegraph.geometry import compose, wrap_angle
from conegraph.types import Array, IntArray, Trajectory

MAX_TRUTH_GAP_S = 0.5


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


def path_length(xy_m: Array) -> Array:
    """Return the distance driven up to each point (N, 2), starting at 0."""
    steps = distance(xy_m[1:], xy_m[:-1])
    return np.concatenate([np.zeros(min(len(xy_m), 1)), np.cumsum(steps)])


def starts_together(pairs: PosePairs) -> Array:
    """Return the estimated poses (N, 3) moved so that the first is the true one."""
    pose = align_first_pose(pairs.estimate[0], pairs.truth[0])
    return compose(pose, pairs.estimate)
