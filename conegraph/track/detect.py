"""From a cone map to a track: the one function that users call, and its steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from conegraph.config import Roles, TrackConfig
from conegraph.geometry import to_parent
from conegraph.track.anchors import choose_anchors, tour
from conegraph.track.centerline import center_line
from conegraph.track.cones import MAX_CONES, Cones, prepare
from conegraph.track.gates import GateCosts, GateGraph, gate_graph, lane_width
from conegraph.track.mend import MendCosts, mend, untangle
from conegraph.track.model import Track
from conegraph.track.one_side import one_sided
from conegraph.track.report import finished
from conegraph.track.road import signed_area, tile
from conegraph.track.search import GatePath, find_lane
from conegraph.track.thesis import thesis_track
from conegraph.types import Array, ConeMap, IntArray

_DOUBT_M = 1.0
"""Metres of lane that a nat of doubt must be worth at its open ends."""
_BLIND_DOUBT_M = 4.0
"""The same without colours, when any two rows of cones look like a lane."""
_HORIZON_M = 20.0
_BLIND_HORIZON_M = 30.0
_BEND, _BLIND_BEND = 2.0, 3.0
_NEAR_M = 22.0
"""So far around the car its lane is followed gate by gate, without anchors."""
_BEHIND_M = 0.5
_GATE_CONE_NATS = 2.5
_GATE_COSTS = GateCosts()
_BLIND_COSTS = GateCosts(width_slack=0.35, width=2.0, slant_free=1.6)
_MEND_COSTS = MendCosts()


@dataclass(frozen=True, slots=True)
class Lane:
    """Both boundaries of a lane as rows of the prepared cones.

    Attributes:
        left: (L,) left boundary in driving order.
        right: (R,) right boundary.
        gates: (G, 2) left and right cones that face each other.
        closed: whether it is a loop.
        cost: what the search made of it, in nats.
    """

    left: IntArray
    right: IntArray
    gates: IntArray
    closed: bool
    cost: float


def detect_track(
    cone_map: ConeMap,
    pose: Array | None = None,
    *,
    config: TrackConfig | None = None,
    roles: Roles | None = None,
    previous: Track | None = None,
) -> Track:
    """Return the track that cones form: complete, or as far as it is mapped.

    Gates between cones that may stand left and right are the nodes of a graph, and
    steps of one side its edges (`conegraph.track.gates`). The course is a tour of
    gates beyond doubt (`conegraph.track.anchors`), near the car the lane that starts
    at its pose (`conegraph.track.search`); boundaries are then mended one by one
    (`conegraph.track.mend`). Nothing depends on the order or frame of the cones.

    Args:
        cone_map: cones in any frame.
        pose: (3,) of the car in that frame; says where the lane begins and which way
            it runs, which cones without colours do not.
        config: which method; the default's is the best that was measured.
        roles: what each class of cones means.
        previous: an earlier track over the same ids: where its road still holds, it
            is not built again.

    Returns:
        The track. Where nothing can be said its confidence is 0 and it is empty.
    """
    config = TrackConfig() if config is None else config
    cones = prepare(cone_map, Roles() if roles is None else roles)
    if pose is not None and not np.isfinite(pose).all():
        pose = None
    if len(cones) > MAX_CONES:
        reason = f"{len(cones)} cones, more than {MAX_CONES}"
        return Track.unknown(reason, cone_map.id, cone_map.xy_m, cones.unused)
    if pose is not None:
        pose = np.array([*(pose[:2] - cones.origin_m), pose[2]])
    if config.profile == "thesis":
        return thesis_track(cone_map, cones, pose, config)
    lane_m = lane_width(cones.xy_m, cones.left, cones.right)
    lane = _search(cones, pose, lane_m)
    if lane is None:
        return one_sided(cone_map, cones, pose)
    lane = _mended(cones, lane)
    gates = _known_gates(cones, lane, cone_map, previous)
    triangles = tile(cones.xy_m, lane.left, lane.right, lane.closed, gates)
    if not lane.closed:
        lane, triangles = _unfolded(cones.xy_m, lane, triangles)
    line = center_line(
        cones.xy_m,
        lane.left,
        lane.right,
        triangles,
        lane.closed,
        lane_m,
        None if pose is None else pose[:2],
    )
    if len(line) == 0:
        return one_sided(cone_map, cones, pose)
    return finished(
        cone_map, cones, lane.left, lane.right, triangles, line, lane.closed, lane.cost
    )


def _search(cones: Cones, pose: Array | None, lane_m: float) -> Lane | None:
    """Return the lane through the car's place, or the longest; None without one."""
    if min(cones.left.sum(), cones.right.sum()) == 0 or len(cones) < 3:
        return None
    if pose is None and not cones.coloured:
        return None
    graph, car = _graph(cones, pose, lane_m)
    if len(graph) == 0 or len(graph.cost) == 0:
        return None
    anchors = np.zeros(0, dtype=np.int64)
    if cones.coloured and _reaches_far(cones, pose):
        sure = np.zeros((2, len(graph.cone)), dtype=np.bool_)
        sure[0, : len(cones)], sure[1, : len(cones)] = cones.sure_left, cones.sure_right
        anchors = choose_anchors(graph, sure[0][graph.left] & sure[1][graph.right])
    if car is not None and pose is not None:
        away = np.abs(graph.middle[anchors] - complex(*pose[:2]))
        anchors = np.concatenate([[car], anchors[away > _NEAR_M]])
    if len(anchors) == 0:
        return None
    alone = len(anchors) == 1
    course = None if alone else tour(graph, anchors, first=car is not None)
    if course is None:
        course = GatePath(anchors[:1], 0.0, 0.0, False)
    if not course.closed:
        course = _extended(graph, course, cones.coloured, alone)
    start = None
    if car is None and cones.start.any():
        start = complex(*np.median(cones.xy_m[cones.start], axis=0))
    return _lane(graph, course, len(cones), start)


