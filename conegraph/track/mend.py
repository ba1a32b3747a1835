"""Boundaries looked at on their own: what spikes out goes, what was skipped comes in.

The search over gates knows how wide the lane is, not how straight its sides are. Here
a boundary pays for its bends and for every cone left out, and cones are taken out and
put in, one by one, for as long as that pays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from shapely import LinearRing, LineString

from conegraph.track.plane import Points, inner, outer, points, turn
from conegraph.types import Array, IntArray, Mask

_ROUNDS = 6
_UNTANGLES = 8
_NONE = np.full(2, np.nan, dtype=np.complex128)
_TURNS_WITHOUT = np.array([(0, 1, 2), (1, 2, 3), (2, 3, 4), (0, 1, 3), (1, 3, 4)]).T
_STEPS_WITHOUT = np.array([(1, 2), (2, 3), (1, 3)]).T
"""Turns and steps among five cones in a row, and then without the third of them."""
_TURNS_WITH = np.array([(0, 1, 2), (1, 2, 3), (0, 1, 4), (1, 4, 2), (4, 2, 3)]).T
_STEPS_WITH = np.array([(1, 2), (1, 4), (4, 2)]).T
"""Among four cones in a row, and then with a fifth in their midst."""


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
    around = p[np.arange(5)[:, None] + np.arange(len(chain))]
    bend = _bend(around[_TURNS_WITHOUT], costs)
    long = _long(around[_STEPS_WITHOUT], costs)
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
    around = p[np.arange(1, 5)[:, None] + np.arange(count)]
    free = points(xy[spare])
    cone, slot = np.nonzero(_beside(free, around[1], around[2], costs.reach_m))
    around = np.vstack([around[:, slot], free[cone]])
    bend = _bend(around[_TURNS_WITH], costs)
    long = _long(around[_STEPS_WITH], costs)
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


def _beside(cone: Points, start: Points, end: Points, reach_m: float) -> Mask:
    """Return which cones (U,) stand beside which segments (S,); (U, S)."""
    edge = end - start
    length = np.maximum(np.abs(edge), 1e-9)
    away = cone[:, None] - start
    along = inner(edge, away) / length
    across = np.abs(outer(edge, away)) / length
    slack = 0.1 * length
    return np.asarray((along > -slack) & (along < length + slack) & (across < reach_m))


def _padded(xy: Array, closed: bool) -> Points:
    """Return the points with two more at either end: of the loop, or NaN."""
    p = points(xy)
    if closed and len(p) > 1:
        return np.concatenate([p[-2:], p, p[:2]])
    return np.concatenate([_NONE, p, _NONE])


def _bend(corners: Points, costs: MendCosts) -> Array:
    """Return the costs (M, K) of turns at the second of three corners (3, M, K).

    It is 0 where one is missing.
    """
    a, b, c = corners
    u, v = b - a, c - b
    bend = np.hypot(turn(u, v), costs.free_rad) - costs.free_rad
    short = np.minimum(np.abs(u), np.abs(v)) / costs.short_m
    cost = costs.bend * bend * np.minimum(short, 1.0) ** 2
    return np.where(cost == cost, cost, 0.0)


def _long(ends: Points, costs: MendCosts) -> Array:
    """Return the costs (M, K) of long steps by their ends (2, M, K).

    It is 0 where one is missing.
    """
    excess = np.abs(ends[1] - ends[0]) - costs.long_m
    return np.where(excess > 0.0, costs.per_long_m * excess, 0.0)
