"""Cones as teams own them: new and worn, striped, marked, dirty; standing or fallen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from conegraph.sim.render.cone_shape import CONE_SHAPES
from conegraph.types import Array, ConeClass

HUES = {
    ConeClass.BLUE: (96, 116),
    ConeClass.YELLOW: (17, 33),
    ConeClass.ORANGE: (-11, 12),
    ConeClass.BIG_ORANGE: (-11, 12),
}
"""Hues of real cones, 0 to 180 as in OpenCV, and somewhat more."""
N_ROUND = 14


@dataclass(frozen=True, slots=True)
class ConeLook:
    """How a cone is built and painted.

    Attributes:
        cone_class: its class.
        side_m: side of the foot.
        plate_m: thickness of the foot.
        bands: from below: lower and upper height, their radii in m, and the colour.
        plate_color: (3,) of the foot.
        mark: colour (3,) of what is printed on it, or None.
        shade: how much the light's side is brighter, and the middle than both sides.
        dirt: how dirty, 0 to 1.
    """

    cone_class: ConeClass
    side_m: float
    plate_m: float
    bands: tuple[tuple[float, float, float, float, Array], ...]
    plate_color: Array
    mark: Array | None
    shade: tuple[float, float]
    dirt: float


def draw_look(rng: np.random.Generator, cone_class: ConeClass) -> ConeLook:
    """Return a cone of a class as some team or other would own it."""
    shape = CONE_SHAPES[int(cone_class)]
    body = _color(rng, *HUES[cone_class])
    height = shape.height_m * rng.uniform(0.92, 1.08)
    side = shape.side_m * rng.uniform(0.85, 1.15)
    low_r = shape.base_radius_m * rng.uniform(0.85, 1.15)
    top_r = shape.top_radius_m * rng.uniform(0.8, 1.5)
    plate = rng.uniform(0.012, 0.04)
    stripes = _stripes(rng, cone_class)
    levels = [(plate / height, 1.0, body)]
    for low, high, color in stripes:
        last = levels.pop()
        levels += [(last[0], low, body), (low, high, color), (high, 1.0, body)]
    bands = tuple(
        (
            a * height,
            b * height,
            low_r + a * (top_r - low_r),
            low_r + b * (top_r - low_r),
            c,
        )
        for a, b, c in levels
        if b > a
    )
    foot = rng.random()
    plate_color = (
        body * rng.uniform(0.8, 1.0) if foot < 0.85 else np.full(3, rng.uniform(20, 70))
    )
    mark = None
    if rng.random() < 0.5:
        mark = rng.uniform(0, 80, 3) if rng.random() < 0.7 else rng.uniform(150, 255, 3)
    return ConeLook(
        cone_class,
        float(side),
        float(plate),
        bands,
        plate_color,
        mark,
        (float(rng.normal(0.0, 0.18)), float(rng.uniform(0.0, 0.3))),
        float(rng.uniform(0.0, 1.0) ** 3),
    )


def _color(rng: np.random.Generator, low: int, high: int) -> Array:
    hue = rng.uniform(low, high) % 180
    hsv = np.array([[[hue, rng.uniform(150, 255), rng.uniform(130, 255)]]])
    rgb: Array = cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB)[0, 0].astype(
        float
    )
    return rgb


def _stripes(
    rng: np.random.Generator, cone_class: ConeClass
) -> list[tuple[float, float, Array]]:
    """Return lower and upper end, as shares of the height, and colours of stripes."""
    white = rng.uniform(195, 255) * np.array([1.0, 1.0, rng.uniform(0.9, 1.0)])
    black = rng.uniform(12, 60) * np.ones(3)
    color = black if cone_class is ConeClass.YELLOW else white
    if cone_class is ConeClass.BIG_ORANGE:
        low, apart = rng.uniform(0.24, 0.34), rng.uniform(0.28, 0.36)
        wide = rng.uniform(0.12, 0.19)
        return [(low, low + wide, color), (low + apart, low + apart + wide, color)]
    kind = rng.random()
    if kind < 0.06:
        return []
    if kind < 0.12 and cone_class is ConeClass.YELLOW:
        color = white
    middle, wide = rng.uniform(0.45, 0.62), rng.uniform(0.18, 0.42)
    return [(max(middle - wide / 2, 0.15), min(middle + wide / 2, 0.93), color)]


def placed(
    look: ConeLook, xy_m: Array, yaw_rad: float, *, fallen: bool
) -> tuple[list[tuple[Array, Array]], Array]:
    """Return the faces to draw in turn, points (K, 3) and colour, and all points."""
    half = look.side_m / 2
    corners = half * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)])
    angle = np.linspace(0, 2 * np.pi, N_ROUND, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])

    def ring(flat: Array, z: float) -> Array:
        return np.column_stack([flat, np.full(len(flat), z)])

    faces = [
        (
            np.vstack([ring(corners, 0.0), ring(corners, look.plate_m)]),
            look.plate_color * 0.8,
        )
    ]
    faces.append((ring(corners, look.plate_m), look.plate_color))
    for low, high, low_r, high_r, color in look.bands:
        faces.append(
            (np.vstack([ring(low_r * circle, low), ring(high_r * circle, high)]), color)
        )
    _, top, _, top_r, color = look.bands[-1]
    faces.append((ring(0.75 * top_r * circle, top), color * 0.35))
    turn = _turn(yaw_rad)
    if fallen:
        tip = look.bands[-1][1]
        lean = np.arctan2(half, tip)
        c, s = np.cos(np.pi / 2 - 0.5 * lean), np.sin(np.pi / 2 - 0.5 * lean)
        turn = turn @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    moved = [(points @ turn.T, color) for points, color in faces]
    lowest = min(float(points[:, 2].min()) for points, _ in moved)
    at = np.array([*xy_m, -lowest])
    moved = [(points + at, color) for points, color in moved]
    if fallen and moved[0][0][:, 0].mean() < moved[-1][0][:, 0].mean():
        moved = moved[::-1]
    return moved, np.vstack([points for points, _ in moved])


def _turn(yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
