"""The last seconds, mapped afresh: what a lost car knows of its surroundings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from conegraph.backends.landmarks import PRIOR
from conegraph.backends.relocalize import Relocaliser
from conegraph.backends.sightings import Sightings
from conegraph.config import Config
from conegraph.geometry import between
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    SensorModel,
    Status,
    VelocityObservation,
)

if TYPE_CHECKING:
    from conegraph.backends.tracker import Tracker

MOST_VIEWS = 8
"""Places of the path from which a missing cone is looked for."""

ANY_SPEED_MPS = 10.0
"""Doubt about the speed of a car of which nothing is known."""

DOUBTED_AFTER = 5
"""Frames after which a cone seen once and then missed no longer counts."""

FASTEST_MPS, FASTEST_RADPS = 40.0, 4.0
"""No car of ours drives or turns faster."""

STEP_SPEED_COV = np.diag([1.0, 0.04])
"""Doubt (m^2/s^2, rad^2/s^2) about the speed between two frames as that of the next."""


def window_config(config: Config) -> Config:
    """Return the configuration of a tracker that starts from nothing, anywhere.

    Its frames come with the noise that the configuration asks for.
    """
    motion = config.motion.model_copy(update={"start_speed_sigma_mps": ANY_SPEED_MPS})
    own_noise = {"noise_from": "source", "scale": 1.0}
    sensor = config.sensor.model_copy(update=own_noise)
    recovery = config.recovery.model_copy(update={"enabled": False})
    return config.model_copy(
        update={"motion": motion, "sensor": sensor, "recovery": recovery}
    )


class LocalWindow:
    """Frames accumulated in a frame of their own, by a tracker that knows no map.

    It is the same filter as on the road, so that wheels, gyro and the cones
    themselves tell how the car moved, and every cone's covariance, seen from the
    car, grows with the way since it was seen. Rows of cones look alike: without
    odometry, the second frame is laid on the first to tell how fast the car moves.
    A window that has lost its way all the same knows only the newest frame.
    """

    def __init__(self, tracker: Tracker) -> None:
        """Start with a tracker (of `window_config`) that has seen nothing."""
        self._tracker = tracker
        self._path: list[Array] = []
        self._newest: ConeObservations | None = None
        self._speed_known = False
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
        self._speed_known = True
        self._tracker.observe_velocity(sample)

    def add(self, frame: ConeObservations) -> None:
        """Take the next frame."""
        if self._newest is not None and not self._speed_known:
            self._tell_speed(self._newest, frame)
        if self._tracker.observe_cones(frame) is None:
            return
        self._newest = frame
        self._path.append(self.vehicle[:3])
        if self._since_s is None:
            self._since_s = frame.stamp_s
        self.seconds = frame.stamp_s - self._since_s

    def _tell_speed(self, first: ConeObservations, second: ConeObservations) -> None:
        """Give the filter the speed that the step between two frames shows, if any."""
        step = step_between(first, second, self._tracker.sensor)
        if step is None:
            return
        dt_s = second.stamp_s - first.stamp_s
        gap, gap_cov = step
        state, cov = self.vehicle, self.vehicle_cov
        state[3:5] = np.hypot(*gap[:2]) * np.sign(gap[0]) / dt_s, gap[2] / dt_s
        cov[3:5, :], cov[:, 3:5] = 0.0, 0.0
        cov[3:5, 3:5] = np.diag(np.diag(gap_cov)[[0, 2]]) / dt_s**2 + STEP_SPEED_COV
        self._tracker.map.filter.place_car(state, cov)
        self._speed_known = True

    def sightings(self) -> Sightings:
        """Return the cones around the car as it stands now."""
        sound = self._tracker.estimate().status in (Status.INIT, Status.OK)
        if not sound and self._newest is not None:
            return Sightings.of_frame(self._newest)
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


def step_between(
    first: ConeObservations, second: ConeObservations, sensor: SensorModel
) -> tuple[Array, Array] | None:
    """Return how a car of any speed moved from one frame to the next.

    Args:
        first: a frame.
        second: the next.
        sensor: which saw both.

    Returns:
        The pose (3,) of the second frame in the first's and its covariance (3, 3);
        None where less than half of the second frame's cones fit any step.
    """
    n, dt_s = len(first), second.stamp_s - first.stamp_s
    known = ConeMap(
        np.arange(n), first.xy_m, first.cov_m2, first.class_prob, np.ones(n, np.int64)
    )
    for step in Relocaliser(known, sensor).locate(second, on_map=True).hypotheses:
        slow = np.hypot(*step.pose[:2]) < FASTEST_MPS * dt_s
        slow &= abs(step.pose[2]) < FASTEST_RADPS * dt_s
        if slow and len(step.row) > 0.5 * len(second):
            return step.pose, step.cov
    return None
