"""The ground: asphalt with seams, lines and tyre marks, grass beyond, cast shade."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.sim.render.light import Light
from conegraph.sim.render.paint import (
    Bytes,
    Floats,
    blotches,
    cloudy,
    lit,
    tile,
    to_bytes,
)
from conegraph.types import Array

_MARGIN_M = 35.0
_MAX_PX = 2_000_000
_FINE_M, _COARSE_M = 0.006, 0.045
_TILE_PX = 512


@dataclass(frozen=True, slots=True)
class Ground:
    """The ground as pictures in the world, lit but for the shadows of things.

    Attributes:
        origin_m: (2,) world position of the first pixel.
        cell_m: size of a pixel of the finest picture.
        levels: pictures (H, W, 3), each of half the resolution of the last.
        shade: (h, w) light that reaches the ground, 0 shaded to 1, at 4 cells.
        fine: (512, 512) grain of the stones, 128 in the middle, sigma 30.
        coarse: (512, 512) grain of the patches, likewise.
        brightness: factor of the grain, by the light.
    """

    origin_m: Array
    cell_m: float
    levels: tuple[Bytes, ...]
    shade: Floats
    fine: Bytes
    coarse: Bytes
    brightness: float

    def sunlit(self, xy_m: Array) -> Array:
        """Return how much of the sun reaches (N, 2) points on the ground, 0 to 1."""
        cells = np.round((xy_m - self.origin_m) / (4 * self.cell_m)).astype(int)
        rows = np.clip(cells[:, 1], 0, self.shade.shape[0] - 1)
        columns = np.clip(cells[:, 0], 0, self.shade.shape[1] - 1)
        share: Array = self.shade[rows, columns].astype(np.float64)
        return share


def make_ground(cones_m: Array, light: Light, rng: np.random.Generator) -> Ground:
    """Return ground around cones (N, 2), asphalt where they stand."""
    low, high = cones_m.min(axis=0) - _MARGIN_M, cones_m.max(axis=0) + _MARGIN_M
    cell = max(0.1, float(np.sqrt(np.prod(high - low) / _MAX_PX)))
    columns, rows = np.ceil((high - low) / cell).astype(int).tolist()
    shape = (rows, columns)
    pixels = (cones_m - low) / cell
    asphalt = _asphalt(shape, cell, rng)
    _paint_marks(asphalt, cell, rng)
    mixed = _with_grass(asphalt, pixels, cell, rng)
    shade = _shade(shape, cell, light, rng)
    dark = np.float32(light.in_shade)
    picture = to_bytes(lit(mixed, light) * (dark + (1 - dark) * shade)[..., None])
    levels = [picture]
    while min(levels[-1].shape[:2]) > 64 and len(levels) < 6:
        half = (levels[-1].shape[1] // 2, levels[-1].shape[0] // 2)
        levels.append(
            np.asarray(
                cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA), np.uint8
            )
        )
    return Ground(
        low,
        cell,
        tuple(levels),
        shade[::4, ::4],
        _grain(1.2, rng),
        _grain(2.0, rng),
        light.exposure,
    )


def _grain(size_px: float, rng: np.random.Generator) -> Bytes:
    return to_bytes(128 + 30 * tile(_TILE_PX, size_px, rng))


def _asphalt(
    shape: tuple[int, int], cell: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return grey ground (H, W, 3) with broad patches, as old surfaces have."""
    grey = rng.uniform(85, 135)
    tint = rng.normal(0, 2.0, 3)
    level = grey + 5 * cloudy(shape, 12 / cell, 4, rng) + 2 * blotches(shape, 3, rng)
    return (level[..., None] + tint).astype(np.float32)


def _paint_marks(picture: Floats, cell: float, rng: np.random.Generator) -> None:
    """Paint tar seams, tyre marks, patches and white lines."""
    rows, columns = picture.shape[:2]
    for _ in range(int(rng.integers(2, 8))):
        centre = rng.uniform((0, 0), (columns, rows))
        size = rng.uniform(2, 12, 2) / cell
        box = cv2.boxPoints((tuple(centre), tuple(size), rng.uniform(0, 180)))
        factor = rng.uniform(0.85, 1.12)
        mask = np.zeros((rows, columns), np.uint8)
        cv2.fillConvexPoly(mask, np.round(box).astype(np.int32), 255)
        picture[mask > 0] *= np.float32(factor)
    kinds = [("seam", 14, 0.05, 0.72), ("tyre", 24, 0.22, 0.85), ("line", 5, 0.12, 0.0)]
    for kind, most, width_m, factor in kinds:
        mask = np.zeros((rows, columns), np.uint8)
        for _ in range(int(rng.integers(most // 3, most + 1))):
            _stroke(mask, cell, width_m, rng)
        share = (mask.astype(np.float32) / 255)[..., None]
        if kind == "line":
            worn = rng.uniform(0.5, 0.95) * share
            picture += worn * (np.float32(rng.uniform(200, 235)) - picture)
        else:
            picture *= 1 - share * np.float32(1 - factor)


def _stroke(mask: Bytes, cell: float, width_m: float, rng: np.random.Generator) -> None:
    """Draw one long, slightly bent stroke."""
    rows, columns = mask.shape
    start = rng.uniform((0, 0), (columns, rows))
    heading, bend = rng.uniform(-np.pi, np.pi), rng.normal(0, 0.015)
    step = 1.0 / cell
    turns = heading + bend * np.arange(int(rng.uniform(15, 90)))
    path = start + step * np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]), 0)
    points = np.round(path * 16).astype(np.int32)[:, None]
    wide = max(round(width_m / cell), 1)
    # Narrower than a cell, a stroke is fainter in place of thinner.
    faint = int(255 * min(1.0, width_m / cell))
    cv2.polylines(mask, [points], False, (faint,), wide, cv2.LINE_AA, 4)


