"""The best way through the graph of gates: a loop, or a stretch of open lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from conegraph.track.gates import GateGraph
from conegraph.types import Array, IntArray, Mask

_FENCE_LANES = 0.8
"""How far a start gate's line reaches beyond its cones, in lane widths: what runs
around one of them crosses it, the next leg of the course does not."""
_SHARPEST_M = 4.5
_FREE_TURN_RAD = 0.15


@dataclass(frozen=True, slots=True)
class GatePath:
    """A way of the lane.

    Attributes:
        gates: (K,) gates in driving order; of a loop the first is not repeated.
        cost: of all its steps, in nats.
        length_m: along the middles of the gates.
        closed: whether it is a loop.
    """

    gates: IntArray
    cost: float
    length_m: float
    closed: bool


def shortest(
    steps: csr_array, start: IntArray, limit: float = np.inf
) -> tuple[Array, IntArray]:
    """Return costs (S, G) from each start, infinite beyond, and predecessors (S, G)."""
    away, before = dijkstra(steps, indices=start, return_predecessors=True, limit=limit)
    return np.asarray(away), np.asarray(before, dtype=np.int64)


def find_lane(
    graph: GateGraph,
    start: int,
    *,
    doubt: float,
    horizon_m: float,
    bend: float = 0.0,
    backward: bool = False,
    used: IntArray | None = None,
) -> GatePath:
    """Return the open lane from a gate that goes farthest for its cost.

    It ends where ``h (1 - exp(-length / h)) - doubt * cost`` is largest, h being the
    horizon: what is far is worth less, so that a lane out of sight is not sought in
    the next leg of the course.

    Args:
        graph: gates and steps.
        start: the gate to start in.
        doubt: metres of lane that one nat of cost must be worth.
        horizon_m: how far ahead lane is worth much.
        bend: nats for each rad by which the middle of the lane turns sharper than a
            car can.
        backward: look for what lies before the start; the path still ends in it.
        used: gates of the course that is known; their cones are not used again.
    """
    keep = ~crossing(graph, start)
    if used is not None:
        keep &= _fresh(graph, start, used)
    keep |= (graph.tail if not backward else graph.head) == start
    matrix = graph.matrix(keep)
    way = csr_array(matrix.T) if backward else matrix
    (away,), (before,) = shortest(way, np.array([start]))
    length, sound = _lengths(graph, away, before)
    away = away + bend * _bends(graph, away, before) if bend else away
    worth = -horizon_m * np.expm1(-length / horizon_m)
    score = np.where(sound, worth - doubt * np.where(sound, away, 0.0), -np.inf)
    score[start] = 0.0
    end = int(np.argmax(score))
    gates = trace(before, start, end)
    return GatePath(
        gates[::-1] if backward else gates, float(away[end]), float(length[end]), False
    )


def _fresh(graph: GateGraph, start: int, used: IntArray) -> Mask:
    """Return which steps use no cone of used gates, but those of the start; (T,)."""
    spent = np.zeros(len(graph.xy_m), dtype=np.bool_)
    spent[graph.left[used]] = spent[graph.right[used]] = True
    spent[[graph.left[start], graph.right[start]]] = False
    gone = spent[graph.left] | spent[graph.right]
    return ~(gone[graph.tail] | gone[graph.head])


def _bends(graph: GateGraph, away: Array, before: IntArray) -> Array:
    """Return how much sharper than a car can each gate's path turns in all; rad (G,).

    Directions are taken over two steps, in which both sides usually move.
    """
    middle = graph.middle_m
    root = np.flatnonzero(away == 0)[:1]
    parent = np.where(before >= 0, before, root)
    grand = parent[parent]
    way = middle - middle[grand]
    old = way[parent]
    turn = np.arctan2(
        old[:, 0] * way[:, 1] - old[:, 1] * way[:, 0], (old * way).sum(axis=1)
    )
    step = np.hypot(*(middle - middle[parent]).T)
    excess = np.maximum(np.abs(turn) - step / _SHARPEST_M - _FREE_TURN_RAD, 0.0)
    reached = np.flatnonzero(np.isfinite(away) & (before >= 0))
    reached = reached[np.argsort(away[reached], kind="stable")]
    total = [0.0] * len(away)
    for gate, u, more in zip(
        reached.tolist(),
        parent[reached].tolist(),
        excess[reached].tolist(),
        strict=True,
    ):
        total[gate] = total[u] + more
    return np.array(total)


def _lengths(graph: GateGraph, away: Array, before: IntArray) -> tuple[Array, Mask]:
    """Return how far each gate is along its path, and whether the path is a lane.

    A lane that comes back to one of its cones, on either side, is none.
    """
    middle = graph.middle_m
    reached = np.flatnonzero(np.isfinite(away) & (before >= 0))
    reached = reached[np.argsort(away[reached], kind="stable")]
    previous = before[reached]
    step = np.hypot(*(middle[reached] - middle[previous]).T)
    stays = graph.left[reached] == graph.left[previous]
    fresh = np.where(stays, graph.right[reached], graph.left[reached])
    length = [0.0] * len(away)
    cones = [0] * len(away)
    for root in np.flatnonzero(away == 0).tolist():
        cones[root] = 1 << int(graph.left[root]) | 1 << int(graph.right[root])
    for gate, u, metres, cone in zip(
        reached.tolist(), previous.tolist(), step.tolist(), fresh.tolist(), strict=True
    ):
        mark = 1 << cone
        if cones[u] and not cones[u] & mark:
            cones[gate] = cones[u] | mark
            length[gate] = length[u] + metres
    return np.array(length), np.array([c > 0 for c in cones])


def trace(before: IntArray, start: int, end: int) -> IntArray:
    """Return the gates from start to end by their predecessors (G,)."""
    path = [end]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1], dtype=np.int64)


def crossing(graph: GateGraph, start: int) -> Mask:
    """Return which steps' middles cross the line of a gate or its extension; (T,)."""
    left, right = (graph.xy_m[c[start]] for c in (graph.left, graph.right))
    across = left - right
    width = float(np.hypot(*across))
    across = across / width
    middle = graph.middle_m - 0.5 * (left + right)
    ahead = middle[:, 0] * across[1] - middle[:, 1] * across[0]
    aside = middle @ across
    a, b = ahead[graph.tail], ahead[graph.head]
    crosses = (a >= 0) != (b >= 0)
    share = np.where(crosses, a / np.where(crosses, a - b, 1.0), 0.0)
    where = aside[graph.tail] * (1.0 - share) + aside[graph.head] * share
    reach = 0.5 * width + _FENCE_LANES * graph.lane_m
    return np.asarray(crosses & (np.abs(where) < reach))
