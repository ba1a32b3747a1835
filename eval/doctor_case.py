"""What is looked at in a run to find out what went wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.doctor_fit import SPAN_S, SensorFit, Sights, fit_sensors
from conegraph.eval.doctor_tracks import chained, linked, placed
from conegraph.geometry import between
from conegraph.io.run_folder import AssociationRows, ObservationRows, RunFolder
from conegraph.types import Array, IntArray, Mask, Status, Trajectory

OVERCONFIDENT = 1.25
"""NIS per degree of freedom that a healthy run does not exceed."""


@dataclass(frozen=True, slots=True)
class Case:
    """A run, with sights put together by place alone: no filter has a say in it.

    Attributes:
        run: what the run wrote.
        truth: the true path, if it is known.
        stamp_s: (F,) of the frames.
        moved: (F, 3) increments of the causal estimate up to each frame.
        motion: (F, 3) those of odometry, where there is any.
        has_odometry: whether there is any.
        lost: (F,) frames in which the run did not know where the car is.
        seen: N sights of cones.
        made: what became of each of them.
        frame: (N,) frame of each.
        track: (N,) whose they are: sights with one number show one cone.
        fit: what is wrong with odometry, stamps and calibration; None where too few
            cones were seen twice.
    """

    run: RunFolder
    truth: Trajectory | None
    stamp_s: Array
    moved: Array
    motion: Array
    has_odometry: bool
    lost: Mask
    seen: ObservationRows
    made: AssociationRows
    frame: IntArray
    track: IntArray
    fit: SensorFit | None

    @property
    def driven_m(self) -> float:
        """Distance that odometry says, or the estimate without any."""
        return float(np.hypot(self.motion[:, 0], self.motion[:, 1]).sum())

    @property
    def nis_per_dof(self) -> float:
        """NIS per degree of freedom of the whole run, 1 where there is none."""
        rows = self.run.consistency
        return float(rows.nis.sum() / rows.dof.sum()) if len(rows) else 1.0

    @property
    def worst_nis_s(self) -> float:
        """Stamp from which on NIS is greatest over a second, NaN without any."""
        rows = self.run.consistency
        if len(rows) == 0:
            return float("nan")
        second, k = np.unique(np.floor(rows.stamp_s), return_inverse=True)
        ratio = np.bincount(k, rows.nis) / np.bincount(k, rows.dof)
        return float(second[ratio.argmax()])

    def busiest_s(self, rows: Mask, width_s: float = 1.0) -> float:
        """Return the stamp from which on most of the marked sights (N,) lie."""
        if not rows.any():
            return float("nan")
        slot = np.floor(self.seen.stamp_s[rows] / width_s).astype(np.int64)
        found, count = np.unique(slot, return_counts=True)
        return float(found[count.argmax()] * width_s)


def open_case(run: RunFolder, truth: Trajectory | None) -> Case:
    """Prepare a run for questions; one of an older version has no sights."""
    stamp_s, pose = run.trajectory.stamp_s, run.trajectory.pose
    moved = np.zeros((len(stamp_s), 3))
    moved[1:] = between(pose[:-1], pose[1:])
    motion = moved.copy()
    _, at, row = np.intersect1d(stamp_s, run.motion.stamp_s, return_indices=True)
    motion[at] = run.motion.odometry[row]
    # A run that was killed may have written one table further than the other.
    n = min(len(run.observations), len(run.associations))
    seen, made = run.observations.first(n), run.associations.first(n)
    frame = np.searchsorted(stamp_s, seen.stamp_s).clip(max=len(stamp_s) - 1)
    lost_s = run.status.stamp_s[run.status.status == Status.LOST.value]
    lost = np.isin(stamp_s, lost_s)
    way_m = np.cumsum(np.hypot(motion[:, 0], motion[:, 1]))
    places = placed(chained(motion)[frame], seen.xy_m)
    track = linked(frame, places, stamp_s, way_m)
    return Case(
        run=run,
        truth=truth,
        stamp_s=stamp_s,
        moved=moved,
        motion=motion,
        has_odometry=len(at) > 1,
        lost=lost,
        seen=seen,
        made=made,
        frame=frame,
        track=track,
        fit=fit_sensors(_sights(stamp_s, motion, lost, seen, frame, track)),
    )


def _sights(
    stamp_s: Array,
    motion: Array,
    lost: Mask,
    seen: ObservationRows,
    frame: IntArray,
    track: IntArray,
) -> Sights:
    """Return the sights of a moving car that knows where it is, by cone and span."""
    moving = motion[:, :2].any(axis=1) & ~lost
    rows = moving[frame]
    span = np.floor(stamp_s[frame] / SPAN_S).astype(np.int64)
    key = np.stack([track, span], axis=1)[rows]
    return Sights(
        frame[rows],
        np.unique(key, axis=0, return_inverse=True)[1],
        seen.xy_m[rows],
        seen.cov_m2[rows],
        stamp_s,
        motion,
    )
