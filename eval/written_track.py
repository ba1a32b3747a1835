"""The track that a run wrote, as the judge needs it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from shapely.errors import ShapelyError
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import read_text
from conegraph.track import Track
from conegraph.track.files import GEOJSON, SUMMARY
from conegraph.track.shapes import road_polygon
from conegraph.types import Array, IntArray


@dataclass(frozen=True, slots=True)
class WrittenTrack:
    """Boundaries, road and centre line in the frame of the map.

    Attributes:
        left: (L,) ids of the cones of the left boundary, in driving order.
        right: (R,) ids of the right boundary.
        closed: whether it is a loop.
        road: the road's polygon; empty where there is none.
        line_m: (K, 2) the centre line; of a loop the first point is repeated.
    """

    left: IntArray
    right: IntArray
    closed: bool
    road: BaseGeometry
    line_m: Array

    @classmethod
    def of(cls, track: Track) -> Self:
        """Return what would be written of a track."""
        line = track.centerline.xy_m
        line = np.vstack([line, line[:1]]) if track.closed else line
        return cls(
            track.left_id, track.right_id, track.closed, road_polygon(track), line
        )


def read_written_track(folder: Path) -> WrittenTrack | None:
    """Read ``track.json`` and ``track.geojson``; None where either is missing.

    Raises:
        FileFormatError: a file does not hold what `conegraph.track.files` writes.
    """
    summary, shapes = folder / SUMMARY, folder / GEOJSON
    if not (summary.exists() and shapes.exists()):
        return None
    plain = _read(summary)
    try:
        left, right = (np.array(plain[k], dtype=np.int64) for k in ("left", "right"))
        closed = bool(plain["closed"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileFormatError(summary, f"is no track's summary: {error!r}") from error
    plain = _read(shapes)
    try:
        kinds = {f["properties"]["kind"]: f["geometry"] for f in plain["features"]}
        line = kinds.get("centerline", {"coordinates": []})["coordinates"]
        line_m = np.array(line, dtype=np.float64).reshape(-1, 2)
        road = shape(kinds["road"])
    except (KeyError, TypeError, ValueError, AttributeError, ShapelyError) as error:
        raise FileFormatError(shapes, f"holds no track: {error!r}") from error
    return WrittenTrack(left, right, closed, road, line_m)


def _read(path: Path) -> dict[str, Any]:
    try:
        plain = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise FileFormatError(path, f"is not JSON: {error}") from error
    if not isinstance(plain, dict):
        raise FileFormatError(path, "must hold a JSON object")
    return plain
