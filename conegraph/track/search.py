"""The best way through the graph of gates: a loop, or a stretch of open lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from conegraph.track.gates import GateGraph
from conegraph.track.plane import turn
from conegraph.types import Array, IntArray, Mask

_FENCE_LANES = 0.8
"""How far a start gate's line reaches beyond its cones, in lane widths: what runs
around one of them crosses it, the next leg of the course does not."""
_SHARPEST_M = 4.5
_FREE_TURN_RAD = 0.15
LIMIT_NATS = 40.0
"""Courses that cost more between two gates beyond doubt are not sought."""
_SHORTEST_LAP_M = 15.0
_LAP_NATS_PER_M = 0.12


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
    tail: IntArray,
    head: IntArray,
    cost: Array,
    start: IntArray,
    nodes: int,
    limit: float = np.inf,
) -> tuple[Array, IntArray]:
    """Return costs (S, N) from each start, infinite beyond, and predecessors (S, N).

    Args:
        tail: (T,) node that a step leaves.
        head: (T,) node that it reaches.
        cost: (T,) of the step.
        start: (S,) nodes to start from.
        nodes: how many there are, N.
        limit: the highest cost to follow.
    """
    order = np.lexsort((head, tail))
    first = np.searchsorted(tail[order], np.arange(nodes + 1))
    data = (cost[order], head[order], first)
    matrix: csr_array = csr_array(data, shape=(nodes, nodes))
    away, before = dijkstra(
        matrix, indices=start, return_predecessors=True, limit=limit
    )
    return np.asarray(away), np.asarray(before, dtype=np.int64)


def find_lane(
    graph: GateGraph,
    start: int,
    *,
    doubt: float,
    horizon_m: float,
    bend: float,
    used: IntArray,
    backward: bool = False,
    may_close: bool = False,
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
        used: gates of the course that is known; their cones are not used again.
        backward: look for what lies before the start; the path still ends in it.
        may_close: return the lap through the start instead, where there is one.
    """
    tail, head = (graph.head, graph.tail) if backward else (graph.tail, graph.head)
    first = tail == start
    if not first.any():
        return GatePath(np.array([start]), 0.0, 0.0, False)
    keep = first | ~crossing(graph, start) & _fresh(graph, start, used)
    away, before = shortest(
        tail[keep], head[keep], graph.cost[keep], np.array([start]), len(graph)
    )
    tree = away[0], before[0]
    if may_close and (lap := _lap(graph, start, *tree)) is not None:
        return lap
    length, excess, sound = _followed(graph, start, *tree)
    total = np.where(sound, away[0] + bend * excess, 0.0)
    worth = -horizon_m * np.expm1(-length / horizon_m)
    score = np.where(sound, worth - doubt * total, -np.inf)
    end = int(np.argmax(score))
    gates = trace(before[0], start, end)
    gates = gates[::-1] if backward else gates
    return GatePath(gates, float(total[end]), float(length[end]), False)


def _lap(
    graph: GateGraph, start: int, away: Array, before: IntArray
) -> GatePath | None:
    """Return the cheapest loop through a gate by the tree from it, if it is a lap.

    Nothing but its length and its ease tells a lap from a turn around some cones.
    """
    into = np.flatnonzero(graph.head == start)
    total = away[graph.tail[into]] + graph.cost[into]
    if len(into) == 0 or not np.isfinite(total.min()):
        return None
    best = int(np.lexsort((away[graph.tail[into]], total))[0])
    gates = trace(before, start, int(graph.tail[into[best]]))
    middle = graph.middle[gates]
    length = float(np.abs(middle - np.roll(middle, 1)).sum())
    shared = np.isin(graph.left[gates], graph.right[gates]).any()
    dear = total[best] > min(_LAP_NATS_PER_M * length, LIMIT_NATS)
    if shared or length < _SHORTEST_LAP_M or dear:
        return None
    return GatePath(gates, 0.0, length, True)


def _fresh(graph: GateGraph, start: int, used: IntArray) -> Mask:
    """Return which steps use no cone of used gates, but those of the start; (T,)."""
    spent = np.zeros(len(graph.cone), dtype=np.bool_)
    spent[graph.left[used]] = spent[graph.right[used]] = True
    spent[[graph.left[start], graph.right[start]]] = False
    gone = spent[graph.left] | spent[graph.right]
    return ~(gone[graph.tail] | gone[graph.head])


def _followed(
    graph: GateGraph, start: int, away: Array, before: IntArray
) -> tuple[Array, Array, Mask]:
    """Return what the path to each gate is like: length, excess, soundness; (G,) each.

    The length is along the middles; the excess is by how many rad it turns sharper
    than a car can, taken over two steps, in which both sides usually move. It is
    sound if it is a lane: one that comes back to one of its cones is none.
    """
    reached = np.flatnonzero(before >= 0)
    reached = reached[np.argsort(away[reached], kind="stable")]
    parent = before[reached]
    grand = np.where(parent == start, start, before[parent])
    great = np.where(grand == start, start, before[grand])
    middle, left = graph.middle, graph.left
    step = np.abs(middle[reached] - middle[parent])
    old, way = middle[parent] - middle[great], middle[reached] - middle[grand]
    # A path that has just begun has no direction to turn from.
    rad = np.abs(turn(np.where(old == 0, way, old), way))
    sharper = np.maximum(rad - step / _SHARPEST_M - _FREE_TURN_RAD, 0.0)
    fresh = np.where(left[reached] == left[parent], graph.right[reached], left[reached])
    length, excess = ([0.0] * len(graph) for _ in range(2))
    cones = [0] * len(graph)
    cones[start] = 1 << int(left[start]) | 1 << int(graph.right[start])
    ways = (reached, parent, step, sharper, fresh)
    for gate, u, metres, more, cone in zip(*(w.tolist() for w in ways), strict=True):
        excess[gate] = excess[u] + more
        if cones[u] and not cones[u] >> cone & 1:
            cones[gate] = cones[u] | 1 << cone
            length[gate] = length[u] + metres
    sound = np.array([c > 0 for c in cones])
    return np.array(length), np.array(excess), sound


def trace(before: IntArray, start: int, end: int) -> IntArray:
    """Return the gates from start to end by their predecessors (G,)."""
    path = [end]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1], dtype=np.int64)


def crossing(graph: GateGraph, start: int) -> Mask:
    """Return which steps' middles cross the line of a gate or its extension; (T,)."""
    left, right = graph.cone[graph.left[start]], graph.cone[graph.right[start]]
    across = left - right
    width = float(np.abs(across))
    place = (graph.middle - 0.5 * (left + right)) * (across / width).conj()
    ahead, aside = -place.imag, place.real
    crosses = (ahead >= 0)[graph.tail] != (ahead >= 0)[graph.head]
    rows = np.flatnonzero(crosses)
    u, v = graph.tail[rows], graph.head[rows]
    share = ahead[u] / (ahead[u] - ahead[v])
    where = aside[u] * (1.0 - share) + aside[v] * share
    crosses[rows] = np.abs(where) < 0.5 * width + _FENCE_LANES * graph.lane_m
    return np.asarray(crosses)
