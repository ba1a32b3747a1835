"""One frame as the tracker settled it: all that a mapper is told."""

from __future__ import annotations

from dataclasses import dataclass

from conegraph.backends.motion import OdometryIncrement
from conegraph.types import Array, IntArray, Mask


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """A frame's stamp, its motion since the last one, and which cones it saw.

    Attributes:
        stamp_s: the frame's stamp.
        increment: odometry since the frame before, None if there was none.
        state: (6,) the car after the frame.
        speed_cov: (2, 2) covariance of its forward speed and yaw rate.
        landmark_id: (k,) cones seen, matched or new.
        row: (k,) their rows in the frame as it passed the gate.
        xy_m: (k, 2) where they were seen, car frame.
        cov_m2: (k, 2, 2) sensor noise, at the predicted range.
        reported_m2: (k, 2, 2) sensor noise as reported, at the measured range.
        vague: (k,) whether the cone was found again after its place had become
            vague: the pair was tested as part of a constellation.
        closure: whether these close a loop.
        merged: pairs (kept, gone) of cones found to be one.
        deleted: ids of cones that were found not to exist.
        jump: whether the car was found to be elsewhere than the motion since the
            frame before says: carried, or lost and found again.
    """

    stamp_s: float
    increment: OdometryIncrement | None
    state: Array
    speed_cov: Array
    landmark_id: IntArray
    row: IntArray
    xy_m: Array
    cov_m2: Array
    reported_m2: Array
    vague: Mask
    closure: bool = False
    merged: tuple[tuple[int, int], ...] = ()
    deleted: tuple[int, ...] = ()
    jump: bool = False
