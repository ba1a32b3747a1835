"""The road as a strip of triangles between two boundaries.

Each triangle steps along one boundary and leans on a cone of the other. The strip is
built between gates that are known; between two of them the triangles with the
shortest sum of new gates are chosen (after Fuchs, Kedem and Uselton 1977). Gates of
an earlier road that still hold are known: what did not change is not built again.
"""

from __future__ import annotations

import numpy as np

from conegraph.track.plane import distinct
from conegraph.types import Array, IntArray

_NEGATIVE = 1e3
"""Cost of a triangle that is turned over: worse than any gate."""
_MAX_CELLS = 250_000


def tile(
    xy_m: Array, left: IntArray, right: IntArray, closed: bool, gates: IntArray
) -> IntArray:
    """Return the triangles of the road; (T, 3), each counter-clockwise.

    Args:
        xy_m: (N, 2) cones.
        left: (L,) left boundary as rows of ``xy_m``.
        right: (R,) right boundary.
        closed: whether the last cones are followed by the first.
        gates: (G, 2) rows of cones, left and right, that face each other; those that
            do not fit the boundaries are left out.
    """
    if min(len(left), len(right)) == 0 or len(left) + len(right) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if closed:
        first = _first_gate(xy_m, left, right, gates)
        left, right = (
            np.concatenate([np.roll(c, -k), c[k : k + 1]])
            for c, k in zip((left, right), first, strict=True)
        )
    knots = _knots(left, right, closed, gates, len(xy_m))
    triangles = _strip(xy_m, left, right, knots)
    if (signed_area(xy_m, triangles) <= 0).any():
        ends = np.array([knots[0], knots[-1]])
        if len(left) * len(right) < _MAX_CELLS:
            again = _strip(xy_m, left, right, ends)
            bad = [(signed_area(xy_m, t) <= 0).sum() for t in (triangles, again)]
            triangles = again if bad[1] < bad[0] else triangles
    return triangles


def signed_area(xy_m: Array, triangles: IntArray) -> Array:
    """Return the area (T,) of triangles, negative where they are clockwise."""
    a, b, c = (xy_m[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def _first_gate(
    xy: Array, left: IntArray, right: IntArray, gates: IntArray
) -> tuple[int, int]:
    """Return the places of the shortest known gate, or of the shortest of all."""
    place_l, place_r = _places(left, len(xy)), _places(right, len(xy))
    i, j = place_l[gates[:, 0]], place_r[gates[:, 1]]
    known = (i >= 0) & (j >= 0)
    if not known.any():
        away = np.hypot(*(xy[left][:, None] - xy[right]).transpose(2, 0, 1))
        best = np.unravel_index(int(np.argmin(away)), away.shape)
        return int(best[0]), int(best[1])
    i, j = i[known], j[known]
    # The earliest on the left keeps the strip's beginning where the boundary's is.
    best_known = int(np.argmin(i * len(xy) + j))
    return int(i[best_known]), int(j[best_known])


def _places(chain: IntArray, n: int) -> IntArray:
    place = np.full(n, -1)
    place[chain[::-1]] = np.arange(len(chain))[::-1]
    return place


def _knots(
    left: IntArray, right: IntArray, closed: bool, gates: IntArray, n: int
) -> IntArray:
    """Return the known gates as places in the boundaries, rising, with both ends."""
    last = np.array([len(left) - 1, len(right) - 1])
    ring = (left[:-1], right[:-1]) if closed else (left, right)
    i, j = (_places(c, n)[gates[:, k]] for k, c in enumerate(ring))
    known = (i >= 0) & (j >= 0)
    if closed:
        # The first cones are the last ones too.
        end_i, end_j = (i == 0) & (2 * j > last[1]), (j == 0) & (2 * i > last[0])
        i, j = np.where(end_i, last[0], i), np.where(end_j, last[1], j)
    width = int(last[1]) + 1
    ends = [0, int(last[0]) * width + int(last[1])]
    key = distinct(np.append(i[known] * width + j[known], ends))
    found = np.stack([key // width, key % width], axis=1)
    # What falls behind the highest place so far would fold the strip.
    rising = found[:, 1] >= np.maximum.accumulate(found[:, 1])
    low = np.minimum.accumulate(found[::-1, 1])[::-1]
    return np.asarray(found[rising & (found[:, 1] <= low)])


def _strip(xy: Array, left: IntArray, right: IntArray, knots: IntArray) -> IntArray:
    """Return the triangles between knots (K, 2), places that rise."""
    advance: list[int] = []
    steps = np.diff(knots, axis=0).tolist()
    for (i, j), (di, dj) in zip(knots[:-1].tolist(), steps, strict=True):
        if di == 0 or dj == 0:
            advance += [0] * di + [1] * dj
        else:
            advance += _shortest(xy[left[i : i + di + 1]], xy[right[j : j + dj + 1]])
    turn = np.array(advance, dtype=np.int64)
    j = np.cumsum(turn) - turn + knots[0, 1]
    i = np.cumsum(1 - turn) - (1 - turn) + knots[0, 0]
    nxt = np.where(
        turn == 0,
        left[np.minimum(i + 1, len(left) - 1)],
        right[np.minimum(j + 1, len(right) - 1)],
    )
    return np.stack([left[i], right[j], nxt], axis=1)


def _shortest(a: Array, b: Array) -> list[int]:
    """Return the steps (0 left, 1 right) between two chains with the least cost."""
    n, m = len(a), len(b)
    gate = np.hypot(*(a[:, None] - b).transpose(2, 0, 1))
    over_left = _turned_over(a[:-1, None], b[None], a[1:, None])
    over_right = _turned_over(a[:, None], b[None, :-1], b[None, 1:])
    step_left = (gate[1:] + _NEGATIVE * over_left).tolist()
    step_right = (gate[:, 1:] + _NEGATIVE * over_right).tolist()
    cost = [[0.0] * m for _ in range(n)]
    for i in range(n):
        for j in range(m):
            by_left = cost[i - 1][j] + step_left[i - 1][j] if i else np.inf
            by_right = cost[i][j - 1] + step_right[i][j - 1] if j else np.inf
            cost[i][j] = min(by_left, by_right) if i or j else 0.0
    i, j = n - 1, m - 1
    steps: list[int] = []
    while i or j:
        from_left = i > 0 and (
            j == 0
            or cost[i - 1][j] + step_left[i - 1][j]
            <= cost[i][j - 1] + step_right[i][j - 1]
        )
        steps.append(0 if from_left else 1)
        i, j = (i - 1, j) if from_left else (i, j - 1)
    return steps[::-1]


def _turned_over(a: Array, b: Array, c: Array) -> Array:
    """Return 1 where triangles of left, right and next are clockwise, 0 elsewhere."""
    u, v = b - a, c - a
    return np.asarray((u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0] <= 0) * 1.0)
