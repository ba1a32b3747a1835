"""One frame as the tracker settled it: all that a mapper is told."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from conegraph.backends.motion import OdometryIncrement
from conegraph.types import Array, IntArray, Mask


@dataclass(frozen=True, slots=True)
class Unclaimed:
    """Sightings that no cone was sure enough to be given, and that made none.

    Attributes:
        row: (m,) their rows in the frame as it passed the gate.
        xy_m: (m, 2) where they were seen, car frame.
        reported_m2: (m, 2, 2) sensor noise as reported.
    """

    row: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    xy_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    reported_m2: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))

    def __len__(self) -> int:
        return len(self.row)

    def subset(self, index: IntArray) -> Unclaimed:
        """Return the sightings at the given places."""
        return Unclaimed(self.row[index], self.xy_m[index], self.reported_m2[index])


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
        unclaimed: what else was seen, for a second look at the end.
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
    unclaimed: Unclaimed = field(default_factory=Unclaimed)
