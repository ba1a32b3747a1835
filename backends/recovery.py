"""A car that is lost, or starts anywhere: noticed, looked for, put on the map."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np

from conegraph.backends.local_map import LocalMap
from conegraph.backends.local_window import LocalWindow
from conegraph.backends.lost import LostMonitor
from conegraph.backends.motion import BLIND_RAD
from conegraph.backends.pairing import Pairs
from conegraph.backends.pairing_problem import ClusterVerdict
from conegraph.backends.put_car import Found, put_car
from conegraph.backends.relocalize import (
    Relocaliser,
    RelocaliserConfig,
    same_place,
)
from conegraph.backends.sightings import Sightings
from conegraph.config import Config
from conegraph.geometry import between, compose
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    SensorModel,
    Status,
    VelocityObservation,
)

LONGEST_WINDOW_S = 15.0
"""After this time a window that led nowhere is thrown away."""

UNOPPOSED_M = 45.0
"""A start that fits and that no search contradicts is believed after this way."""

LEAST_FRAMES = 3
"""Frames of a window without which nothing is known of the car's speed."""

SMALL_MAP = 20
"""A map in the making with fewer cones is not asked whether the car is lost."""


class _Mode(Enum):
    FOLLOWING = "following"
    STARTING = "starting"
    LOST = "lost"


