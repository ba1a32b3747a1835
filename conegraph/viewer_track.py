"""The track in the Rerun recording: of the whole map, and ahead of the car."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr

from conegraph.track import Track
from conegraph.track.live import LiveTrack
from conegraph.types import Array, ConeMap

Log = Callable[[str, rr.AsComponents], None]


class TrackLayer:
    """Logs one back end's track: the whole with every map, the lane at every frame."""

    def __init__(self, log: Log, live: LiveTrack) -> None:
        """Log through ``log``, which takes a path and what to show there."""
        self._log = log
        self._live = live
        self._shown: Track | None = None

    def show_map(self, cone_map: ConeMap, pose: Array) -> None:
        """Show the boundaries, road and centre line of a map, if they changed."""
        track = self._live.update_map(cone_map, pose)
        if track is self._shown:
            return
        self._shown = track
        self._lines("track/left", [_ring(track.left_m, track.closed)])
        self._lines("track/right", [_ring(track.right_m, track.closed)])
        self._lines("track/centerline", [_ring(track.centerline.xy_m, track.closed)])
        gates = track.xy_m[track.triangles[:, :2]]
        self._lines("track/road", list(gates))

    def show_pose(self, pose: Array) -> None:
        """Show the lane ahead of the car."""
        track = self._live.update_pose(pose)
        self._lines("track/ahead/edges", [track.left_m, track.right_m])
        self._lines("track/ahead/centerline", [track.centerline.xy_m])

    def _lines(self, path: str, lines: list[Array]) -> None:
        shown = [line.astype(np.float32) for line in lines if len(line) > 1]
        self._log(path, rr.LineStrips2D(shown))


def _ring(xy: Array, closed: bool) -> Array:
    return np.vstack([xy, xy[:1]]) if closed else xy
