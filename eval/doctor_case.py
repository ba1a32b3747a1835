"""What is looked at in a run to find out what went wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from conegraph.eval.doctor_fit import SPAN_S, SensorFit, Sights, fit_sensors
from conegraph.eval.doctor_tracks import chained, linked, placed
from conegraph.geometry import between
from conegraph.io.run_folder import (
    AssociationRows,
    MotionRows,
    ObservationRows,
    RunFolder,
)
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
    run = _even(run)
    pose = run.trajectory.pose
    moved = np.zeros_like(pose)
    moved[1:] = between(pose[:-1], pose[1:])
    told = np.isfinite(run.motion.odometry[:, 0])
    motion = np.where(told[:, None], run.motion.odometry, moved)
    seen, stamp_s = run.observations, run.motion.stamp_s
    frame = np.searchsorted(stamp_s, seen.stamp_s).clip(max=len(stamp_s) - 1)
    lost = run.status.status == Status.LOST.value
    way_m = np.cumsum(np.hypot(motion[:, 0], motion[:, 1]))
    places = placed(chained(motion)[frame], seen.xy_m)
    track = linked(frame, places, stamp_s, way_m)
    return Case(
        run=run,
        truth=truth,
        stamp_s=stamp_s,
        moved=moved,
        motion=motion,
        has_odometry=bool(told.any()),
        lost=lost,
        seen=seen,
        made=run.associations,
        frame=frame,
        track=track,
        fit=fit_sensors(_sights(stamp_s, motion, lost, seen, frame, track)),
    )


def _even(run: RunFolder) -> RunFolder:
    """Return a run whose tables speak of the same frames and sights.

    One that was killed may have written some of them further than others, and one of
    an older version knows no stamps of frames but those of its path.
    """
    motion = run.motion
    if len(motion) == 0:
        none = np.full((len(run.trajectory), 3), np.nan)
        motion = MotionRows(run.trajectory.stamp_s, none, none[:, 0])
    n = min(len(run.trajectory), len(motion), len(run.status))
    last_s = motion.stamp_s[n - 1]
    rows = min(len(run.observations), len(run.associations))
    rows = int(np.searchsorted(run.observations.stamp_s[:rows], last_s, "right"))
    return replace(
        run,
        trajectory=Trajectory(run.trajectory.stamp_s[:n], run.trajectory.pose[:n]),
        motion=motion.first(n),
        status=run.status.first(n),
        observations=run.observations.first(rows),
        associations=run.associations.first(rows),
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
