"""Putting the car of a filter where it was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.backends.local_map import LocalMap
from conegraph.backends.motion import NV
from conegraph.backends.sightings import Sightings
from conegraph.types import Array, IntArray

LOOSE_POSE = np.diag([1.0, 1.0, 0.1])
"""Doubt (m^2, m^2, rad^2) about a found pose, before its cones correct it."""

DEPENDENT = 2.0
"""Factor on sightings' covariances: those of one window share the car's errors."""


@dataclass(frozen=True, slots=True)
class Found:
    """A pose on the map, and the sightings that say so.

    Attributes:
        pose: (3,) in the world.
        seen: what the car sees.
        row: (k,) sightings that show a cone of the map.
        cone_id: (k,) these cones' ids.
    """

    pose: Array
    seen: Sightings
    row: IntArray
    cone_id: IntArray


def put_car(
    map_: LocalMap,
    fresh: LocalMap | None,
    found: Found,
    speed: Array,
    speed_cov: Array,
) -> LocalMap:
    """Put the car where it was found and correct it with the cones seen from there.

    The pose is first taken as vague and independent of all cones; what is then known
    of it is known relative to the cones that it was found by.

    Args:
        map_: cones and car until now.
        fresh: the map to go on with instead, None to keep the old.
        found: where the car is.
        speed: (2,) forward speed and yaw rate.
        speed_cov: (2, 2) their covariance.

    Returns:
        The map to go on with, its filter holding every cone.
    """
    state, bias_var = map_.filter.vehicle, map_.filter.vehicle_cov[5, 5]
    state[:3], state[3:5] = found.pose, speed
    cov = np.zeros((NV, NV))
    cov[:3, :3], cov[3:5, 3:5], cov[5, 5] = LOOSE_POSE, speed_cov, bias_var
    map_ = fresh or map_
    _hold_all(map_)
    map_.filter.place_car(state, cov)
    slot = map_.slots_of(found.cone_id)
    held = slot >= 0
    row = found.row[held]
    noise = DEPENDENT * found.seen.cov_m2[row]
    map_.filter.update_cones(slot[held], found.seen.xy_m[row], noise, None)
    return map_


def _hold_all(map_: LocalMap) -> None:
    """Let the filter hold every cone, those it does not hold as the book has them."""
    book = map_.book
    if len(map_.row) == len(book):
        return
    map_.sync()
    missing = np.setdiff1d(np.arange(len(book)), map_.row)
    map_.filter.place_cones(book.xy_m[missing], book.cov_m2[missing])
    map_.row = np.concatenate([map_.row, missing]).astype(np.int64)
