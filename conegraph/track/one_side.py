"""A lane of which only one boundary is seen, guessed from the usual width."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from conegraph.geometry import to_child
from conegraph.track.centerline import offset_line
from conegraph.track.cones import Cones
from conegraph.track.model import Track
from conegraph.types import Array, ConeMap, IntArray

HALF_LANE_M = 1.75
_CONFIDENCE = 0.3
_REACH_M = 9.0
_TURN_WEIGHT = 3.0
_LEAST_COSINE = -0.3
_BEHIND_M = 2.0
_MOST_CONES = 60
_FEWEST = 2


def one_sided(cone_map: ConeMap, cones: Cones, pose: Array | None) -> Track:
    """Return a lane along the one boundary that is seen, or that nothing is known.

    The boundary goes from the cone nearest to the car to the next by least
    d (1 + 3 (1 - cos a) / 2), a being the turn, for as long as one is within 9 m. The
    middle of the lane is 1.75 m beside it. Without a pose nobody knows which way.
    """
    unknown = Track.unknown(
        "no lane between cones", cone_map.id, cone_map.xy_m, cones.unused
    )
    if pose is None or len(cones) < _FEWEST:
        return unknown
    place = to_child(pose, cones.xy_m)
    fit = (cones.left & (place[:, 1] > -1.0), cones.right & (place[:, 1] < 1.0))
    if cones.sure_left.any() or cones.sure_right.any():
        fit = (cones.sure_left, cones.sure_right)
    chains = [_chain(place, np.flatnonzero(rows)) for rows in fit]
    side = 0 if len(chains[0]) >= len(chains[1]) else 1
    chain = chains[side]
    if len(chain) < _FEWEST:
        return unknown
    sign = -1.0 if side == 0 else 1.0
    line = offset_line(cones.xy_m[chain], sign * HALF_LANE_M)
    if len(line) == 0:
        return unknown
    none = np.zeros(0, dtype=np.int64)
    rows = cones.row[chain]
    return Track(
        cone_map.id,
        cone_map.xy_m,
        rows if side == 0 else none,
        rows if side == 1 else none,
        np.zeros((0, 3), dtype=np.int64),
        replace(line, xy_m=line.xy_m + cones.origin_m),
        closed=False,
        confidence=_CONFIDENCE,
        reason="only one side is seen",
        length_m=float(line.s_m[-1]),
        lane_m=2 * HALF_LANE_M,
        unused=cones.unused,
    )


def _chain(place: Array, rows: IntArray) -> IntArray:
    """Return the boundary ahead of the car among cones in its frame."""
    rows = rows[place[rows, 0] > -_BEHIND_M]
    if len(rows) == 0:
        return rows
    first = int(np.argmin(np.hypot(*place[rows].T)))
    chain, rest = [int(rows[first])], np.delete(rows, first)
    way = np.array([1.0, 0.0])
    while len(rest) and len(chain) < _MOST_CONES:
        step = place[rest] - place[chain[-1]]
        away = np.maximum(np.hypot(*step.T), 1e-9)
        cosine = step @ way / away
        cost = away * (1.0 + 0.5 * _TURN_WEIGHT * (1.0 - cosine))
        cost[(away > _REACH_M) | (cosine < _LEAST_COSINE)] = np.inf
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            break
        way = step[best] / away[best]
        chain.append(int(rest[best]))
        rest = np.delete(rest, best)
    return np.array(chain, dtype=np.int64)
