"""The graph of gates: every way in which a lane could run between the cones.

A *gate* is a pair of a left and a right cone. The lane goes on from a gate by one
triangle: one side steps to its next cone while the other stays. Both boundaries are
so searched together, which keeps neighbouring legs of a course apart, and costs of
a step are all known beforehand: the search itself is a shortest path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, QhullError
from scipy.spatial.distance import cdist

from conegraph.track.nearest import Nearest
from conegraph.track.plane import Points, distinct, median, outer, points
from conegraph.types import Array, IntArray, Mask

_NEIGHBOURS = 6
"""Nearest cones of a side that may follow a cone."""
_GATE_NEIGHBOURS = 10
_BYSTANDERS = 5
"""Nearest cones of each corner that may stand inside a triangle."""
_STEP_M = 7.5
BRIDGE_M = 17.0
"""Farthest next cone, over a gap where two or three are missing."""
_GATE_LANES = 3.6
"""Longest gate in lane widths: it slants while the other side bridges a gap."""
_LANE_BOUNDS_M = (0.4, 7.0)
_USUAL_LANE_M = 3.5


@dataclass(frozen=True, slots=True)
class GateCosts:
    """What makes a step of the lane unlikely, in nats.

    Attributes:
        per_step: every step.
        per_m2: the square of its length.
        long_m: length from which ...
        per_long_m: ... every further metre costs extra.
        width_slack: relative error of the lane's width that is free.
        width: the square of what exceeds it, in units of the slack.
        slant: every lane width of a gate's length beyond `slant_free`.
        slant_free: gate length in lane widths that is free.
        inside: a cone inside the triangle, which then stands on the road.
    """

    per_step: float = 0.02
    per_m2: float = 0.004
    long_m: float = 5.5
    per_long_m: float = 0.35
    width_slack: float = 0.25
    width: float = 1.0
    slant: float = 1.0
    slant_free: float = 1.9
    inside: float = 2.0


@dataclass(frozen=True, slots=True)
class GateGraph:
    """Gates and the steps between them.

    Attributes:
        cone: (N,) cones.
        left: (G,) left cone of each gate.
        right: (G,) right cone.
        middle: (G,) its middle.
        tail: (T,) gate that a step leaves.
        head: (T,) gate that it reaches.
        cost: (T,) in nats.
        lane_m: usual width of the lane.
    """

    cone: Points
    left: IntArray
    right: IntArray
    middle: Points
    tail: IntArray
    head: IntArray
    cost: Array
    lane_m: float

    def __len__(self) -> int:
        return len(self.left)


def lane_width(xy_m: Array, left: Mask, right: Mask) -> float:
    """Return the usual distance to the nearest cone of the other side.

    Where no cone is on one side only, that says nothing: 3.5 m, as in the rules.
    """
    only_left, only_right = left & ~right, right & ~left
    if min(only_left.sum(), only_right.sum()) < 2:
        return _USUAL_LANE_M
    away = cdist(xy_m[only_left], xy_m[only_right])
    usual = median(np.concatenate([away.min(axis=1), away.min(axis=0)]))
    return min(max(usual, _LANE_BOUNDS_M[0]), _LANE_BOUNDS_M[1])


def gate_graph(
    xy_m: Array,
    against: Array,
    left: Mask,
    right: Mask,
    lane_m: float,
    costs: GateCosts,
) -> GateGraph:
    """Return all gates and steps between cones.

    Args:
        xy_m: (N, 2) cones.
        against: (2, N) cost of a cone on the left and on the right side.
        left: (N,) cones that may stand on the left.
        right: (N,) cones that may stand on the right.
        lane_m: usual width of the lane.
        costs: what makes a step unlikely.
    """
    n, cone = len(xy_m), points(xy_m)
    gate_l, gate_r = _gates(xy_m, left, right, lane_m)
    index = np.full((n, n), -1, dtype=np.int64)
    index[gate_l, gate_r] = np.arange(len(gate_l))
    # Each gate may move on either side; a cone on the right counts as cone + N.
    move, stay = np.append(gate_l, gate_r + n), np.append(gate_r, gate_l)
    gate, new = _expand(move, *_followers(xy_m, left, right))
    old, wait, on_right = move[gate] % n, stay[gate], move[gate] >= n
    head = np.where(on_right, index[wait, new], index[new, wait])
    there = head >= 0
    tail, head, old, new, wait, side_of = (
        x[there] for x in (gate % len(gate_l), head, old, new, wait, 1 * on_right)
    )
    sign = 1 - 2 * side_of
    cost = _step_costs(cone, (old, new, wait), sign, lane_m, costs)
    rows = np.flatnonzero(np.isfinite(cost))
    corner = np.stack([old[rows], new[rows], wait[rows]])
    bystanders = Nearest(xy_m).some(xy_m, _BYSTANDERS + 1)[1][:, 1:]
    cost[rows] += costs.inside * _any_inside(cone, corner, bystanders, sign[rows])
    cost += against[side_of, new]
    middle = 0.5 * (cone[gate_l] + cone[gate_r])
    return GateGraph(
        cone, gate_l, gate_r, middle, tail[rows], head[rows], cost[rows], lane_m
    )


def _gates(
    xy: Array, left: Mask, right: Mask, lane_m: float
) -> tuple[IntArray, IntArray]:
    """Return the left and right cones of all gates.

    The nearest cones of the other side, and across gaps the neighbours in a
    triangulation of all cones.
    """
    n = len(xy)
    rows, columns = np.flatnonzero(left), np.flatnonzero(right)
    away, near = Nearest(xy[columns]).some(xy[rows], _GATE_NEIGHBOURS + 1)
    row, column = np.nonzero(away < max(_GATE_LANES * lane_m, 2.0))
    a, b = neighbours(xy)
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    fit = left[a] & right[b]
    near_key = rows[row] * n + columns[near[row, column]]
    key = distinct(np.concatenate([near_key, a[fit] * n + b[fit]]))
    a, b = key // n, key % n
    length = np.hypot(*(xy[a] - xy[b]).T)
    fit = (length > 0.3 * lane_m) & (length < BRIDGE_M)
    return a[fit], b[fit]


def neighbours(xy: Array) -> tuple[IntArray, IntArray]:
    """Return the edges of the Delaunay triangulation, one direction of each or both."""
    if len(xy) < 4:
        a, b = np.triu_indices(len(xy), 1)
        return a, b
    try:
        corner = Delaunay(xy).simplices.astype(np.int64)
    except QhullError:
        a = np.argsort(xy @ (1.0, 1.0), kind="stable")
        return a[:-1], a[1:]
    return corner.ravel(), corner[:, [2, 0, 1]].ravel()


def _followers(xy: Array, left: Mask, right: Mask) -> tuple[IntArray, IntArray]:
    """Return who may follow whom, as (2 N + 1,) offsets and cones: left, then right.

    The nearest cones of a side, and across gaps the neighbours in its triangulation.
    """
    n, keys = len(xy), []
    for offset, side in ((0, np.flatnonzero(left)), (n, np.flatnonzero(right))):
        own = xy[side]
        a, b = neighbours(own)
        near_by = np.hypot(*(own[a] - own[b]).T) < BRIDGE_M
        away, near = Nearest(own).some(own, _NEIGHBOURS + 1)
        row, column = np.nonzero(away[:, 1:] < _STEP_M)
        a = side[np.concatenate([a[near_by], row])]
        b = side[np.concatenate([b[near_by], near[row, column + 1]])]
        keys += [(a + offset) * n + b, (b + offset) * n + a]
    key = distinct(np.concatenate(keys))
    return np.searchsorted(key, np.arange(2 * n + 1) * n), key % n


def _expand(
    move: IntArray, offsets: IntArray, follower: IntArray
) -> tuple[IntArray, IntArray]:
    """Return for every gate every follower of its moving cone: gate and follower."""
    count = (offsets[1:] - offsets[:-1])[move]
    gate = np.repeat(np.arange(len(move)), count)
    rank = np.arange(len(gate)) - np.repeat(np.cumsum(count) - count, count)
    return gate, follower[offsets[move][gate] + rank]


def _step_costs(
    cone: Points,
    corner: tuple[IntArray, IntArray, IntArray],
    sign: IntArray,
    lane_m: float,
    costs: GateCosts,
) -> Array:
    """Return the cost of steps from an old to a new cone while a third waits; (T,).

    Infinite where the new cone does not lie ahead of the gate. The lane's width is
    the height of the triangle over the step: the gates themselves slant.

    Args:
        cone: (N,) cones.
        corner: (T,) old, new and waiting cones.
        sign: (T,) 1 for steps on the left, -1 on the right.
        lane_m: usual width of the lane.
        costs: what makes a step unlikely.
    """
    old, new, wait = (cone[c] for c in corner)
    step, gate = new - old, new - wait
    length = np.hypot(step.real, step.imag)
    area = sign * outer(step, old - wait)
    width = area / np.maximum(length, 1e-6) / lane_m
    off = np.maximum(np.abs(width - 1.0) / costs.width_slack - 1.0, 0.0)
    slant = np.hypot(gate.real, gate.imag) / lane_m - costs.slant_free
    cost = costs.per_step + costs.per_m2 * length**2 + costs.width * off**2
    cost += costs.per_long_m * np.maximum(length - costs.long_m, 0.0)
    cost += costs.slant * np.maximum(slant, 0.0)
    return np.where((width > 0.2) & (length > 1e-3), cost, np.inf)


def _any_inside(
    cone: Points, corner: IntArray, bystanders: IntArray, sign: IntArray
) -> Mask:
    """Return whether a cone near a corner (3, T) stands inside the triangle; (T,)."""
    near = cone[bystanders[corner]]
    inside = np.ones(near.shape, dtype=np.bool_)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start = cone[corner[a]]
        edge = sign * (cone[corner[b]] - start)
        inside &= outer(edge[:, None], near - start[:, None]) < -1e-6
    return np.asarray(inside.any(axis=(0, 2)))
