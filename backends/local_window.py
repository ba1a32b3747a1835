"""The last seconds, mapped afresh: what a lost car knows of its surroundings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from conegraph.backends.landmarks import PRIOR
from conegraph.backends.sightings import Sightings
from conegraph.config import Config
from conegraph.geometry import between
from conegraph.types import Array, ConeObservations, VelocityObservation

if TYPE_CHECKING:
    from conegraph.backends.tracker import Tracker

MOST_VIEWS = 8
"""Places of the path from which a missing cone is looked for."""

ANY_SPEED_MPS = 10.0
"""Doubt about the speed of a car of which nothing is known."""

DOUBTED_AFTER = 5
"""Frames after which a cone seen once and then missed no longer counts."""


def window_config(config: Config) -> Config:
    """Return the configuration of a tracker that starts from nothing, anywhere."""
    motion = config.motion.model_copy(update={"start_speed_sigma_mps": ANY_SPEED_MPS})
    sensor = config.sensor.model_copy(update={"scale": 1.0})
    recovery = config.recovery.model_copy(update={"enabled": False})
    return config.model_copy(
        update={"motion": motion, "sensor": sensor, "recovery": recovery}
    )


class LocalWindow:
    """Frames accumulated in a frame of their own, by a tracker that knows no map.

    It is the same filter as on the road, so that wheels, gyro and the cones
    themselves tell how the car moved, and every cone's covariance, seen from the
    car, grows with the way since it was seen.
    """

    def __init__(self, tracker: Tracker) -> None:
        """Start with a tracker (of `window_config`) that has seen nothing."""
        self._tracker = tracker
        self._path: list[Array] = []
        self._since_s: float | None = None
        self.seconds = 0.0

    @property
    def frames(self) -> int:
        """How many frames it has taken."""
        return len(self._path)

    @property
    def vehicle(self) -> Array:
        """(6,) the car's state in the window's own frame."""
        return self._tracker.map.filter.vehicle

    @property
    def vehicle_cov(self) -> Array:
        """(6, 6) its covariance."""
        return self._tracker.map.filter.vehicle_cov

    def velocity(self, sample: VelocityObservation) -> None:
        """Take a velocity."""
        self._tracker.observe_velocity(sample)

    def add(self, frame: ConeObservations) -> None:
        """Take the next frame."""
        if self._tracker.observe_cones(frame) is None:
            return
        self._path.append(self.vehicle[:3])
        if self._since_s is None:
            self._since_s = frame.stamp_s
        self.seconds = frame.stamp_s - self._since_s

    def sightings(self) -> Sightings:
        """Return the cones around the car as it stands now."""
        map_ = self._tracker.map
        book = map_.book
        known = book.log_odds[map_.row] >= 0.0
        if len(self._path) <= DOUBTED_AFTER:
            known[:] = True
        slot = np.flatnonzero(known).astype(np.int64)
        predicted = map_.filter.predict_cones(slot)
        k = len(slot)
        blocks = predicted.cov_m2.reshape(k, 2, k, 2)
        cov = np.einsum("iaib->iab", blocks)
        likelihood = book.class_prob[map_.row[slot]] / PRIOR
        every = max(1, -(-len(self._path) // MOST_VIEWS))
        path = np.array(self._path[::-1][::every])
        views = between(self._path[-1], path)
        return Sightings(predicted.xy_m, cov, likelihood, views, float(every))
