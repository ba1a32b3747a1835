"""Noticing that the car is not where the filter has it."""

from __future__ import annotations

import numpy as np

from conegraph.backends.local_map import LocalMap
from conegraph.backends.map_cleaner import CROWDED_M
from conegraph.backends.pairing import KNOWN_AREA_M
from conegraph.backends.pairing_problem import mahalanobis
from conegraph.geometry import distances
from conegraph.types import Array, ConeObservations, IntArray, Mask, SensorModel

MEMORY_S = 0.35
"""Time constant over which the share of fitting cones is averaged."""

LEAST_DT_S = 0.02
LONGEST_DT_S = 0.15
"""A single frame counts no longer than this, however long none came."""

LEAST_CONES = 3
"""Cones without which a frame says nothing: one that does not fit may be a new one, or
was paired wrongly before; several at once mean that the car is elsewhere."""

FITS_D2 = 13.8
"""Largest squared Mahalanobis distance between a sighting and a cone it may show."""

SLACK_M = 0.2
"""Error of the car's own pose from frame to frame."""


class LostMonitor:
    """Averages over `MEMORY_S` what share of the cones fits the map.

    Only places count: a wrong colour says that the detector erred, not that the car
    is elsewhere.
    """

    def __init__(self, sensor: SensorModel, least_share: float) -> None:
        """Start trusting."""
        self._sensor = sensor
        self._least = least_share
        self._last_s: float | None = None
        self.share = 1.0

    @property
    def lost(self) -> bool:
        """Whether too few cones fit."""
        return self.share < self._least

    def reset(self) -> None:
        """Trust again."""
        self.share = 1.0

    def frame(
        self, map_: LocalMap, frame: ConeObservations, *, whole_map: bool
    ) -> None:
        """Take a frame that the filter has been corrected with.

        A frame that counts too few cones, `LEAST_CONES`, says nothing.

        Args:
            map_: cones and car.
            frame: the observations.
            whole_map: whether every cone there is should be on the map.
        """
        dt = 0.0 if self._last_s is None else frame.stamp_s - self._last_s
        self._last_s = frame.stamp_s
        if len(frame) == 0 or len(map_.row) == 0:
            return
        fitting, counted = agreement(map_, frame, self._sensor, whole_map=whole_map)
        if counted < LEAST_CONES:
            return
        weight = min(max(dt, LEAST_DT_S), LONGEST_DT_S) / MEMORY_S
        self.share += weight * (fitting / counted - self.share)


def agreement(
    map_: LocalMap, frame: ConeObservations, sensor: SensorModel, *, whole_map: bool
) -> tuple[int, int]:
    """Return how many cones fit, and of how many.

    Counted are observations (without a whole map: those near a mapped cone, as
    others may be new) and confirmed cones well inside the view; an observation fits
    with a cone in its gate, a cone with an observation in whose gate it is.
    """
    cones = map_.filter.cones_in_car_frame()
    shown = map_.book.published[map_.row]
    range_m = np.hypot(cones[:, 0], cones[:, 1])
    near = shown & (range_m < sensor.max_range_m + KNOWN_AREA_M)
    cones, range_m = cones[near], range_m[near]
    expected = _well_inside(cones, range_m, sensor)
    slack_m2 = SLACK_M**2 * np.eye(2 * len(cones))
    d2, _ = mahalanobis(frame.xy_m, frame.cov_m2, cones, slack_m2)
    fits = d2 <= FITS_D2
    if whole_map:
        known = np.ones(len(frame), dtype=bool)
    else:
        gap = distances(frame.xy_m, cones)
        known = gap.min(axis=1, initial=np.inf) < KNOWN_AREA_M
    seen: Mask = np.asarray(fits.any(axis=0))
    fitting = int((fits.any(axis=1) & known).sum()) + int(seen[expected].sum())
    return fitting, int(known.sum()) + len(expected)


def _well_inside(cones: Array, range_m: Array, sensor: SensorModel) -> IntArray:
    """Return the cones that the sensor must see, if it promises anything."""
    if sensor.detection_probability == 0.0:
        return np.zeros(0, dtype=np.int64)
    inside = range_m < 0.75 * min(sensor.max_range_m, CROWDED_M)
    inside &= range_m > sensor.min_range_m + 1.0
    bearing = np.abs(np.arctan2(cones[:, 1], cones[:, 0]))
    inside &= bearing < sensor.half_fov_rad - 0.06
    return np.flatnonzero(inside).astype(np.int64)
