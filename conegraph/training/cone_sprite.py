"""Pictures of cones as a camera sees them, and how they are laid over others."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.training.cone_look import ConeLook
from conegraph.training.view import NEAREST_M, Floats, View
from conegraph.types import Array

Labels = NDArray[np.int16]
SHIFT = 4
SHARP_PX = 70.0
"""Cones lower than this are drawn enlarged and made small again."""
LARGEST_PX = 1500


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
