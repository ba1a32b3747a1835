"""The track while driving: the whole map when it changes, the lane ahead always."""

from __future__ import annotations

import numpy as np

from conegraph.config import Roles, TrackConfig
from conegraph.geometry import wrap_angle
from conegraph.track.detect import detect_track
from conegraph.track.model import Track
from conegraph.types import Array, ConeMap

AHEAD_M = 22.0
"""How far the lane ahead of the car is looked for at every frame."""
_BEHIND_M = 6.0
_MOVED_M = 0.02
_DRIVEN_M = 0.25
_TURNED_RAD = 0.05


class LiveTrack:
    """Keeps the track of a growing map, and the lane ahead of a driving car.

    What did not change is not worked out again: the whole track while every cone
    stays within 2 cm, its road where its gates still hold, the lane ahead while the
    car and the map stay where they are.
    """

    def __init__(
        self, config: TrackConfig | None = None, roles: Roles | None = None
    ) -> None:
        """Start without a map."""
        self._config = config
        self._roles = roles
        self._map = ConeMap.empty()
        self._pose: Array | None = None
        self.whole = Track.unknown("no cones yet")
        self.ahead = Track.unknown("no cones yet")

    def update_map(self, cone_map: ConeMap, pose: Array) -> Track:
        """Take a new map; return the track of all of it."""
        if self._changed(cone_map):
            self._map = cone_map
            self._pose = None
            self.whole = self._detect(cone_map, pose, self.whole)
        return self.whole

    def update_pose(self, pose: Array) -> Track:
        """Return the lane ahead of the car on the map as it was last given."""
        if self._stayed(pose):
            return self.ahead
        self._pose = np.array(pose)
        away = self._map.xy_m - pose[:2]
        forward = away @ (np.cos(pose[2]), np.sin(pose[2]))
        near = (np.hypot(*away.T) < AHEAD_M) & (forward > -_BEHIND_M)
        self.ahead = self._detect(self._map.subset(near), pose, self.ahead)
        return self.ahead

    def _detect(self, cone_map: ConeMap, pose: Array, previous: Track) -> Track:
        return detect_track(
            cone_map, pose, config=self._config, roles=self._roles, previous=previous
        )

    def _changed(self, cone_map: ConeMap) -> bool:
        old = self._map
        if len(old) != len(cone_map) or not np.array_equal(old.id, cone_map.id):
            return True
        if not np.array_equal(old.cone_class, cone_map.cone_class):
            return True
        moved = np.abs(old.xy_m - cone_map.xy_m)
        return bool((moved > _MOVED_M).any())

    def _stayed(self, pose: Array) -> bool:
        if self._pose is None or not np.isfinite(pose).all():
            return self._pose is not None
        step = pose - self._pose
        turn = abs(float(wrap_angle(step[2])))
        return bool(np.hypot(step[0], step[1]) < _DRIVEN_M and turn < _TURNED_RAD)