class Recovery:
    """Watches over a tracker, and moves its car when it was found elsewhere.

    On a given map the car may stand anywhere: its pose at the origin is on
    probation until a search over the whole map confirms it, another pose is found,
    or it has fitted for `UNOPPOSED_M`. While the car is lost nothing is added to
    the map and nothing told to the graph but the motion.

    Attributes:
        resets: how many times the pose jumped.
        jumped: whether it did so in the last frame.
    """

    def __init__(
        self,
        config: Config,
        sensor: SensorModel,
        known_map: ConeMap | None,
        *,
        add_cones: bool,
        make_window: Callable[[], LocalWindow],
    ) -> None:
        """Watch from the first frame on."""
        self._whole = config
        self._config = config.recovery
        self._sensor = sensor
        self._fixed = None if add_cones else known_map
        self._make_window = make_window
        self._monitor = LostMonitor(sensor, config.recovery.lost_share)
        self._on = config.recovery.enabled and config.association.method != "known"
        self._mode = _Mode.FOLLOWING
        self._window: LocalWindow | None = None
        self._relocaliser: Relocaliser | None = None
        self._searched_s = -np.inf
        self._driven_m = 0.0
        self._earlier: tuple[Array, Array] | None = None
        self._why = ""
        self.resets = 0
        self.jumped = False
        if self._on and known_map is not None and len(known_map):
            self._begin(_Mode.STARTING, known_map, "looking for the car on the map")

    @property
    def lost(self) -> bool:
        """Whether the car's pose is not to be used."""
        return self._mode is _Mode.LOST

    @property
    def trusted(self) -> bool:
        """Whether what the car sees may change the map."""
        return self._mode is _Mode.FOLLOWING

    def verdict(self) -> tuple[Status, str] | None:
        """Return a status and its reason, None where there is nothing to say."""
        if self._mode is _Mode.STARTING:
            return Status.INIT, self._why
        return (Status.LOST, self._why) if self.lost else None

    def velocity(self, sample: VelocityObservation) -> None:
        """Take a velocity."""
        if self._window is not None:
            self._window.velocity(sample)

    def search(
        self, map_: LocalMap, frame: ConeObservations, moved_m: float
    ) -> LocalMap:
        """Look for the car if need be, before a frame is paired.

        Returns:
            The map to go on with: the one given, or the fixed one as it was at first.
        """
        self.jumped = False
        if self._window is None or self._relocaliser is None:
            return map_
        self._driven_m += moved_m
        if self._window.seconds > LONGEST_WINDOW_S:
            self._window, self._earlier = self._make_window(), None
        self._window.add(frame)
        early = frame.stamp_s - self._searched_s < self._config.search_period_s
        if early or self._window.frames < LEAST_FRAMES:
            return map_
        self._searched_s = frame.stamp_s
        found = self._locate(self._relocaliser, self._window, frame)
        if found is None:
            return map_
        here = bool(same_place(found.pose, map_.filter.vehicle[:3])[0])
        if here and self._mode is _Mode.STARTING:
            self._follow()
            return map_
        return self._move(map_, found, self._window)

    def watch(
        self, map_: LocalMap, frame: ConeObservations, *, whole_map: bool
    ) -> None:
        """See whether the map still fits, after a frame corrected the filter.

        With a whole map, a cone that is not on it speaks against the pose, and a car
        that comes out of a gap without a heading is to be looked for.
        """
        if not self._on or self.lost:
            return
        fixed = self._fixed is not None
        if not fixed and int(map_.book.published.sum()) < SMALL_MAP:
            return
        whole_map |= fixed or self._mode is _Mode.STARTING
        self._monitor.frame(map_, frame, whole_map=whole_map)
        blind = whole_map and map_.filter.vehicle_cov[2, 2] > BLIND_RAD**2
        if self._monitor.lost or blind:
            why = f"only {100 * self._monitor.share:.0f} % of cones match the map"
            why = "the heading is not known" if blind else why
            known = map_.publish() if self._fixed is None else self._fixed
            self._begin(_Mode.LOST, known, why)
        elif self._mode is _Mode.STARTING and self._driven_m > UNOPPOSED_M:
            self._follow()

    def _begin(self, mode: _Mode, known: ConeMap, why: str) -> None:
        if self._relocaliser is None or self._relocaliser.cone_map is not known:
            limits = RelocaliserConfig(
                accept_probability=self._config.accept_probability,
                min_inliers=self._config.min_inliers,
            )
            self._relocaliser = Relocaliser(known, self._sensor, limits)
        self._window = self._make_window()
        self._mode, self._why = mode, why
        self._searched_s, self._driven_m, self._earlier = -np.inf, 0.0, None

    def _follow(self) -> None:
        self._mode, self._why = _Mode.FOLLOWING, ""
        self._window = None
        self._monitor.reset()

    def _locate(
        self, relocaliser: Relocaliser, window: LocalWindow, frame: ConeObservations
    ) -> Found | None:
        """Search with the window, else with the frame alone; None unless sure.

        Sure is a search whose probability suffices to move the car at once, or two
        that agree on where the window lies.
        """
        for seen in (window.sightings(), Sightings.of_frame(frame)):
            result = relocaliser.locate(seen)
            if result.accepted:
                break
        best = result.best
        if best is None or not result.accepted:
            return None
        agrees = self._agrees(best.pose, window.vehicle[:3])
        if best.probability <= self._config.reset_probability and not agrees:
            return None
        ids = relocaliser.cone_map.id[best.cone]
        return Found(best.pose, seen, best.row, ids)

    def _agrees(self, pose: Array, local: Array) -> bool:
        """Whether a pose confirms the one found before it in the same window.

        Args:
            pose: (3,) of the car in the world.
            local: (3,) of the car in the window.
        """
        earlier, self._earlier = self._earlier, (pose, local)
        if earlier is None:
            return False
        expected = compose(earlier[0], between(earlier[1], local))
        return bool(same_place(pose, expected)[0])

    def _move(self, map_: LocalMap, found: Found, window: LocalWindow) -> LocalMap:
        """Put the car where it was found, at the speed that the window gives."""
        speed = window.vehicle[3:5], window.vehicle_cov[3:5, 3:5]
        fresh = None
        if self._fixed is not None:
            fresh = LocalMap(self._whole)
            fresh.start_from(self._fixed)
        self._follow()
        self.resets += 1
        self.jumped = True
        return put_car(map_, fresh, found, *speed)


def no_pairs(n: int) -> Pairs:
    """Return the pairing of a frame of n cones that is not looked at."""
    nobody = np.full(n, -1, dtype=np.int64)
    no = np.zeros(n, dtype=bool)
    return Pairs(
        slot=nobody,
        d2=np.full(n, np.inf),
        birth=no,
        ambiguous=no,
        update=no,
        visible=nobody[:0],
        n_known=0,
        vague=no,
        cluster=ClusterVerdict.none(n),
    )
