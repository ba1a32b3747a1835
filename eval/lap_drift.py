"""How much error each lap adds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import distance, rms
from conegraph.eval.pose_pairs import PosePairs, path_length, starts_together
from conegraph.eval.record import Record
from conegraph.eval.relative_error import relative_error
from conegraph.types import Array, IntArray, Lap


@dataclass(frozen=True, slots=True)
class LapDrift(Record):
    """The error of one lap.

    Attributes:
        number: of the lap, from 1.
        length_m: of the true path, m.
        drift_m: translation of the relative pose error (see `SegmentError`) from the
            first to the last pose of the lap, m.
        drift_percent: the same in percent of `length_m`.
        drift_yaw_deg: its rotation, degrees, counter-clockwise.
        max_error_m: greatest distance to the true car in the lap, the paths brought
            to coincide at the start of the run, m.
    """

    number: int
    length_m: float
    drift_m: float
    drift_percent: float
    drift_yaw_deg: float
    max_error_m: float


@dataclass(frozen=True, slots=True)
class LapDrifts(Record):
    """The drift of a run, lap by lap.

    Attributes:
        rms_m: RMS of the laps' `LapDrift.drift_m`, m per lap.
        rms_percent: RMS of their `LapDrift.drift_percent`.
        laps: lap by lap.

    Source: relative errors over long segments as in A. Geiger et al., "Are we ready
    for autonomous driving?", CVPR 2012, with the lap as the segment.
    """

    rms_m: float
    rms_percent: float
    laps: tuple[LapDrift, ...]


def lap_drifts(pairs: PosePairs, laps: Sequence[Lap]) -> LapDrifts | None:
    """Return the drift over each true lap; None without a lap that has two poses."""
    driven_m = path_length(pairs.truth[:, :2])
    off_m = distance(starts_together(pairs)[:, :2], pairs.truth[:, :2])
    first = np.searchsorted(pairs.stamp_s, [lap.start_s for lap in laps])
    last = np.searchsorted(pairs.stamp_s, [lap.end_s for lap in laps], "right") - 1
    found = [
        _drift(lap.number, pairs, driven_m, off_m, np.arange(i, j + 1))
        for lap, i, j in zip(laps, first.tolist(), last.tolist(), strict=True)
        if i < j
    ]
    if not found:
        return None
    return LapDrifts(
        rms(np.array([lap.drift_m for lap in found])),
        rms(np.array([lap.drift_percent for lap in found])),
        tuple(found),
    )


def _drift(
    number: int, pairs: PosePairs, driven_m: Array, off_m: Array, rows: IntArray
) -> LapDrift:
    x, y, yaw = relative_error(pairs, rows[:1], rows[-1:])[0].tolist()
    length_m, drift_m = float(np.ptp(driven_m[rows])), math.hypot(x, y)
    return LapDrift(
        number=number,
        length_m=length_m,
        drift_m=drift_m,
        drift_percent=100.0 * drift_m / length_m if length_m > 0 else float("nan"),
        drift_yaw_deg=math.degrees(yaw),
        max_error_m=float(off_m[rows].max()),
    )
