"""Tracks of the Formula Student Driverless Simulator (FSDS).

Rows are ``tag,x,y,direction,x_variance,y_variance,xy_covariance`` without a header;
with a header the file is one of eufs_sim. The frame is right-handed, x forward and
y left: that is how the simulator reads them since its pull request 323 (2022);
before, y was mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from conegraph.io.cone_names import cone_class
from conegraph.io.csv_table import labels, parse_numbers, read_text, text_lines
from conegraph.io.tracks.cones import ConeCollector
from conegraph.io.tracks.eufs import collect_tagged
from conegraph.types import TrackLayout

LINES_TO_LOOK_AT = 10


def _cells(line: str) -> tuple[str, str, str, str]:
    """Return tag, x, y and direction of a row; missing cells are blank."""
    cells = line.split(",") if "," in line else line.split()
    tag, x, y, direction, *_ = labels([*cells, "", "", "", ""])
    return tag, x, y, direction


def looks_like_fsds(lines: Sequence[str]) -> bool:
    """Return whether one of the first lines is a cone's name and two numbers."""
    for line in lines[:LINES_TO_LOOK_AT]:
        tag, x, y, _ = _cells(line)
        if cone_class(tag) is not None and parse_numbers([x, y]):
            return True
    return False


def read_fsds(path: Path) -> TrackLayout:
    """Read ``tag,x,y,...`` without a header, separated by commas or spaces.

    The simulator always starts the car at (0, 0), facing along x.

    Raises:
        FileFormatError: unreadable, or without a cone.
    """
    cones = ConeCollector(path)
    rows = [_cells(line) for line in text_lines(read_text(path)) if line.strip()]
    start = collect_tagged(cones, rows)
    return cones.layout(start_pose=start or [0.0, 0.0, 0.0])
