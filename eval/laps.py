"""The laps that the car truly drove."""

from __future__ import annotations

import numpy as np

from conegraph.backends.laps import LapCounter
from conegraph.config import StartLineConfig
from conegraph.eval.pose_pairs import MAX_TRUTH_GAP_S, path_length
from conegraph.types import Array, IntArray, Lap, Trajectory

COARSE_S = 0.2
"""Poses away from the gate are looked at this often: they only have to be away."""


def true_laps(path: Trajectory, start_cones_m: Array) -> tuple[Lap, ...]:
    """Return the laps of a true path, timed as the back ends time theirs.

    The gate stands between the true start cones, or where back ends put it on tracks
    without any; crossings are interpolated between true poses (see `LapCounter`). No
    line is crossed in a gap of the truth.

    Args:
        path: true poses in the frame of the car at its start.
        start_cones_m: (k, 2) true start cones in the same frame.
    """
    counter = LapCounter(StartLineConfig())
    counter.locate_gate(start_cones_m)
    driven_m = path_length(path.pose[:, :2])
    looked_at = _looked_at(path, counter)
    laps = []
    before = 0
    for k in looked_at.tolist():
        if path.stamp_s[k] - path.stamp_s[max(k - 1, 0)] > MAX_TRUTH_GAP_S:
            counter.interrupt()
        moved_m = float(driven_m[k] - driven_m[before])
        laps.append(counter.advance(float(path.stamp_s[k]), path.pose[k], moved_m))
        before = k
    return tuple(lap for lap in laps if lap is not None)


def _looked_at(path: Trajectory, counter: LapCounter) -> IntArray:
    """Return the rows on both sides of each crossing and gap, and some between."""
    n = len(path)
    if n == 0:
        return np.zeros(0, dtype=np.int64)
    gate = counter.gate
    behind = (path.pose[:, :2] - gate.middle_m) @ gate.forward < 0.0
    gap = np.diff(path.stamp_s) > MAX_TRUTH_GAP_S
    ends = np.flatnonzero((behind[:-1] & ~behind[1:]) | gap)
    step = np.floor((path.stamp_s - path.stamp_s[0]) / COARSE_S)
    coarse = np.unique(step, return_index=True)[1]
    return np.unique(np.concatenate([ends, ends + 1, coarse])).astype(np.int64)
