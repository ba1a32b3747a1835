"""Tracks of the simulator of Edinburgh University Formula Student, eufs_sim."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from conegraph.io.csv_table import labels, parse_numbers, read_table
from conegraph.io.tracks.cones import ConeCollector
from conegraph.types import TrackLayout

COLUMNS = ("tag", "x", "y")
CAR_START = "car_start"


def read_eufs(path: Path) -> TrackLayout:
    """Read ``tag,x,y,direction,...``; the tag ``car_start`` is the start pose.

    Decoys and marks (``inactive_noise``, ``midpoint``) are no cones. A header that
    occurs again in the middle is dropped. Cones come in any order.

    Raises:
        FileFormatError: unreadable, a column missing, or without a cone.
    """
    table = read_table(path, COLUMNS, ("direction",))
    cones = ConeCollector(path)
    cones.drop("malformed row", table.overlong)
    cells = table.cells
    direction = cells.get("direction", [""] * len(table))
    rows = zip(labels(cells["tag"]), cells["x"], cells["y"], direction, strict=True)
    return cones.layout(start_pose=collect_tagged(cones, rows))


def collect_tagged(
    cones: ConeCollector, rows: Iterable[tuple[str, str, str, str]]
) -> list[float] | None:
    """Collect rows of tag, x, y and direction; return the start pose if any."""
    start: list[float] | None = None
    for tag, x, y, direction in rows:
        if tag == "tag":
            cones.drop("repeated header")
        elif tag == CAR_START:
            pose = parse_numbers([x, y, direction or "0"])
            if start is None and pose is not None:
                start = pose
            else:
                cones.drop("malformed start" if pose is None else "second start")
        else:
            cones.add(tag, parse_numbers([x, y]))
    return start
