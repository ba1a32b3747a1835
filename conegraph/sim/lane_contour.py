"""The line half-way between blue and yellow cones, found without an order.

In a Delaunay triangulation of blue and yellow points every triangle that has both
colours has exactly two edges with one end of each. Stepping from triangle to
triangle over those edges, they form chains that never branch: the contour between
the colours. On a lane with blue to the left and yellow to the right the middles
of those edges are the centre line, and the colours say which way it runs.

Sparse cones do not fence a lane: where two legs lie close, a triangulation joins
them across it. So the gaps between neighbouring cones of a colour are filled
first, along the edges of their relative neighbourhood graph (Toussaint 1980).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError

from conegraph.sim.polyline import arc_length
from conegraph.types import Array, IntArray

_MAX_WALL_M = 6.5
"""Cones of one colour farther apart are not taken for neighbours: the rules allow
5 m, and two lanes of 3 m lie between walls of one colour that face each other."""
_MAX_LISTED_WALL_M = 15.0
"""Successors of a listed boundary farther apart belong to different parts of it."""
_WALL_STEP_M = 0.8
_MAX_GATE_RATIO = 2.2


@dataclass(frozen=True, slots=True)
class Chain:
    """One contour: middles of its gates (K, 2), gate widths (K,), loop or not."""

    xy_m: Array
    width_m: Array
    closed: bool

    @property
    def length_m(self) -> float:
        """The length of the polyline."""
        return float(arc_length(self.xy_m)[-1])


def contours(left_m: Array, right_m: Array, walls: tuple[Array, Array]) -> list[Chain]:
    """Return the chains between two sets of points, left set on the left.

    Args:
        left_m: (N, 2) points to the left of the lane.
        right_m: (M, 2) points to its right.
        walls: for either side, segments (S, 2, 2) that fence it.

    Returns:
        The chains, none where the points are too few or lie on one line.
    """
    sides = [
        np.vstack([points, _fill(wall)])
        for points, wall in zip((left_m, right_m), walls, strict=True)
    ]
    xy = np.vstack(sides)
    is_left = np.arange(len(xy)) < len(sides[0])
    if min(len(left_m), len(right_m)) < 2:
        return []
    try:
        triangles = Delaunay(xy).simplices.astype(np.int64)
    except QhullError:
        return []
    return _chains(xy, is_left, triangles)


def neighbour_walls(xy_m: Array, other_m: Array) -> tuple[Array, Array]:
    """Return the fences (S, 2, 2) of two colours; of crossing ones the short stays."""
    segments = [_neighbours(points) for points in (xy_m, other_m)]
    a, b = segments
    crossing = _crossing(a, b)
    longer = _length(a)[:, None] > _length(b)[None, :]
    return a[~(crossing & longer).any(axis=1)], b[~(crossing & ~longer).any(axis=0)]


def ordered_wall(xy_m: Array, closed: bool) -> Array:
    """Return the fence (S, 2, 2) of cones that are listed in driving order."""
    segments = np.stack([xy_m, np.roll(xy_m, -1, axis=0)], axis=1)
    segments = segments if closed else segments[:-1]
    return np.asarray(segments[_length(segments) <= _MAX_LISTED_WALL_M])


def _length(segments: Array) -> Array:
    length: Array = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    return length


def _neighbours(xy_m: Array) -> Array:
    """Return relative neighbours: no third cone is nearer to both; (S, 2, 2)."""
    gap = np.linalg.norm(xy_m[:, None] - xy_m[None], axis=2)
    a, b = np.nonzero(np.triu(gap <= _MAX_WALL_M, k=1))
    nearer = np.maximum(gap[a], gap[b]) < gap[a, b][:, None]
    alone = ~nearer.any(axis=1)
    return np.stack([xy_m[a[alone]], xy_m[b[alone]]], axis=1)


def _crossing(a: Array, b: Array) -> NDArray[np.bool_]:
    """Return whether segments of a and b cross; (len(a), len(b))."""

    def side(line: Array, point: Array) -> Array:
        """Twice the area of each line with each point; (lines, points)."""
        d, v = line[:, 1] - line[:, 0], point[None] - line[:, None, 0]
        return np.asarray(d[:, None, 0] * v[..., 1] - d[:, None, 1] * v[..., 0])

    across_a = side(a, b[:, 0]) * side(a, b[:, 1]) < 0
    across_b = side(b, a[:, 0]) * side(b, a[:, 1]) < 0
    return np.asarray(across_a & across_b.T)


def _fill(segments: Array) -> Array:
    """Return points strictly inside the segments, evenly spaced on each; (P, 2)."""
    count = np.maximum(np.ceil(_length(segments) / _WALL_STEP_M).astype(int) - 1, 0)
    which = np.repeat(np.arange(len(segments)), count)
    rank = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 1
    part = (rank / (count[which] + 1))[:, None]
    return np.asarray(segments[which, 0] * (1 - part) + segments[which, 1] * part)


def _chains(xy: Array, is_left: NDArray[np.bool_], triangles: IntArray) -> list[Chain]:
    """Link the gates of a triangulation into chains that run with left on the left.

    Around a triangle's lone left corner the car turns counter-clockwise, around a
    lone right corner clockwise; corners of a triangle come counter-clockwise.
    """
    triangles = _counter_clockwise(xy, triangles)
    lefts = is_left[triangles].sum(axis=1)
    mixed, lefts = triangles[(lefts % 3) > 0], lefts[(lefts % 3) > 0]
    lone_is_left = lefts == 1
    lone = (is_left[mixed] == lone_is_left[:, None]).argmax(axis=1)
    rows = np.arange(len(mixed))
    corner = mixed[rows, lone]
    first, second = mixed[rows, (lone + 1) % 3], mixed[rows, (lone + 2) % 3]
    come = np.where(lone_is_left, first, second)
    leave = np.where(lone_is_left, second, first)
    n = len(xy)
    keys = np.array([_gate_key(corner, far, n) for far in (come, leave)])
    gates, index = np.unique(keys, return_inverse=True)
    before, after = index.reshape(2, -1)
    successor = np.full(len(gates), -1)
    successor[before] = after
    ends = np.stack([xy[gates // n], xy[gates % n]])
    middle, width = ends.mean(axis=0), np.hypot(*(ends[1] - ends[0]).T)
    return [
        _trim(Chain(middle[path], width[path], closed))
        for path, closed in _paths(successor)
    ]


def _counter_clockwise(xy: Array, triangles: IntArray) -> IntArray:
    a, b, c = (xy[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    clockwise = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    return np.where(clockwise[:, None], triangles[:, ::-1], triangles)


def _gate_key(a: IntArray, b: IntArray, n: int) -> IntArray:
    return np.asarray(np.minimum(a, b) * n + np.maximum(a, b))


def _paths(successor: IntArray) -> list[tuple[IntArray, bool]]:
    """Return the chains of a successor table (-1 ends one), and whether they loop."""
    n = len(successor)
    tail = np.flatnonzero(successor >= 0)
    links = coo_array((np.ones(len(tail)), (tail, successor[tail])), shape=(n, n))
    parts, label = connected_components(links, directed=False)
    heads = np.setdiff1d(np.arange(n), successor)
    start = np.full(parts, -1)
    start[label[::-1]] = np.arange(n)[::-1]
    start[label[heads]] = heads
    is_open = np.isin(np.arange(parts), label[heads])
    paths = []
    for part in range(parts):
        path = [int(start[part])]
        while (step := int(successor[path[-1]])) not in (-1, path[0]):
            path.append(step)
        paths.append((np.array(path), not is_open[part]))
    return paths


def _trim(chain: Chain) -> Chain:
    """Cut the ends of an open chain where it leaves the lane: its gates grow wide."""
    if chain.closed:
        return chain
    lane = np.flatnonzero(chain.width_m <= _MAX_GATE_RATIO * np.median(chain.width_m))
    keep = slice(int(lane[0]), int(lane[-1]) + 1)
    return Chain(chain.xy_m[keep], chain.width_m[keep], closed=False)
