"""Closing the loop at the start line with its own cones, checked before trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from conegraph.backends.relocalize import Relocaliser, same_place
from conegraph.backends.sightings import Sightings
from conegraph.geometry import distances, to_parent
from conegraph.types import Array, ConeObservations, IntArray

INLIER_M = 0.8
"""How near a seen cone must lie to one of the map to speak for a hypothesis."""

NEAREST = 6
"""Start cones of a frame that are laid on the map's: a lane of them has many pairs."""

LEAD = 2
"""How many more cones than its best rival the accepted hypothesis must explain."""

LEAST_CONES = 4
"""Cones that must lie on the map for a pose to be verified."""


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

    Every two of the `NEAREST` seen start cones are laid on every two of the map that
    are as far apart. Each such pose is fitted to all that it explains and scored by how
    many of *all* seen cones it puts on the map, over the whole map and not only near
    the predicted pose: beside a parallel stretch the prior's own neighbourhood always
    finds something. The best must lead every other pose by `LEAD` cones.

    Args:
        seen_m: (m, 2) the frame's cones in the car frame.
        seen_start: indices of the start cones among them.
        mapped_m: (M, 2) cones of the map in the world.
        mapped_start: indices of the start cones among those.

    Returns:
        The match, or a sentence why there is none.
    """
    by_range = np.argsort(np.hypot(*seen_m[seen_start].T), kind="stable")
    nearest = seen_m[seen_start[np.sort(by_range[:NEAREST])]]
    rough = _poses_from_pairs(nearest, mapped_m[mapped_start])
    if len(rough) == 0:
        return "no two start cones as far apart as the map's"
    poses, counts = _refined(rough, seen_m, mapped_m)
    best = int(counts.argmax())
    rival = int(counts[~same_place(poses[best], poses)].max(initial=0))
    if counts[best] - rival < LEAD:
        return f"{counts[best]} cones agree, but {rival} with another pose"
    pose = poses[best]
    placed = to_parent(pose, seen_m[seen_start])
    gaps = distances(placed, mapped_m[mapped_start])
    good = gaps.min(axis=1) < INLIER_M
    slot = mapped_start[gaps.argmin(axis=1)[good]]
    if len(np.unique(slot)) != len(slot) or len(slot) < 2:
        return "two start cones fall on one"
    return GateMatch(seen_start[good], slot, pose, float(counts[best]) / len(seen_m))


def verify_closure(
    relocaliser: Relocaliser, observations: ConeObservations | Sightings, pose: Array
) -> float:
    """Return by how much a pose leads every other on the map, in log-likelihood.

    A pose that is right is the best one on the *whole* map. Near the predicted pose
    something always fits: beside a parallel stretch half of all closures that were
    only tested there were wrong.

    Args:
        relocaliser: the map without what was added since the place was left.
        observations: what the car sees.
        pose: (3,) where a closure would put it.

    Returns:
        The lead over the best other hypothesis or chance; minus infinity where the
        best hypothesis is elsewhere or has too few cones to speak of.
    """
    found = relocaliser.locate(observations, on_map=True)
    best = found.best
    if (
        best is None
        or not same_place(best.pose, pose)[0]
        or len(best.row) < LEAST_CONES
    ):
        return -np.inf
    rivals = [h.log_likelihood for h in found.hypotheses[1:]]
    chance = relocaliser.config.chance_per_cone * len(best.row)
    return best.log_likelihood - max([*rivals, chance])


def _poses_from_pairs(seen_m: Array, mapped_m: Array) -> Array:
    """Return (h, 3) poses that lay two seen cones on two mapped ones."""
    a, b = np.triu_indices(len(seen_m), 1)
    length = np.hypot(*(seen_m[b] - seen_m[a]).T)
    gap = distances(mapped_m, mapped_m)
    alike = np.abs(gap - length[:, None, None]) < INLIER_M
    alike &= (length > 1.0)[:, None, None] & ~np.eye(len(mapped_m), dtype=bool)
    pair, c, d = np.nonzero(alike)
    seen = np.stack([seen_m[a[pair]], seen_m[b[pair]]], axis=1)
    mapped = np.stack([mapped_m[c], mapped_m[d]], axis=1)
    return _fitted(seen, mapped, np.ones((len(pair), 2)))


def _refined(poses: Array, seen_m: Array, mapped_m: Array) -> tuple[Array, IntArray]:
    """Fit poses (h, 3) to all they explain, so that one place counts as one pose.

    Returns:
        The poses, and how many cones each explains (h,).
    """
    tree = cKDTree(mapped_m)
    for _ in range(2):
        gaps, at = tree.query(_placed(poses, seen_m))
        near = np.asarray(gaps < INLIER_M, dtype=np.float64)
        some = near.sum(axis=1) >= 2.0
        seen = np.broadcast_to(seen_m, (int(some.sum()), *seen_m.shape))
        poses = poses.copy()
        poses[some] = _fitted(seen, mapped_m[np.asarray(at)[some]], near[some])
    gaps, _ = tree.query(_placed(poses, seen_m))
    return poses, np.count_nonzero(gaps < INLIER_M, axis=1)


def _placed(poses: Array, seen_m: Array) -> Array:
    """(h, m, 2) seen cones as each of the poses (h, 3) places them."""
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = seen_m.T
    turned = np.stack([c * x - s * y, s * x + c * y], axis=-1)
    placed: Array = turned + poses[:, None, :2]
    return placed


def _fitted(from_m: Array, to_m: Array, weight: Array) -> Array:
    """Return poses (h, 3) as `rigid_fit` does, of points (h, k, 2) with weights."""
    share = (weight / weight.sum(axis=1, keepdims=True))[..., None]
    middle_a, middle_b = (share * from_m).sum(axis=1), (share * to_m).sum(axis=1)
    a, b = from_m - middle_a[:, None], share * (to_m - middle_b[:, None])
    cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    yaw = np.arctan2(cross, (a * b).sum(axis=(1, 2)))
    c, s = np.cos(yaw), np.sin(yaw)
    x = middle_b[:, 0] - c * middle_a[:, 0] + s * middle_a[:, 1]
    y = middle_b[:, 1] - s * middle_a[:, 0] - c * middle_a[:, 1]
    return np.stack([x, y, yaw], axis=1)


def sides(xy_m: Array) -> tuple[IntArray, IntArray]:
    """Return indices left and right of the x axis, nearest first (section 4.4.5)."""
    order = np.argsort(np.hypot(xy_m[:, 0], xy_m[:, 1]), kind="stable")
    left = order[xy_m[order, 1] > 0]
    right = order[xy_m[order, 1] <= 0]
    return left.astype(np.int64), right.astype(np.int64)
