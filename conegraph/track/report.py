"""What is said about a track: what was left out, bridged, relabelled; how sure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from conegraph.track.cones import Cones
from conegraph.track.mend import are_simple
from conegraph.track.model import Bridge, CenterLine, Relabelled, Track, Unused
from conegraph.track.nearest import Nearest
from conegraph.track.plane import median
from conegraph.track.road import signed_area
from conegraph.types import Array, ConeClass, ConeMap, IntArray, Mask

_BESIDE_M = 1.6
_GAP_RATIO = 1.7
_LEAST_GAP_M = 4.0
_DOUBTFUL = 0.2
"""A track less sure than this is not shown: "I do not know"."""
_USUAL_NATS_PER_M = 0.1
_ENOUGH_CONES = 6


def finished(
    cone_map: ConeMap,
    cones: Cones,
    left: IntArray,
    right: IntArray,
    triangles: IntArray,
    line: CenterLine,
    closed: bool,
    cost: float,
) -> Track:
    """Return the track of boundaries and road, with what there is to say about it.

    Rows are those of the prepared cones; the track has those of the map. The
    confidence is a product of what could be wrong, each factor 1 where nothing is.
    """
    xy, unused = cones.xy_m, _unused(cone_map, cones, left, right, triangles)
    length = float(line.s_m[-1])
    if closed:
        length += float(np.hypot(*(line.xy_m[0] - line.xy_m[-1])))
    wrong = _relabelled(cone_map, cones, left, right)
    on_road = sum(u.reason == _ON_ROAD for u in unused)
    count = len(left) + len(right)
    folded = not are_simple(xy, left, right, closed)
    folded |= bool((signed_area(xy, triangles) <= 0).any())
    width = line.left_m + line.right_m
    spread = float(width.std() / width.mean())
    factors = {
        "boundaries cross": 0.1 if folded else 1.0,
        "few cones": min(1.0, count / _ENOUGH_CONES),
        "colours disagree": math.exp(-3.0 * len(wrong) / count),
        "no colours": 1.0 if cones.coloured else 0.7,
        "cones on the road": math.exp(-3.0 * on_road / count),
        "gaps or uneven steps": math.exp(
            -2.0 * max(0.0, cost / max(length, 1.0) - _USUAL_NATS_PER_M)
        ),
        "width changes": math.exp(-2.0 * max(0.0, spread - 0.15)),
    }
    confidence = math.prod(factors.values())
    reason = ", ".join(k for k, v in factors.items() if v < 0.9)
    if confidence < _DOUBTFUL:
        return Track.unknown(reason, cone_map.id, cone_map.xy_m, unused)
    bridges = [
        bridge
        for side, chain in (("left", left), ("right", right))
        for bridge in _bridges(cone_map.id[cones.row], xy, chain, closed, side)
    ]
    rows = cones.row
    return Track(
        cone_map.id,
        cone_map.xy_m,
        rows[left],
        rows[right],
        rows[triangles],
        replace(line, xy_m=line.xy_m + cones.origin_m),
        closed,
        confidence,
        reason,
        length,
        median(width),
        unused,
        wrong,
        tuple(bridges),
    )


_ON_ROAD = "stands on the road"


def _unused(
    cone_map: ConeMap,
    cones: Cones,
    left: IntArray,
    right: IntArray,
    triangles: IntArray,
) -> tuple[Unused, ...]:
    spare = np.ones(len(cones), dtype=np.bool_)
    spare[left] = spare[right] = False
    rows = np.flatnonzero(spare)
    if len(rows) == 0:
        return cones.unused
    edge = cones.xy_m[np.concatenate([left, right])]
    away, near = Nearest(edge).one(cones.xy_m[rows])
    inside = _inside(cones.xy_m[rows], cones.xy_m, triangles)
    told = []
    found = zip(rows, away, near, inside, strict=True)
    for row, metres, other, within in found:
        side = 0 if other < len(left) else 1
        if within:
            reason = _ON_ROAD
        elif metres > _BESIDE_M:
            reason = "stands away from the road"
        elif cones.start[row]:
            reason = "start cone beside the boundary"
        elif cones.against[side, row] > 1.0:
            reason = "beside a boundary of the other colour"
        else:
            reason = "would put a kink into the boundary"
        told.append(Unused(int(cone_map.id[cones.row[row]]), reason))
    return cones.unused + tuple(told)


def _inside(points: Array, xy: Array, triangles: IntArray) -> Mask:
    """Return which points (U,) stand in one of the triangles (T, 3)."""
    if len(triangles) == 0:
        return np.zeros(len(points), dtype=np.bool_)
    inside = np.ones((len(points), len(triangles)), dtype=np.bool_)
    for k in range(3):
        start = xy[triangles[:, k]]
        edge = xy[triangles[:, (k + 1) % 3]] - start
        away = points[:, None] - start
        inside &= edge[:, 0] * away[..., 1] > edge[:, 1] * away[..., 0]
    return np.asarray(inside.any(axis=1))


def _relabelled(
    cone_map: ConeMap, cones: Cones, left: IntArray, right: IntArray
) -> tuple[Relabelled, ...]:
    kind = cone_map.cone_class
    told = []
    for side, chain, other in (("left", left, 0), ("right", right, 1)):
        wrong = chain[cones.against[other, chain] > 1.0]
        for row in cones.row[wrong].tolist():
            colour = ConeClass(int(kind[row])).label
            told.append(Relabelled(int(cone_map.id[row]), colour, side))
    return tuple(told)


def _bridges(
    ids: IntArray, xy: Array, chain: IntArray, closed: bool, side: str
) -> list[Bridge]:
    following = np.append(chain[1:], chain[: int(closed)])
    chain = chain[: len(following)]
    if len(chain) == 0:
        return []
    gap = np.hypot(*(xy[following] - xy[chain]).T)
    wide = np.flatnonzero(gap > max(_GAP_RATIO * median(gap), _LEAST_GAP_M))
    return [
        Bridge(side, int(ids[chain[k]]), int(ids[following[k]]), float(gap[k]))
        for k in wide.tolist()
    ]
