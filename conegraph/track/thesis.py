"""Chapter 5 of the thesis as published: greedy boundaries, zig-zag triangles."""

from __future__ import annotations

import numpy as np

from conegraph.config import TrackConfig
from conegraph.geometry import to_child
from conegraph.track.centerline import center_line
from conegraph.track.cones import Cones
from conegraph.track.gates import lane_width
from conegraph.track.model import Track
from conegraph.track.report import finished
from conegraph.types import Array, ConeMap, IntArray


def thesis_track(
    cone_map: ConeMap, cones: Cones, pose: Array | None, config: TrackConfig
) -> Track:
    """Return the track by the method of chapter 5.

    The start cones are told apart by their side of the car (5.1.1), or without a
    pose are the first of each colour. All cones of a colour are joined (5.1.2); the
    boundary closes where its ends are near each other (5.1.3).
    """
    sides = (cones.sure_left, cones.sure_right)
    place = cones.xy_m if pose is None else to_child(pose, cones.xy_m)
    chains, near = [], True
    for sign, side in zip((1.0, -1.0), sides, strict=True):
        start = cones.start & (sign * place[:, 1] > 0) if pose is not None else side
        first = np.flatnonzero(start if start.any() else side)
        if len(first) == 0:
            return Track.unknown("no cone on one side", cone_map.id, cone_map.xy_m)
        if pose is not None:
            first = first[np.argsort(np.hypot(*place[first].T), kind="stable")]
        rows = np.union1d(np.flatnonzero(side), first[:1])
        chain = thesis_order(cones.xy_m, rows, int(first[0]), config)
        ends = cones.xy_m[chain[-1]] - cones.xy_m[chain[0]]
        near &= len(chain) > 2 and float(np.hypot(*ends)) < config.thesis_closure_m
        chains.append(chain)
    left, right = chains
    triangles = zigzag(left, right, near)
    lane_m = lane_width(cones.xy_m, cones.sure_left, cones.sure_right)
    line = center_line(cones.xy_m, left, right, triangles, near, lane_m)
    if len(line) == 0:
        return Track.unknown("few cones", cone_map.id, cone_map.xy_m)
    return finished(cone_map, cones, left, right, triangles, line, near, 0.0)


def thesis_order(
    xy_m: Array, rows: IntArray, first: int, config: TrackConfig
) -> IntArray:
    """Return the cones in the order of section 5.1; (K,).

    The second cone is the nearest. From c_{n-1} and c_n the next is the one with the
    least d (1 + w delta) or d + w delta, where d is its distance from c_n and
    delta = |(c_n - c_{n-1}) x (u - c_n)| / (|c_n - c_{n-1}| |u - c_n|). Equation 5.3
    is lost in the copy that we have: both readings fit its text.
    """
    chain = [first]
    rest = rows[rows != first]
    while len(rest):
        step = xy_m[rest] - xy_m[chain[-1]]
        cost = away = np.hypot(*step.T)
        if len(chain) > 1:
            before = xy_m[chain[-1]] - xy_m[chain[-2]]
            area = np.abs(before[0] * step[:, 1] - before[1] * step[:, 0])
            delta = area / np.maximum(np.hypot(*before) * away, 1e-12)
            turn = config.thesis_weight * delta
            by_product = config.thesis_cost == "product"
            cost = away * (1.0 + turn) if by_product else away + turn
        best = int(np.argmin(cost))
        chain.append(int(rest[best]))
        rest = np.delete(rest, best)
    return np.array(chain, dtype=np.int64)


def zigzag(left: IntArray, right: IntArray, closed: bool) -> IntArray:
    """Return triangles that step left and right in turn (section 5.2); (T, 3)."""
    if closed:
        left, right = (np.concatenate([c, c[:1]]) for c in (left, right))
    i = j = 0
    triangles = []
    while i < len(left) - 1 or j < len(right) - 1:
        by_left = (i <= j and i < len(left) - 1) or j >= len(right) - 1
        fresh = left[i + 1] if by_left else right[j + 1]
        triangles.append((left[i], right[j], fresh))
        i, j = (i + 1, j) if by_left else (i, j + 1)
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)
