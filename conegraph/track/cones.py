"""The cones of a map as track detection needs them: checked, sorted, with sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from conegraph.config import Roles
from conegraph.track.model import Unused
from conegraph.types import Array, ConeMap, IntArray, Mask

MAX_CONES = 3000
"""More are no course: the tables of gates would grow with their square."""
_SAME_PLACE_M = 0.06
_MAY_STAND = 0.3
_SURE = 0.7
_MOST_AGAINST = 2.5
_NO_COLOUR_NATS = 0.8


@dataclass(frozen=True, slots=True)
class Cones:
    """Cones in an order that depends on nothing but where they stand.

    Attributes:
        row: (N,) row of the map for each.
        xy_m: (N, 2) positions about their mean.
        origin_m: (2,) that mean.
        against: (2, N) cost in nats of standing on the left, on the right.
        left: (N,) may stand on the left.
        right: (N,) may stand on the right.
        sure_left: (N,) has the colour of the left side.
        sure_right: (N,) has the colour of the right side.
        coloured: whether colours tell left from right.
        start: (N,) has the role of a start cone.
        unused: cones that were left out, with reasons.
    """

    row: IntArray
    xy_m: Array
    origin_m: Array
    against: Array
    left: Mask
    right: Mask
    sure_left: Mask
    sure_right: Mask
    coloured: bool
    start: Mask
    unused: tuple[Unused, ...]

    def __len__(self) -> int:
        return len(self.row)


def prepare(cone_map: ConeMap, roles: Roles) -> Cones:
    """Return the cones that make sense, sorted by place.

    Positions that are not finite are left out, and of cones that stand in one place
    all but the one seen most often.
    """
    ids, xy = cone_map.id, cone_map.xy_m
    finite = np.isfinite(xy).all(axis=1) & (np.abs(xy) < 1e7).all(axis=1)
    unused = [Unused(int(i), "position is not finite") for i in ids[~finite].tolist()]
    row = np.flatnonzero(finite)
    row = row[np.lexsort((-cone_map.observations[row], xy[row, 1], xy[row, 0]))]
    row, twins = _without_twins(xy, row, cone_map.observations)
    unused += [Unused(int(i), "stands where another cone does") for i in ids[twins]]
    origin = xy[row].mean(axis=0) if len(row) else np.zeros(2)
    prob = cone_map.class_prob[row]
    prob = np.where(np.isfinite(prob), prob, 0.0)
    role = (roles.blue, roles.yellow, roles.orange, roles.big_orange, roles.unknown)
    on_left, on_right = (prob @ [r == side for r in role] for side in ("left", "right"))
    start = prob @ [r == "start" for r in role] > 0.5
    neither = np.maximum(1.0 - on_left - on_right, 0.0)
    share = np.stack([on_left, on_right]) + 0.5 * neither
    odds = np.log(2 * np.clip(share, 1e-3, 0.5))
    against = np.clip(-odds, 0.0, _MOST_AGAINST)
    sure_left, sure_right = share > _SURE
    fewest = min(np.count_nonzero(sure_left), np.count_nonzero(sure_right))
    coloured = bool(fewest >= max(1, len(row) // 8))
    if coloured:
        # Where cones have colours, one without stands there for something else.
        against += _NO_COLOUR_NATS * ((neither > 0.5) & ~start)
    return Cones(
        row,
        xy[row] - origin,
        origin,
        against,
        share[0] >= _MAY_STAND,
        share[1] >= _MAY_STAND,
        sure_left,
        sure_right,
        coloured,
        start,
        tuple(unused),
    )


def _without_twins(
    xy: Array, row: IntArray, observations: IntArray
) -> tuple[IntArray, IntArray]:
    """Return the rows to keep, and those that stand where a kept one does."""
    if len(row) < 2:
        return row, row[:0]
    pairs = cKDTree(xy[row]).query_pairs(_SAME_PLACE_M, output_type="ndarray")
    if len(pairs) == 0:
        return row, row[:0]
    seen = observations[row]
    drop = np.zeros(len(row), dtype=np.bool_)
    for a, b in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():
        if not (drop[a] or drop[b]):
            drop[a if seen[a] < seen[b] else b] = True
    return row[~drop], row[drop]