def _with_grass(
    asphalt: Floats, cones_px: Array, cell: float, rng: np.random.Generator
) -> Floats:
    """Return the ground with grass beyond some distance from the cones."""
    shape = (asphalt.shape[0], asphalt.shape[1])
    free = np.full(shape, 255, np.uint8)
    at = np.clip(np.round(cones_px).astype(int), 0, np.array(free.shape[::-1]) - 1)
    free[at[:, 1], at[:, 0]] = 0
    away = np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, 5)) * cell
    edge = rng.uniform(5.0, 20.0)
    wavy = away + 1.5 * blotches(shape, 6 / cell, rng)
    grass = np.clip((wavy - edge) / 0.3, 0, 1)[..., None]
    green = np.array([rng.uniform(70, 110), rng.uniform(100, 130), rng.uniform(40, 70)])
    rough = 1 + 0.10 * cloudy(shape, 4 / cell, 4, rng)
    meadow = green * rough[..., None]
    mixed: Floats = (asphalt * (1 - grass) + meadow * grass).astype(np.float32)
    return mixed


def _shade(
    shape: tuple[int, int], cell: float, light: Light, rng: np.random.Generator
) -> Floats:
    """Return how much sun reaches the ground (H, W): stands and trees take some."""
    open_share = np.ones(shape, np.float32)
    if light.sun < 0.3:
        return open_share
    for _ in range(int(rng.integers(0, 6))):
        centre = rng.uniform((0, 0), shape[::-1])
        size = rng.uniform(4, 25, 2) / cell
        box = cv2.boxPoints((tuple(centre), tuple(size), rng.uniform(0, 180)))
        cv2.fillConvexPoly(open_share, np.round(box).astype(np.int32), (0.0,))
    ragged = np.zeros(shape, np.float32)
    np.copyto(ragged, cloudy(shape, 6 / cell, 4, rng) > rng.uniform(1.8, 2.6))
    soft = cv2.GaussianBlur(open_share * (1 - ragged), (0, 0), 0.12 / cell)
    return np.asarray(soft, dtype=np.float32)


def paint_ground(
    ground: Ground,
    x_m: Floats,
    y_m: Floats,
    footprint_m: Floats,
    car_m: Array,
) -> Bytes:
    """Return the ground's picture where the rays meet it.

    Args:
        ground: the ground.
        x_m: (R, W) where the ray of each pixel meets the ground, in the world.
        y_m: (R, W) the same.
        footprint_m: (R,) length on the ground of a pixel of each row.
        car_m: (2,) where the car is; the grain is sampled around it.

    Returns:
        (R, W, 3) uint8.
    """
    level = np.floor(np.log2(np.maximum(footprint_m / ground.cell_m, 1.0)))
    level = np.minimum(level, len(ground.levels) - 1).astype(int)
    picture = np.empty((*x_m.shape, 3), np.uint8)
    cuts = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), len(level)]
    for a, b in pairwise(cuts):
        scale = np.float32(1 / (ground.cell_m * 2 ** int(level[a])))
        u = (x_m[a:b] - np.float32(ground.origin_m[0])) * scale - np.float32(0.5)
        v = (y_m[a:b] - np.float32(ground.origin_m[1])) * scale - np.float32(0.5)
        cv2.remap(
            ground.levels[int(level[a])],
            u,
            v,
            cv2.INTER_LINEAR,
            dst=picture[a:b],
            borderMode=cv2.BORDER_REFLECT_101,
        )
    where = (x_m, y_m, footprint_m)
    _add_grain(picture, ground.coarse, _COARSE_M, 3 * ground.brightness, where, car_m)
    _add_grain(picture, ground.fine, _FINE_M, 9 * ground.brightness, where, car_m)
    return picture


def _add_grain(
    picture: Bytes,
    grain: Bytes,
    cell_m: float,
    sigma: float,
    where: tuple[Floats, Floats, Floats],
    car_m: Array,
) -> None:
    """Add grain to the rows near enough to show it, fainter with distance."""
    x, y, footprint = where
    visible = np.flatnonzero(footprint < 8 * cell_m)
    if not len(visible):
        return
    first = int(visible[0])
    tile = cell_m * _TILE_PX
    # remap keeps whole pixels in 16 bits: count from a corner of a tile near the car.
    corner = (np.floor(car_m / tile) * tile).astype(np.float32)
    scale = np.float32(1 / cell_m)
    limit = np.float32(30000)
    u = np.clip((x[first:] - corner[0]) * scale, -limit, limit)
    v = np.clip((y[first:] - corner[1]) * scale, -limit, limit)
    noise = cv2.remap(grain, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    fade = np.minimum(cell_m / np.maximum(footprint[first:], 1e-6), 1.0)
    gain = (fade * (sigma / 30)).astype(np.float32)[:, None]
    change = ((noise.astype(np.float32) - 128) * gain).astype(np.int16)
    cv2.add(
        picture[first:], cv2.merge([change] * 3), dst=picture[first:], dtype=cv2.CV_8U
    )
