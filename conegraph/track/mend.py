"""Boundaries looked at on their own: what spikes out goes, what was skipped comes in.

The search over gates knows how wide the lane is, not how straight its sides are. Here
a boundary pays for its bends and for every cone left out, and cones are taken out and
put in, one by one, for as long as that pays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from shapely import LinearRing, LineString

from conegraph.types import Array, IntArray, Mask

_ROUNDS = 6
_UNTANGLES = 8


@dataclass(frozen=True, slots=True)
class MendCosts:
    """What a boundary pays for, in nats.

    Attributes:
        bend: a turn by one rad. Turns add up, so that a corner costs the same over
            one cone or three; what turns back and forth costs more.
        free_rad: turns smaller than this cost little.
        short_m: turns of steps shorter than this count less.
        left_out: a cone that is not used.
        twice: a cone that is used a second time.
        long_m: length from which ...
        per_long_m: ... every further metre of a step costs extra.
        reach_m: how far from a boundary a cone may be to be put in.
    """

    bend: float = 5.0
    free_rad: float = 0.2
    short_m: float = 1.5
    left_out: float = 4.0
    twice: float = 6.0
    long_m: float = 5.5
    per_long_m: float = 0.35
    reach_m: float = 1.5


def mend(
    xy_m: Array,
    chain: IntArray,
    closed: bool,
    against: Array,
    free: Mask,
    costs: MendCosts,
) -> IntArray:
    """Return a boundary with cones taken out and put in.

    Args:
        xy_m: (N, 2) cones.
        chain: (K,) cones of the boundary in driving order.
        closed: whether the last is followed by the first.
        against: (N,) cost of each cone on this side.
        free: (N,) cones that may be put in.
        costs: what a boundary pays for.
    """
    for _ in range(_ROUNDS):
        thinner = _take_out(xy_m, chain, closed, against, costs)
        spare = free.copy()
        spare[chain] = False
        fuller = _put_in(xy_m, thinner, closed, against, np.flatnonzero(spare), costs)
        if len(fuller) == len(chain) and (fuller == chain).all():
            break
        chain = fuller
    return chain


def untangle(
    xy_m: Array,
    left: IntArray,
    right: IntArray,
    closed: bool,
    against: Array,
    costs: MendCosts,
) -> tuple[IntArray, IntArray]:
    """Return boundaries that cross neither themselves nor each other, if possible.

    Where two segments cross, the one of their four cones goes that is missed least.
    """
    for _ in range(_UNTANGLES):
        if are_simple(xy_m, left, right, closed):
            break
        knots = np.unique(_crossed(xy_m, left, right, closed))
        gain = np.concatenate(
            [
                removal_gain(xy_m, chain, closed, against[side], costs)
                for side, chain in enumerate((left, right))
            ]
        )
        if len(knots) == 0 or len(left) + len(right) < 5:
            break
        worst = int(knots[np.argmax(gain[knots])])
        if worst < len(left):
            left = np.delete(left, worst)
        else:
            right = np.delete(right, worst - len(left))
    return left, right


def are_simple(xy_m: Array, left: IntArray, right: IntArray, closed: bool) -> bool:
    """Return whether two boundaries cross neither themselves nor each other."""
    kind = LinearRing if closed else LineString
    if min(len(left), len(right)) < (3 if closed else 2):
        return not closed
    lines = [kind(xy_m[chain]) for chain in (left, right)]
    if not all(line.is_simple for line in lines):
        return False
    return not lines[0].intersects(lines[1])


def _crossed(xy: Array, left: IntArray, right: IntArray, closed: bool) -> IntArray:
    """Return the ends of crossing segments, as places in left and then right."""
    start, end = [], []
    for chain, offset in ((left, 0), (right, len(left))):
        place = np.arange(len(chain)) + offset
        start.append(place if closed else place[:-1])
        end.append(np.roll(place, -1) if closed else place[1:])
    a, b = np.concatenate(start), np.concatenate(end)
    points = xy[np.concatenate([left, right])]
    p, d = points[a], points[b] - points[a]

    def side(ends: Array) -> Array:
        """On which side of each segment each end lies; (segments, ends)."""
        away = ends - p[:, None]
        turn = d[:, None, 0] * away[..., 1] - d[:, None, 1] * away[..., 0]
        return np.asarray(np.sign(turn))

    apart = side(points[a]) * side(points[b]) <= 0
    crossing = apart & apart.T
    shared = (a[:, None] == a) | (a[:, None] == b) | (b[:, None] == a)
    i, j = np.nonzero(np.triu(crossing & ~shared, 1))
    return np.concatenate([a[i], b[i], a[j], b[j]])


def _take_out(
    xy: Array, chain: IntArray, closed: bool, against: Array, costs: MendCosts
) -> IntArray:
    while len(chain) > 3:
        gain = removal_gain(xy, chain, closed, against, costs)
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        # What is far from the best one does not depend on it.
        out = [best]
        taken = np.zeros(len(chain), dtype=np.bool_)
        for k in np.argsort(-gain, kind="stable")[: int((gain > 0).sum())].tolist():
            around = np.arange(k - 3, k + 4)
            around = around % len(chain) if closed else around.clip(0, len(chain) - 1)
            if not taken[around].any():
                taken[k] = True
                out.append(k)
        chain = np.delete(chain, np.unique(out))
    return chain


def removal_gain(
    xy: Array, chain: IntArray, closed: bool, against: Array, costs: MendCosts
) -> Array:
    """Return what a boundary gains by leaving out each of its cones; (K,)."""
    p = _padded(xy[chain], closed)
    a2, a, b, c, c2 = (p[k : k + len(chain)] for k in range(5))
    bend = _bend((a2, a, b, a2, a), (a, b, c, a, c), (b, c, c2, c, c2), costs)
    long = _long((a, b, a), (b, c, c), costs)
    now = bend[0] + bend[1] + bend[2] + long[0] + long[1]
    then = bend[3] + bend[4] + long[2]
    worth = costs.left_out - against[chain]
    count = np.bincount(chain, minlength=len(xy))
    worth = np.where(count[chain] > 1, worth - costs.twice, worth)
    return np.asarray(now - then - worth)


def _put_in(
    xy: Array,
    chain: IntArray,
    closed: bool,
    against: Array,
    spare: IntArray,
    costs: MendCosts,
) -> IntArray:
    spare = spare[against[spare] < costs.left_out]
    if len(spare) == 0 or len(chain) < 2:
        return chain
    p = _padded(xy[chain], closed)
    count = len(chain) if closed else len(chain) - 1
    a2, a, c, c2 = (p[k : k + count] for k in range(1, 5))
    cone, slot = np.nonzero(_beside(xy[spare], a, c, costs.reach_m))
    u = xy[spare[cone]]
    a2, a, c, c2 = a2[slot], a[slot], c[slot], c2[slot]
    bend = _bend((a2, a, a2, a, u), (a, c, a, u, c), (c, c2, u, c, c2), costs)
    long = _long((a, a, u), (c, u, c), costs)
    now = bend[0] + bend[1] + long[0]
    then = bend[2] + bend[3] + bend[4] + long[1] + long[2]
    gain = costs.left_out - against[spare[cone]] + now - then
    used: set[int] = set()
    slots: dict[int, int] = {}
    for k in np.argsort(-gain, kind="stable").tolist():
        i, j = int(cone[k]), int(slot[k])
        if gain[k] <= 0:
            break
        if i not in used and j not in slots:
            used.add(i)
            slots[j] = int(spare[i])
    at = np.array(list(slots), dtype=np.int64)
    return np.insert(chain, at + 1, np.array(list(slots.values()), dtype=np.int64))


def _beside(xy: Array, start: Array, end: Array, reach_m: float) -> Mask:
    """Return which points (U,) stand beside which segments (S,); (U, S)."""
    edge = end - start
    length = np.maximum(np.hypot(*edge.T), 1e-9)
    away = xy[:, None] - start
    along = (away * edge).sum(axis=2) / length
    across = np.abs(away[..., 0] * edge[:, 1] - away[..., 1] * edge[:, 0]) / length
    slack = 0.1 * length
    return np.asarray((along > -slack) & (along < length + slack) & (across < reach_m))


def _padded(points: Array, closed: bool) -> Array:
    """Return the points with two more at either end: of the loop, or NaN."""
    if closed and len(points) > 1:
        return np.concatenate([points[-2:], points, points[:2]])
    none = np.full((2, 2), np.nan)
    return np.concatenate([none, points, none])


Points = tuple[Array, ...]


def _bend(a: Points, b: Points, c: Points, costs: MendCosts) -> Array:
    """Return the costs (M, K) of turns at b; 0 where a neighbour is missing."""
    middle = np.stack(b)
    u, v = middle - np.stack(a), np.stack(c) - middle
    ux, uy, vx, vy = u[..., 0], u[..., 1], v[..., 0], v[..., 1]
    turn = np.arctan2(ux * vy - uy * vx, ux * vx + uy * vy)
    short = np.sqrt(np.minimum(ux * ux + uy * uy, vx * vx + vy * vy))
    bend = np.hypot(turn, costs.free_rad) - costs.free_rad
    cost = costs.bend * bend * np.minimum(short / costs.short_m, 1.0) ** 2
    return np.where(cost == cost, cost, 0.0)


def _long(a: Points, b: Points, costs: MendCosts) -> Array:
    """Return the costs (M, K) of long steps; 0 where an end is missing."""
    step = np.stack(b) - np.stack(a)
    excess = np.hypot(step[..., 0], step[..., 1]) - costs.long_m
    return np.where(excess > 0.0, costs.per_long_m * excess, 0.0)
