"""A car that is carried away again and again while it drives on a map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from conegraph.backends.tracker import Tracker
from conegraph.bench.relocalisation_trials import true_pose
from conegraph.config import Config
from conegraph.geometry import compose
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    Recording,
    Status,
    VelocityObservation,
)

SETTLED_S = 4.0
"""After this time of being found, or of the start, the car is carried away again."""

GIVEN_UP_S = 12.0
SHIFT_M = (1.5, 8.0)
TURNS_RAD = (0.0, 0.3, -0.3, np.pi / 2, -np.pi / 2)
ON_ITS_WAY_M = 0.5
"""A car that is moved and whose pose is right again by itself was not lost."""


@dataclass(slots=True)
class LostCount:
    """What happened on one drive.

    Attributes:
        noticed_s: after each time it was carried, until it was noticed.
        found_s: the same until its pose was right again.
        false_alarms: how often it was called lost where it was not.
        hours: how long it drove where its pose was right.
    """

    noticed_s: list[float] = field(default_factory=list)
    found_s: list[float] = field(default_factory=list)
    false_alarms: int = 0
    hours: float = 0.0


class _Trial:
    """Carries the car of a tracker, and watches what the tracker says of it."""

    def __init__(
        self, tracker: Tracker, recording: Recording, rng: np.random.Generator
    ) -> None:
        self.count = LostCount()
        self._tracker = tracker
        self._recording = recording
        self._rng = rng
        self._carried_s: float | None = None
        self._noticed = False
        self._fine_since_s = 0.0
        self._last_s = 0.0
        self._was_lost = False

    def frame(self, stamp_s: float) -> None:
        """Look at the tracker after a frame."""
        estimate = self._tracker.estimate()
        lost = estimate.status is Status.LOST
        truth = true_pose(self._recording, stamp_s)
        error = float(np.hypot(*(estimate.pose - truth)[:2]))
        if self._carried_s is None:
            self._drive(stamp_s, lost, error)
        else:
            self._away(stamp_s, lost, error)
        self._last_s, self._was_lost = stamp_s, lost

    def _drive(self, stamp_s: float, lost: bool, error: float) -> None:
        if lost or error > ON_ITS_WAY_M:
            called = lost and not self._was_lost
            self.count.false_alarms += called and error <= ON_ITS_WAY_M
            self._fine_since_s = stamp_s
            return
        self.count.hours += (stamp_s - self._last_s) / 3600.0
        if stamp_s - self._fine_since_s > SETTLED_S:
            self._carry()
            self._carried_s, self._noticed = stamp_s, False

    def _away(self, stamp_s: float, lost: bool, error: float) -> None:
        assert self._carried_s is not None
        after = stamp_s - self._carried_s
        if lost and not self._noticed:
            self._noticed = True
            self.count.noticed_s.append(after)
        back = error < ON_ITS_WAY_M and not lost
        if not back and after < GIVEN_UP_S:
            return
        if self._noticed or not back:
            self.count.found_s.append(after if back else np.inf)
        if not self._noticed and not back:
            self.count.noticed_s.append(np.inf)
        self._carried_s, self._fine_since_s = None, stamp_s

    def _carry(self) -> None:
        """Tell the tracker a wrong pose, as if the car had been carried from there."""
        shift, way = self._rng.uniform(*SHIFT_M), self._rng.uniform(0, 2 * np.pi)
        turn = float(self._rng.choice(TURNS_RAD))
        moved: Array = np.array([shift * np.cos(way), shift * np.sin(way), turn])
        filter_ = self._tracker.map.filter
        pose = compose(filter_.vehicle[:3], moved)
        filter_.place_car(pose, np.diag([0.01, 0.01, 0.001]))


def count_lost(
    recording: Recording, known: ConeMap, config: Config, rng: np.random.Generator
) -> LostCount:
    """Localise a drive on a map and carry the car away every few seconds."""
    tracker = Tracker(config, recording.sensor, known, add_cones=False)
    trial = _Trial(tracker, recording, rng)
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            tracker.observe_velocity(event)
        elif isinstance(event, ConeObservations):
            tracker.observe_cones(event)
            trial.frame(event.stamp_s)
    return trial.count
