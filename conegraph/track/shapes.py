"""The road as shapes that other tools read: polygon, occupancy raster, GeoJSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from conegraph.track.model import Track
from conegraph.types import Array, Mask

_GRID_M = 1e-6
"""Without a grid the union of slivers can throw."""
MAX_CELLS = 25_000_000


@dataclass(frozen=True, slots=True)
class Raster:
    """Where the road is, cell by cell.

    Attributes:
        road: (H, W) whether a cell's middle is on the road; row 0 is lowest in y.
        origin_m: (2,) the lower left corner of cell (0, 0).
        cell_m: edge of a cell.
    """

    road: Mask
    origin_m: Array
    cell_m: float


def road_polygon(track: Track) -> Polygon | MultiPolygon:
    """Return the road as a polygon, with a hole where it is a loop.

    Boundaries that cross themselves make no polygon: then it is what the triangles
    cover together. Empty where the track has no road.
    """
    if min(len(track.left), len(track.right)) == 0 or len(track.triangles) == 0:
        return Polygon()
    if track.closed:
        rings = sorted(
            (Polygon(side) for side in (track.left_m, track.right_m)),
            key=lambda ring: -float(ring.area),
        )
        road = Polygon(rings[0].exterior, [rings[1].exterior])
    else:
        road = Polygon(np.vstack([track.left_m, track.right_m[::-1]]))
    if road.is_valid:
        return road
    corners = track.xy_m[track.triangles]
    covered = shapely.union_all(shapely.polygons(corners), grid_size=_GRID_M)
    return covered if isinstance(covered, Polygon | MultiPolygon) else Polygon()


def road_raster(track: Track, cell_m: float = 0.1, margin_m: float = 1.0) -> Raster:
    """Return the road as a raster.

    Raises:
        ValueError: it would have more than 25 million cells.
    """
    road = road_polygon(track)
    if road.is_empty:
        return Raster(np.zeros((0, 0), dtype=np.bool_), np.zeros(2), cell_m)
    low_x, low_y, high_x, high_y = road.bounds
    low = np.array([low_x, low_y]) - margin_m
    width, height = np.ceil((np.array([high_x, high_y]) + margin_m - low) / cell_m)
    if width * height > MAX_CELLS:
        raise ValueError(f"{width:.0f} by {height:.0f} cells of {cell_m} m: too many")
    x = low[0] + cell_m * (np.arange(int(width)) + 0.5)
    y = low[1] + cell_m * (np.arange(int(height)) + 0.5)
    shapely.prepare(road)
    mesh_x, mesh_y = np.meshgrid(x, y)
    inside = np.asarray(shapely.contains_xy(road, mesh_x, mesh_y))
    return Raster(inside, low, cell_m)


def geojson(track: Track) -> dict[str, Any]:
    """Return a GeoJSON feature collection, coordinates in metres of the map's frame.

    Features are told apart by ``kind``: ``road``, ``left``, ``right``, ``centerline``.
    """
    lines = {
        "left": track.left_m,
        "right": track.right_m,
        "centerline": track.centerline.xy_m,
    }
    features = [_feature("road", shapely.geometry.mapping(road_polygon(track)))]
    for kind, xy in lines.items():
        if len(xy) > 1:
            ring = np.vstack([xy, xy[:1]]) if track.closed else xy
            line = {"type": "LineString", "coordinates": ring.tolist()}
            features.append(_feature(kind, line))
    return {"type": "FeatureCollection", "features": features}


def _feature(kind: str, geometry: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "properties": {"kind": kind}, "geometry": geometry}
