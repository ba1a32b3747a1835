"""Tracks of fssim (github.com/AMZ-Driverless/fssim), the simulator of AMZ."""

from __future__ import annotations

from pathlib import Path

from conegraph.io.tracks.cones import ConeCollector
from conegraph.io.tracks.strict_yaml import items, numbers
from conegraph.types import ConeClass, TrackLayout

CONE_LISTS = {
    "cones_left": ConeClass.BLUE,
    "cones_right": ConeClass.YELLOW,
    "cones_orange": ConeClass.ORANGE,
    "cones_orange_big": ConeClass.BIG_ORANGE,
}
START_POSES = ("starting_pose_front_wing", "starting_pose_cg")


def layout(path: Path, document: dict[str, object]) -> TrackLayout:
    """Return the layout of a whole document.

    Closed boundaries repeat their first cone at the end, which is dropped as a
    duplicate. ``tk_device`` are the posts of the time keeping.

    Raises:
        FileFormatError: without a cone.
    """
    cones = ConeCollector(path)
    for key, kind in CONE_LISTS.items():
        for position in items(document.get(key)):
            cones.add(kind.label, numbers(position, 2))
    cones.drop("not a cone: tk_device", len(items(document.get("tk_device"))))
    given = [document[key] for key in START_POSES if key in document]
    pose = numbers(given[0], 3) if given else None
    if given and pose is None:
        cones.drop("malformed start")
    return cones.layout(start_pose=pose)
