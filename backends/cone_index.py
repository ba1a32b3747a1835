"""A cone map laid out for look-ups by place, by distance between two, by colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from conegraph.types import N_CLASSES, Array, ConeMap, IntArray

CELL_M = 0.1
"""Side of a raster cell; wider where the map would need more than `MOST_CELLS`."""

MOST_CELLS = 4_000_000

REACH_M = 1.5
"""A place farther than this from every cone has none."""

NEAREST_PAIR_M = 1.0
"""Cones nearer to each other say little about direction and make no pair."""

MISNAMED = 0.1
"""Chance that a class is wrong that both map and sensor are sure of."""


@dataclass(frozen=True, slots=True)
class ConePairs:
    """Ordered pairs of cones, by distance.

    Attributes:
        first: (p,) cone.
        second: (p,) another cone.
        length_m: (p,) their distance, ascending.
        angle_rad: (p,) direction from the first to the second.
    """

    first: IntArray
    second: IntArray
    length_m: Array
    angle_rad: Array


class ConeIndex:
    """What the search asks of a map, answered for thousands of places at once.

    Attributes:
        xy_m: (M + 1, 2) the cones, and far away one that stands for none.
        cov_m2: (M + 1, 2, 2) their covariances.
        pairs: every two cones not too far apart.
    """

    def __init__(self, cone_map: ConeMap, pair_m: float) -> None:
        """Lay out a map, with pairs up to a length."""
        self.n = len(cone_map)
        self.xy_m = np.vstack([cone_map.xy_m, [[1e6, 1e6]]])
        self.cov_m2 = np.concatenate([cone_map.cov_m2, np.eye(2)[None]])
        self.pairs = _pairs(cone_map.xy_m, pair_m)
        self._frequency = 0.9 * cone_map.class_prob.mean(axis=0) + 0.1 / N_CLASSES
        self._class_prob = (
            1.0 - MISNAMED
        ) * cone_map.class_prob + MISNAMED * self._frequency
        self._lay_out(cone_map.xy_m)

    def _lay_out(self, xy_m: Array) -> None:
        """Write each cone into the cells within its reach, the nearest one last."""
        self._low_m = xy_m.min(axis=0) - REACH_M
        span = xy_m.max(axis=0) + REACH_M - self._low_m
        self._cell_m = max(CELL_M, float(np.sqrt(span.prod() / MOST_CELLS)))
        self._shape = np.ceil(span / self._cell_m).astype(np.int64) + 1
        steps = int(REACH_M / self._cell_m) + 1
        line = np.arange(-steps, steps + 1)
        block = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
        home = np.rint((xy_m - self._low_m) / self._cell_m).astype(np.int64)
        cell = home[:, None] + block
        place = cell * self._cell_m + self._low_m
        gap = np.hypot(*np.moveaxis(place - xy_m[:, None], -1, 0))
        inside = ((cell >= 0) & (cell < self._shape)).all(axis=2) & (gap < REACH_M)
        cone, _ = np.nonzero(inside)
        flat = (cell[..., 0] * self._shape[1] + cell[..., 1])[inside]
        order = np.argsort(-gap[inside], kind="stable")
        self._nearest = np.full(int(self._shape.prod()) + 1, self.n, dtype=np.int64)
        self._nearest[flat[order]] = cone[order]

    def nearest(self, x_m: Array, y_m: Array) -> IntArray:
        """Return the cone nearest to each place, M where none is in reach."""
        i = np.rint((x_m - self._low_m[0]) / self._cell_m).astype(np.int64)
        j = np.rint((y_m - self._low_m[1]) / self._cell_m).astype(np.int64)
        inside = (i >= 0) & (j >= 0) & (i < self._shape[0]) & (j < self._shape[1])
        found: IntArray = self._nearest[np.where(inside, i * self._shape[1] + j, -1)]
        return found

    def log_colour(self, likelihood: Array) -> Array:
        """Return (n, M + 1) log-likelihood ratios of sightings' classes.

        ``log sum_c p(seen | c) p(c | cone) - log sum_c p(seen | c) p(c)``, where p(c)
        is the share of the class in the map; 0 for no cone.
        """
        whole = likelihood.sum(axis=1, keepdims=True)
        seen = likelihood / np.maximum(whole, 1e-12)
        by_cone = seen @ self._class_prob.T
        anywhere = seen @ self._frequency
        ratio = np.log(np.maximum(by_cone, 1e-6) / np.maximum(anywhere, 1e-6)[:, None])
        return np.hstack([ratio, np.zeros((len(likelihood), 1))])


def _pairs(xy_m: Array, longest_m: float) -> ConePairs:
    near = cKDTree(xy_m).query_pairs(longest_m, output_type="ndarray").astype(np.int64)
    first = np.concatenate([near[:, 0], near[:, 1]])
    second = np.concatenate([near[:, 1], near[:, 0]])
    away = xy_m[second] - xy_m[first]
    length = np.hypot(away[:, 0], away[:, 1])
    order = np.argsort(length, kind="stable")
    order = order[length[order] >= NEAREST_PAIR_M]
    away = away[order]
    return ConePairs(
        first[order], second[order], length[order], np.arctan2(away[:, 1], away[:, 0])
    )
