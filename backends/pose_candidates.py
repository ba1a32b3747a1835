"""Poses worth a look: every way to lay two seen cones on two of the map."""

from __future__ import annotations

import numpy as np

from conegraph.backends.cone_index import ConeIndex
from conegraph.backends.sightings import Sightings
from conegraph.geometry import rotation, wrap_angle
from conegraph.types import Array, IntArray

BASES = 10
"""Seen pairs that are laid on the map."""

MOST = 3000
"""Poses after which no further pair is tried."""

SURE = 14
"""Most precisely seen cones of which pairs are made."""

USES = 3
"""In how many pairs one seen cone takes part: it may be false."""

SHORTEST_M = 2.0
"""A shorter pair leaves the heading open."""

WRONG_COLOURS = -2.5
"""Log-likelihood ratio of two cones' colours below which a pair is not tried."""

TOLERANCE = 2.5
"""By how many sigmas the lengths of two equal pairs may differ."""

LONG_ENOUGH_M = 8.0
"""Longer pairs fix a pose no better."""


def candidate_poses(
    index: ConeIndex, seen: Sightings, log_colour: Array, map_sigma_m: float
) -> Array:
    """Return poses (h, 3) that lay a pair of sightings on a pair of the map.

    The pairs that have the fewest counterparts go first.

    Args:
        index: the map.
        seen: what the car sees.
        log_colour: (n, M + 1) of `ConeIndex.log_colour`.
        map_sigma_m: how far a cone may stand from where the map has it.
    """
    a, b, length, sigma = _bases(seen, map_sigma_m)
    pairs = index.pairs
    inside = length < pairs.length_m[-1] if len(pairs.length_m) else np.zeros(0, bool)
    if not inside.any():
        return np.zeros((0, 3))
    a, b, length, sigma = a[inside], b[inside], length[inside], sigma[inside]
    low = np.searchsorted(pairs.length_m, length - TOLERANCE * sigma)
    high = np.searchsorted(pairs.length_m, length + TOLERANCE * sigma)
    order = np.argsort((high - low) / np.minimum(length, LONG_ENOUGH_M), kind="stable")
    used = np.zeros(len(seen), dtype=np.int64)
    found: list[Array] = []
    for q in order.tolist():
        i, j = int(a[q]), int(b[q])
        if used[i] >= USES or used[j] >= USES:
            continue
        rows = np.arange(low[q], high[q])
        colour = log_colour[i, pairs.first[rows]] + log_colour[j, pairs.second[rows]]
        rows = rows[colour > WRONG_COLOURS]
        used[[i, j]] += 1
        if len(rows):
            found.append(_laid(index, seen.xy_m[[i, j]], rows))
        if len(found) == BASES or sum(map(len, found)) > MOST:
            break
    return np.vstack(found) if found else np.zeros((0, 3))


def _bases(
    seen: Sightings, map_sigma_m: float
) -> tuple[IntArray, IntArray, Array, Array]:
    """Return sightings a, b of each pair, its length and that length's sigma."""
    spread = np.trace(seen.cov_m2, axis1=1, axis2=2)
    sure = np.argsort(spread, kind="stable")[:SURE].astype(np.int64)
    i, j = np.triu_indices(len(sure), 1)
    a, b = sure[i], sure[j]
    away = seen.xy_m[b] - seen.xy_m[a]
    length = np.hypot(away[:, 0], away[:, 1])
    along = away / np.maximum(length, 1e-9)[:, None]
    cov = seen.cov_m2[a] + seen.cov_m2[b] + 2.0 * map_sigma_m**2 * np.eye(2)
    sigma = np.sqrt(np.einsum("pi,pij,pj->p", along, cov, along))
    long = length > SHORTEST_M
    return a[long], b[long], length[long], sigma[long]


def _laid(index: ConeIndex, xy_m: Array, rows: IntArray) -> Array:
    """Return the poses (h, 3) that lay two points on the pairs in the rows."""
    pairs = index.pairs
    away = xy_m[1] - xy_m[0]
    yaw = wrap_angle(pairs.angle_rad[rows] - np.arctan2(away[1], away[0]))
    middle = 0.5 * (index.xy_m[pairs.first[rows]] + index.xy_m[pairs.second[rows]])
    xy = middle - rotation(yaw) @ xy_m.mean(axis=0)
    return np.column_stack([xy, yaw])
