"""What is looked at in a run to find out what went wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.judge import Truth
from conegraph.geometry import between, rotation
from conegraph.io.run_folder import AssociationRows, ObservationRows, RunFolder
from conegraph.types import Array, IntArray, Mask, Status

LINK_S, LINK_M = 0.5, 1.2
"""Sights of one cone follow each other within this time, and by odometry no farther
apart: cones stand at least twice that far from each other."""


@dataclass(frozen=True, slots=True)
class Case:
    """A run, with sights put together by place alone: no filter has a say in it.

    Attributes:
        run: what the run wrote.
        truth: what is known to be true, if anything.
        stamp_s: (F,) of the frames.
        moved: (F, 3) increments of the causal estimate up to each frame.
        motion: (F, 3) those of odometry, where there is any.
        has_odometry: whether there is any.
        lost: (F,) frames in which the run did not know where the car is.
        seen: N sights of cones.
        made: what became of each of them.
        frame: (N,) frame of each.
        track: (N,) whose they are: sights with one number show one cone.
    """

    run: RunFolder
    truth: Truth
    stamp_s: Array
    moved: Array
    motion: Array
    has_odometry: bool
    lost: Mask
    seen: ObservationRows
    made: AssociationRows
    frame: IntArray
    track: IntArray

    @property
    def driven_m(self) -> float:
        """Distance that odometry says, or the estimate without any."""
        return float(np.hypot(self.motion[:, 0], self.motion[:, 1]).sum())

    def busiest_s(self, rows: Mask, width_s: float = 1.0) -> float:
        """Return the stamp from which on most of the marked sights (N,) lie."""
        if not rows.any():
            return float("nan")
        slot = np.floor(self.seen.stamp_s[rows] / width_s).astype(np.int64)
        found, count = np.unique(slot, return_counts=True)
        return float(found[count.argmax()] * width_s)


def open_case(run: RunFolder, truth: Truth) -> Case:
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
    return Case(
        run=run,
        truth=truth,
        stamp_s=stamp_s,
        moved=moved,
        motion=motion,
        has_odometry=len(at) > 1,
        lost=np.isin(stamp_s, lost_s),
        seen=seen,
        made=made,
        frame=frame,
        track=linked(frame, placed(chained(motion)[frame], seen.xy_m), stamp_s),
    )


def linked(frame: IntArray, world_m: Array, stamp_s: Array) -> IntArray:
    """Return whose sights (N,) are of one cone, by place alone and without any map.

    A sight continues the track that ended nearest to it, if both are each other's
    nearest, not `LINK_M` apart and not `LINK_S`.

    Args:
        frame: (N,) frame of each sight, ascending.
        world_m: (N, 2) where odometry alone puts it.
        stamp_s: (F,) stamps of the frames.
    """
    track = np.arange(len(frame))
    cuts = np.searchsorted(frame, np.arange(len(stamp_s) + 1))
    ends = np.zeros(0, dtype=np.int64)
    for k in np.flatnonzero(np.diff(cuts)):
        now = np.arange(cuts[k], cuts[k + 1])
        ends = ends[stamp_s[k] - stamp_s[frame[ends]] <= LINK_S]
        apart = np.hypot(*(world_m[now, None] - world_m[ends]).transpose(2, 0, 1))
        if len(ends):
            nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
            mutual = back[nearest] == np.arange(len(now))
            mutual &= apart[np.arange(len(now)), nearest] <= LINK_M
            track[now[mutual]] = track[ends[nearest[mutual]]]
            ends = np.delete(ends, nearest[mutual])
        ends = np.concatenate([ends, now])
    return track


def placed(pose: Array, xy_m: Array) -> Array:
    """Return points (N, 2), each in the frame of a pose (N, 3), in the world."""
    turned = np.einsum("nij,nj->ni", rotation(pose[:, 2]), xy_m)
    return np.asarray(pose[:, :2] + turned)


def chained(step: Array) -> Array:
    """Return the poses (F, 3) that increments (F, 3) lead to."""
    yaw = np.cumsum(step[:, 2])
    before = np.concatenate([[0.0], yaw[:-1]])
    moved = np.einsum("nij,nj->ni", rotation(before), step[:, :2])
    return np.column_stack([np.cumsum(moved, axis=0), yaw])
