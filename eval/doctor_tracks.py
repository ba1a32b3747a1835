"""Which sights show one cone, told from their places alone."""

from __future__ import annotations

import numpy as np

from conegraph.geometry import rotation
from conegraph.types import Array, IntArray

LINK_M = 1.2
"""Sights of one cone are by odometry no farther apart: cones stand at least twice that
far from each other."""

LINK_S, LINK_WAY_M = 0.5, 0.3
"""They follow each other within this time, or within this way of a slow car."""


def linked(frame: IntArray, world_m: Array, stamp_s: Array, way_m: Array) -> IntArray:
    """Return whose sights (N,) are of one cone, by place alone and without any map.

    A sight continues the track that ended nearest to it, if both are each other's
    nearest, and the end is neither too far nor too old.

    Args:
        frame: (N,) frame of each sight, ascending.
        world_m: (N, 2) where odometry alone puts it.
        stamp_s: (F,) stamps of the frames.
        way_m: (F,) driven up to each frame.
    """
    passed_s = np.diff(stamp_s, prepend=stamp_s[:1]) / LINK_S
    passed_m = np.diff(way_m, prepend=way_m[:1]) / LINK_WAY_M
    age = np.cumsum(np.minimum(passed_s, passed_m))
    track = np.arange(len(frame))
    cuts = np.searchsorted(frame, np.arange(len(age) + 1))
    ends = np.zeros(0, dtype=np.int64)
    for k in np.flatnonzero(np.diff(cuts)):
        now = np.arange(cuts[k], cuts[k + 1])
        ends = ends[age[k] - age[frame[ends]] <= 1.0]
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
