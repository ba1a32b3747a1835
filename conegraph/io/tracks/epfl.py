"""Tracks of the EPFL Racing Team's track_database."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conegraph.io.csv_table import labels, parse_numbers, read_table
from conegraph.io.tracks.cones import ConeCollector
from conegraph.types import Array, TrackLayout

COLUMNS = ("cone_type", "x", "y")
CONES_SUFFIX = "_cones.csv"
CENTERLINE_SUFFIX = "_center_line.csv"


def read_epfl(path: Path) -> TrackLayout:
    """Read ``cone_type,X,Y,...``, and the centre line in the file beside it.

    ``NAME_cones.csv`` goes with ``NAME_center_line.csv``, columns ``x,y,...``. The
    track is closed if that line is.

    Raises:
        FileFormatError: unreadable, or without a cone.
    """
    table = read_table(path, COLUMNS)
    cones = ConeCollector(path)
    cones.drop("malformed row", table.overlong)
    tags, x, y = (table.cells[name] for name in COLUMNS)
    for tag, *place in zip(labels(tags), x, y, strict=True):
        cones.add(tag, parse_numbers(place))
    line_m = _centerline(path, cones)
    closed = None if line_m is None else _returns(line_m)
    return cones.layout(centerline_m=line_m, closed=closed)


def _returns(line_m: Array) -> bool:
    """Return whether a line (K, 2) ends about a step from where it begins."""
    step = np.linalg.norm(np.diff(line_m, axis=0), axis=1)
    gap = float(np.linalg.norm(line_m[-1] - line_m[0]))
    return gap <= 2.0 * float(step.max(initial=0.0))


def _centerline(path: Path, cones: ConeCollector) -> Array | None:
    if not path.name.endswith(CONES_SUFFIX):
        return None
    name = path.name.removesuffix(CONES_SUFFIX) + CENTERLINE_SUFFIX
    beside = path.with_name(name)
    if not beside.is_file():
        return None
    table = read_table(beside, ("x", "y"))
    points = np.stack([table.numbers(name)[0] for name in ("x", "y")], axis=1)
    sound = ~np.isnan(points[:, 0] + points[:, 1])
    bad = table.overlong + int(np.count_nonzero(~sound))
    cones.drop("malformed centre line row", bad)
    return points[sound] if sound.any() else None