def _reaches_far(cones: Cones, pose: Array | None) -> bool:
    """Return whether there is more than the car's surroundings."""
    if pose is None:
        return True
    return bool((np.hypot(*(cones.xy_m - pose[:2]).T) > _NEAR_M).any())


def _graph(
    cones: Cones, pose: Array | None, lane_m: float
) -> tuple[GateGraph, int | None]:
    """Return the graph and, with a pose, the gate at the car between cones of air."""
    xy, against, left, right = cones.xy_m, cones.against, cones.left, cones.right
    costs = _GATE_COSTS if cones.coloured else _BLIND_COSTS
    if pose is None:
        return gate_graph(xy, against, left, right, lane_m, costs), None
    n = len(xy)
    half = 0.5 * lane_m
    gate = to_parent(pose, np.array([[-_BEHIND_M, half], [-_BEHIND_M, -half]]))
    graph = gate_graph(
        np.vstack([xy, gate]),
        np.hstack([against, np.zeros((2, 2))]),
        np.concatenate([left, [True, False]]),
        np.concatenate([right, [False, True]]),
        lane_m,
        costs,
    )
    at = np.flatnonzero((graph.left == n) & (graph.right == n + 1))
    return graph, int(at[0]) if len(at) else None


def _extended(
    graph: GateGraph, course: GatePath, coloured: bool, may_close: bool
) -> GatePath:
    """Return an open course with what lies before its first and after its last gate.

    Or, if it may close, the lap through its last gate.
    """
    find = partial(
        find_lane,
        graph,
        doubt=_DOUBT_M if coloured else _BLIND_DOUBT_M,
        horizon_m=_HORIZON_M if coloured else _BLIND_HORIZON_M,
        bend=_BEND if coloured else _BLIND_BEND,
    )
    first, last = int(course.gates[0]), int(course.gates[-1])
    ahead = find(last, used=course.gates, may_close=may_close)
    if ahead.closed:
        return ahead
    used = np.concatenate([course.gates, ahead.gates])
    behind = find(first, used=used, backward=True)
    return GatePath(
        np.concatenate([behind.gates[:-1], course.gates, ahead.gates[1:]]),
        behind.cost + course.cost + ahead.cost,
        behind.length_m + course.length_m + ahead.length_m,
        closed=False,
    )


def _lane(graph: GateGraph, course: GatePath, n: int, start: complex | None) -> Lane:
    """Return the boundaries along a course, a loop from its start; no cones of air."""
    left, right = graph.left[course.gates], graph.right[course.gates]
    real = (left < n) & (right < n)
    gates = np.stack([left[real], right[real]], axis=1)
    if course.closed and start is not None and len(gates):
        away = np.abs(graph.middle[course.gates] - start)
        turn = -int(np.argmin(away))
        left, right, gates = (np.roll(x, turn, axis=0) for x in (left, right, gates))
    chains = [_chain(side[side < n], course.closed) for side in (left, right)]
    return Lane(chains[0], chains[1], gates, course.closed, course.cost)


def _chain(cones: IntArray, closed: bool) -> IntArray:
    """Return a boundary without repeats of a cone that waited."""
    if len(cones) == 0:
        return cones
    fresh = np.concatenate([[True], cones[1:] != cones[:-1]])
    chain = cones[fresh]
    repeats = closed and len(chain) > 1 and chain[0] == chain[-1]
    return np.asarray(chain[:-1] if repeats else chain)


def _mended(cones: Cones, lane: Lane) -> Lane:
    chains = [lane.left, lane.right]
    # Gate cones stand on a boundary or beside it: they must fit it well.
    against = cones.against + _GATE_CONE_NATS * cones.start
    for side in (0, 1):
        free = np.ones(len(cones), dtype=np.bool_)
        free[chains[1 - side]] = False
        chains[side] = mend(
            cones.xy_m,
            chains[side],
            lane.closed,
            against[side],
            free,
            _MEND_COSTS,
        )
    left, right = untangle(
        cones.xy_m, chains[0], chains[1], lane.closed, against, _MEND_COSTS
    )
    return replace(lane, left=left, right=right)


def _unfolded(xy: Array, lane: Lane, triangles: IntArray) -> tuple[Lane, IntArray]:
    """Return the longest stretch of an open road without a triangle turned over."""
    bad = np.flatnonzero(signed_area(xy, triangles) <= 0)
    if len(bad) == 0:
        return lane, triangles
    ends = np.concatenate([[-1], bad, [len(triangles)]])
    run = int(np.argmax(np.diff(ends)))
    triangles = triangles[ends[run] + 1 : ends[run + 1]]
    left, right = (c[np.isin(c, triangles)] for c in (lane.left, lane.right))
    return replace(lane, left=left, right=right), triangles


def _known_gates(
    cones: Cones, lane: Lane, cone_map: ConeMap, previous: Track | None
) -> IntArray:
    """Return the gates for the road: an earlier road's, and those of new cones."""
    if previous is None or len(previous.triangles) == 0:
        return lane.gates
    ids = cone_map.id[cones.row]
    order = np.argsort(ids)
    old = previous.triangle_id[:, :2]
    at = np.searchsorted(ids[order], old).clip(max=len(ids) - 1)
    rows = order[at]
    there = (ids[rows] == old).all(axis=1)
    known = np.concatenate([previous.left_id, previous.right_id])
    fresh = ~np.isin(ids[lane.gates], known).all(axis=1)
    return np.concatenate([rows[there], lane.gates[fresh]])
