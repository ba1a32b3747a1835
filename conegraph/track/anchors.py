"""A whole course as a tour of anchors: gates that surely belong to it.

A shortest path takes every shortcut that a spoilt map offers. So the course must
visit gates that are beyond doubt, and in which order it does so is an assignment:
each anchor gets one successor, at the cost of the best lane that leads there without
crossing another anchor's line. Shortcuts between neighbours are too short to harm.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from conegraph.track.gates import GateGraph
from conegraph.track.search import LIMIT_NATS, GatePath, crossing, shortest, trace
from conegraph.types import Array, IntArray, Mask

APART_M = 14.0
"""Anchors keep this far from each other."""
SKIP_NATS = 9.0
"""What it costs to leave an anchor out."""
END_NATS = 7.0
"""What it costs a course to begin, and to end, somewhere."""
_SUPPORT_M = 5.0
_SUPPORT_NATS = 2.5
"""An anchor's lane goes on for so far, both ways, for so little."""
_WIDTH_SLACK = 0.25


def choose_anchors(graph: GateGraph, sure: Mask) -> IntArray:
    """Return gates spread over the course, the best first; (M,).

    An anchor is between cones of sure and right colour that are each other's nearest
    on the other side, as wide as the lane usually is.

    Args:
        graph: gates and steps.
        sure: (G,) gates whose cones have the colours of their sides.
    """
    gate = graph.cone[graph.left] - graph.cone[graph.right]
    width = np.hypot(gate.real, gate.imag)
    off = np.abs(width / graph.lane_m - 1.0)
    fit = sure & (off < _WIDTH_SLACK)
    for end in (graph.left, graph.right):
        nearest = np.full(len(graph.cone), np.inf)
        np.minimum.at(nearest, end[sure], width[sure])
        fit &= width <= nearest[end]
    entered, left = (np.zeros(len(graph), dtype=np.bool_) for _ in range(2))
    entered[graph.head] = left[graph.tail] = True
    rows = np.flatnonzero(fit & entered & left)
    rows = rows[np.argsort(off[rows], kind="stable")]
    middle = graph.middle[rows]
    free = np.ones(len(rows), dtype=np.bool_)
    chosen: list[int] = []
    for k in range(len(rows)):
        if free[k]:
            chosen.append(int(rows[k]))
            free &= np.abs(middle - middle[k]) > APART_M
    anchors = np.array(chosen, dtype=np.int64)
    return anchors[_goes_on(graph, anchors)]


def _goes_on(graph: GateGraph, rows: IntArray) -> Mask:
    """Return which gates a lane leads to from afar and leads on from; (R,)."""
    if len(rows) == 0:
        return np.zeros(0, dtype=np.bool_)
    far = np.abs(graph.middle[rows][:, None] - graph.middle) > _SUPPORT_M
    good = np.ones(len(rows), dtype=np.bool_)
    for tail, head in ((graph.tail, graph.head), (graph.head, graph.tail)):
        away, _ = shortest(tail, head, graph.cost, rows, len(graph), _SUPPORT_NATS)
        good &= (np.isfinite(away) & far).any(axis=1)
    return good


def tour(graph: GateGraph, anchors: IntArray, *, first: bool) -> GatePath | None:
    """Return the best course over the anchors, None where nothing joins two.

    A loop where it closes; else the open lane from its first to its last anchor.

    Args:
        graph: gates and steps.
        anchors: (M,) gates to visit.
        first: whether the course must be the one through the first anchor.
    """
    m, n = len(anchors), len(graph)
    away, before = _legs(graph, anchors)
    leg = np.full((m + 1, m + 1), END_NATS)
    leg[:m, :m] = away[:, n:]
    np.fill_diagonal(leg, SKIP_NATS)
    leg[m, m] = 0.0
    leg[~np.isfinite(leg)] = 1e3
    _, successor = linear_sum_assignment(leg)
    order, closed = _course(_patched(leg, successor), first)
    pairs = list(zip(order, [*order[1:], order[0]], strict=True))
    if not closed:
        pairs = pairs[:-1]
    if not pairs:
        return None
    pieces, cost = [], 0.0
    for a, b in pairs:
        if leg[a, b] >= 1e3:
            return None
        path = trace(before[a], int(anchors[a]), n + b)
        pieces.append(path[:-1])
        cost += float(leg[a, b])
    if not closed:
        pieces.append(anchors[order[-1:]])
    gates = np.concatenate(pieces)
    middle = graph.middle[gates]
    step = np.abs(middle - np.roll(middle, 1))
    length = float((step if closed else step[1:]).sum())
    return GatePath(gates, cost, length, closed)


def _legs(graph: GateGraph, anchors: IntArray) -> tuple[Array, IntArray]:
    """Return costs (M, G + M) and predecessors from each anchor.

    Node G + k is anchor k as an end: nothing leads on from there.
    """
    n, m = len(graph), len(anchors)
    keep = np.ones(len(graph.cost), dtype=np.bool_)
    for anchor in anchors.tolist():
        own = (graph.tail == anchor) | (graph.head == anchor)
        keep &= own | ~crossing(graph, anchor)
    end = np.arange(n)
    end[anchors] = n + np.arange(m)
    steps = (graph.tail[keep], end[graph.head[keep]], graph.cost[keep])
    return shortest(*steps, anchors, n + m, LIMIT_NATS)


def _patched(leg: Array, successor: IntArray) -> IntArray:
    """Return the successors with separate tours joined where that costs little."""
    successor = successor.copy()
    while True:
        label = _labels(successor)
        rows = np.flatnonzero(successor != np.arange(len(successor)))
        if len(set(label[rows].tolist())) < 2:
            return successor
        a, b = np.meshgrid(rows, rows, indexing="ij")
        now = leg[a, successor[a]] + leg[b, successor[b]]
        rise = leg[a, successor[b]] + leg[b, successor[a]] - now
        rise[label[a] == label[b]] = np.inf
        best = np.unravel_index(int(np.argmin(rise)), rise.shape)
        if rise[best] > 2 * END_NATS:
            return successor
        i, j = int(a[best]), int(b[best])
        successor[[i, j]] = successor[[j, i]]


def _labels(successor: IntArray) -> IntArray:
    label = np.full(len(successor), -1)
    for start in range(len(successor)):
        at = start
        while label[at] < 0:
            label[at] = start
            at = int(successor[at])
    return label


def _course(successor: IntArray, first: bool) -> tuple[list[int], bool]:
    """Return the anchors of the longest course, or of the first's; and if it loops.

    The last row stands for "begin and end": a cycle through it is an open lane.
    """
    end = len(successor) - 1
    best: list[int] = []
    for start in range(end):
        cycle = [start]
        while int(successor[cycle[-1]]) != start:
            cycle.append(int(successor[cycle[-1]]))
        if len(cycle) > len(best):
            best = cycle
        if first:
            break
    if end in best:
        cut = best.index(end)
        return best[cut + 1 :] + best[:cut], False
    return best, len(best) > 1
