"""Cones as photographs show them: new and worn, striped, marked, dirty, fallen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.sim.render.cone_shape import CONE_SHAPES
from conegraph.training.view import NEAREST_M, Floats, View
from conegraph.types import Array, ConeClass

Labels = NDArray[np.int16]
HUES = {
    ConeClass.BLUE: (96, 116),
    ConeClass.YELLOW: (17, 33),
    ConeClass.ORANGE: (-11, 12),
    ConeClass.BIG_ORANGE: (-11, 12),
}
"""Hues of real cones, 0 to 180 as in OpenCV, and somewhat more."""
N_ROUND = 14
SHIFT = 4
SHARP_PX = 70.0
"""Cones lower than this are drawn enlarged and made small again."""
LARGEST_PX = 1500


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


@dataclass(frozen=True, slots=True)
class Sprite:
    """A cone's picture: where its window is, colour (h, w, 3) and coverage (h, w).

    ``box_px`` is around the whole cone, pixel edges at whole numbers.
    """

    left: int
    top: int
    color: Floats
    cover: Floats
    box_px: Array


def draw_sprite(
    view: View,
    look: ConeLook,
    faces: list[tuple[Array, Array]],
    points: Array,
    noise: Floats,
    rng: np.random.Generator,
) -> Sprite | None:
    """Return the picture of a placed cone, None where it is behind or too near."""
    uv, depth = view.pixels(points)
    if depth.min() < NEAREST_M:
        return None
    box = np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    size = box[2:] - box[:2]
    if size.max() > LARGEST_PX or size.min() < 1.0:
        return None
    if (box[:2] > (view.width_px, view.height_px)).any() or (box[2:] < 0).any():
        return None
    left, top = np.floor(box[:2]).astype(int).tolist()
    right, low = np.ceil(box[2:]).astype(int).tolist()
    scale = int(np.clip(np.ceil(SHARP_PX / size[1]), 1, 8))
    shape = ((low - top) * scale, (right - left) * scale)
    color = np.zeros((*shape, 3), np.float32)
    cover = np.zeros(shape, np.float32)
    offset = np.array([left, top])
    start = 0
    for corners, paint in faces:
        face = uv[start : start + len(corners)] - offset
        start += len(corners)
        hull = cv2.convexHull((face * scale * 2**SHIFT).astype(np.int32))
        cv2.fillConvexPoly(color, hull, paint.tolist(), cv2.LINE_8, SHIFT)
        cv2.fillConvexPoly(cover, hull, 1.0, cv2.LINE_8, SHIFT)
    if look.mark is not None and size[1] > 18:
        _print(color, look.mark, rng)
    color *= _shade(shape, look, noise, rng)[..., None]
    color *= cover[..., None]
    if scale > 1:
        small = (right - left, low - top)
        color = np.asarray(cv2.resize(color, small, interpolation=cv2.INTER_AREA))
        cover = np.asarray(cv2.resize(cover, small, interpolation=cv2.INTER_AREA))
    return Sprite(left, top, color, cover, box)


def _print(color: Floats, ink: Array, rng: np.random.Generator) -> None:
    """Print a word on the middle of the body, as organisers do on stripes."""
    height, width = color.shape[:2]
    word = "".join(rng.choice(list("FSGABEUKIT"), int(rng.integers(1, 4))))
    scale = 0.16 * width / 11 / len(word) * rng.uniform(0.7, 1.8)
    at = (int(rng.uniform(0.36, 0.44) * width), int(rng.uniform(0.42, 0.6) * height))
    letters = np.zeros((height, width), np.uint8)
    cv2.putText(letters, word, at, 0, scale, 255, max(int(3 * scale), 1))
    color[letters > 127] = ink


def _shade(
    shape: tuple[int, int],
    look: ConeLook,
    noise: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Return factors (h, w): a round body under a light from somewhere, and dirt."""
    height, width = shape
    level = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None]
    half = 0.5 * width * (0.15 + 0.6 * level)
    across = (np.arange(width, dtype=np.float32)[None] - 0.5 * width) / half
    across = np.clip(across, -1.2, 1.2)
    aside, edge = look.shade
    shade = 1.0 + aside * across - edge * across**2
    shine = rng.uniform(-0.6, 0.6), rng.uniform(0.0, 0.5) ** 2
    shade += shine[1] * 2 * np.exp(-((across - shine[0]) ** 2) * 20)
    down, right = rng.integers(0, 128, 2).tolist()
    piece = cv2.resize(noise[down : down + 96, right : right + 64], (width, height))
    shade *= 1.0 - 0.25 * look.dirt * np.clip(piece + level, 0.0, 2.0)
    return np.asarray(np.maximum(shade, 0.1), dtype=np.float32)


def paste(
    picture: Floats,
    label: Labels | None,
    sprite: Sprite,
    row: int,
    *,
    opacity: float = 1.0,
) -> int:
    """Lay a sprite over a picture and its labels; return how many pixels it covers."""
    rows, columns = picture.shape[:2]
    height, width = sprite.cover.shape
    u0, v0 = max(sprite.left, 0), max(sprite.top, 0)
    u1, v1 = min(sprite.left + width, columns), min(sprite.top + height, rows)
    if u1 <= u0 or v1 <= v0:
        return 0
    part = np.s_[v0 - sprite.top : v1 - sprite.top, u0 - sprite.left : u1 - sprite.left]
    cover = opacity * sprite.cover[part]
    under = picture[v0:v1, u0:u1]
    under *= 1.0 - cover[..., None]
    under += opacity * sprite.color[part]
    if label is not None:
        label[v0:v1, u0:u1][sprite.cover[part] > 0.5] = row
    return int((sprite.cover > 0.5).sum())
