"""Tracks of PacSim (github.com/PacSim/pacsim), the simulator of Elbflorace."""

from __future__ import annotations

from pathlib import Path

from conegraph.errors import FileFormatError
from conegraph.io.tracks.cones import ConeCollector
from conegraph.io.tracks.strict_yaml import items, numbers
from conegraph.types import TrackLayout

CONE_LISTS = ("left", "right", "time_keeping", "unknown")
TRUE = ("true", "yes", "on", "1")


def layout(path: Path, track: object) -> TrackLayout:
    """Return the layout of the mapping under ``track``.

    ``left`` and ``right`` are in driving order, and ``unknown`` holds cones of any
    class. Time-keeping posts and invisible cones are no cones. Cones of class
    ``unknown`` stay: they stand on the site, though not on the track.

    Raises:
        FileFormatError: not such a mapping, or without a cone.
    """
    if not isinstance(track, dict):
        raise FileFormatError(path, "'track' holds no mapping")
    cones = ConeCollector(path)
    for key in CONE_LISTS:
        for entry in items(track.get(key)):
            entry = entry if isinstance(entry, dict) else {}
            name = entry.get("class")
            position = numbers(entry.get("position"), 2)
            cones.add(name if isinstance(name, str) else "", position)
    start = track.get("start")
    pose = None
    if isinstance(start, dict):
        position = numbers(start.get("position"), 2)
        roll_pitch_yaw = numbers(start.get("orientation"), 3)
        if position and roll_pitch_yaw:
            pose = [*position, roll_pitch_yaw[2]]
        else:
            cones.drop("malformed start")
    connected = track.get("lanesFirstWithLastConnected")
    return cones.layout(
        start_pose=pose,
        closed=connected.lower() in TRUE if isinstance(connected, str) else None,
        in_driving_order=True,
    )
