"""Closing the loop at the start line with its own cones, checked before trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.backends.velocity import rigid_fit
from conegraph.geometry import between, to_parent
from conegraph.types import Array, IntArray

INLIER_M = 0.8
"""How near a seen cone must lie to one of the map to speak for a hypothesis."""

RIVAL_M = 1.0
RIVAL_RAD = 0.15
"""Hypotheses nearer to each other than this are one."""

LEAD = 2
"""How many more cones than its best rival the accepted hypothesis must explain."""


@dataclass(frozen=True, slots=True)
class GateMatch:
    """The start cones of a frame, taken for start cones of the map.

    Attributes:
        row: (k,) observations.
        slot: (k,) cones of the map.
        pose: (3,) where the car would then be.
        agreement: share of the frame's cones that would lie on the map.
    """

    row: IntArray
    slot: IntArray
    pose: Array
    agreement: float


def match_gate(
    seen_m: Array, seen_start: IntArray, mapped_m: Array, mapped_start: IntArray
) -> GateMatch | str:
    """Find the one pose at which the seen start cones are the map's.

    Every two seen start cones are laid on every two of the map that are as far
    apart. Each such pose is fitted to all that it explains and scored by how many
    of *all* seen cones it puts on the map, over the whole map and not only near the
    predicted pose: beside a parallel stretch the prior's own neighbourhood always
    finds something. The best must lead every other pose by `LEAD` cones.

    Args:
        seen_m: (m, 2) the frame's cones in the car frame.
        seen_start: indices of the start cones among them.
        mapped_m: (M, 2) cones of the map in the world.
        mapped_start: indices of the start cones among those.

    Returns:
        The match, or a sentence why there is none.
    """
    rough = _poses_from_pairs(seen_m[seen_start], mapped_m[mapped_start])
    if len(rough) == 0:
        return "no two start cones as far apart as the map's"
    poses = np.array([_refined(pose, seen_m, mapped_m) for pose in rough])
    counts = np.array([int(_explained(p, seen_m, mapped_m).sum()) for p in poses])
    best = int(counts.argmax())
    gap = between(poses[best], poses)
    other = (np.hypot(gap[:, 0], gap[:, 1]) > RIVAL_M) | (np.abs(gap[:, 2]) > RIVAL_RAD)
    rival = int(counts[other].max(initial=0))
    if counts[best] - rival < LEAD:
        return f"{counts[best]} cones agree, but {rival} with another pose"
    pose = poses[best]
    gaps = _gaps(pose, seen_m[seen_start], mapped_m[mapped_start])
    nearest = gaps.argmin(axis=1)
    good = gaps.min(axis=1) < INLIER_M
    slot = mapped_start[nearest[good]]
    if len(np.unique(slot)) != len(slot) or len(slot) < 2:
        return "two start cones fall on one"
    return GateMatch(seen_start[good], slot, pose, float(counts[best]) / len(seen_m))


def _poses_from_pairs(seen_m: Array, mapped_m: Array) -> Array:
    """Return (h, 3) poses that lay two seen cones on two mapped ones."""
    poses = []
    for a in range(len(seen_m)):
        for b in range(a + 1, len(seen_m)):
            length = np.hypot(*(seen_m[b] - seen_m[a]))
            for c in range(len(mapped_m)):
                for d in range(len(mapped_m)):
                    gap = np.hypot(*(mapped_m[d] - mapped_m[c]))
                    if c != d and length > 1.0 and abs(gap - length) < INLIER_M:
                        poses.append(rigid_fit(seen_m[[a, b]], mapped_m[[c, d]]))
    return np.array(poses).reshape(-1, 3)


def _refined(pose: Array, seen_m: Array, mapped_m: Array) -> Array:
    """Fit a pose to all cones it explains, so that one place counts as one pose."""
    for _ in range(2):
        gaps = _gaps(pose, seen_m, mapped_m)
        near = gaps.min(axis=1) < INLIER_M
        if near.sum() < 2:
            break
        pose = rigid_fit(seen_m[near], mapped_m[gaps[near].argmin(axis=1)])
    return pose


def _explained(pose: Array, seen_m: Array, mapped_m: Array) -> Array:
    near: Array = _gaps(pose, seen_m, mapped_m).min(axis=1) < INLIER_M
    return near


def _gaps(pose: Array, seen_m: Array, mapped_m: Array) -> Array:
    """(m, M) distances between seen cones, placed by a pose, and mapped ones."""
    gaps: Array = np.linalg.norm(to_parent(pose, seen_m)[:, None] - mapped_m, axis=2)
    return gaps


def sides(xy_m: Array) -> tuple[IntArray, IntArray]:
    """Return indices left and right of the x axis, nearest first (section 4.4.5)."""
    order = np.argsort(np.hypot(xy_m[:, 0], xy_m[:, 1]), kind="stable")
    left = order[xy_m[order, 1] > 0]
    right = order[xy_m[order, 1] <= 0]
    return left.astype(np.int64), right.astype(np.int64)
