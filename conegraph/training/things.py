"""Things in made-up photographs that are no cones, though some have their colours."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.clutter import make_thing
from conegraph.sim.render.paint import Bytes
from conegraph.training.cone_sprite import Sprite
from conegraph.training.palette import vivid, write
from conegraph.training.view import Floats, View

MAX_THINGS = 12
LARGEST_PX = 1200
RACER_PX = (104, 256)
LIGHTS = ((255, 40, 30), (255, 245, 225), (255, 180, 40), (60, 160, 255))

Made = tuple[Bytes, float, float]
"""A picture (h, w, 4), and the width and height in m of what it shows."""


def things_ahead(
    view: View, near_m: float, far_m: float, rng: np.random.Generator
) -> list[tuple[float, Sprite]]:
    """Return how far away things are that stand or hang about, and their pictures."""
    wide = 0.6 * view.width_px / view.focal_px
    found = []
    for _ in range(int(rng.integers(0, MAX_THINGS))):
        away = np.exp(rng.uniform(np.log(max(2 * near_m, 3.0)), np.log(2.5 * far_m)))
        (picture, width_m, height_m), bottom_m = _any_thing(rng)
        foot = np.array([[away, away * rng.uniform(-wide, wide), bottom_m]])
        uv, depth = view.pixels(foot)
        scale = view.focal_px / max(float(depth[0]), 0.5)
        size = (int(width_m * scale), int(height_m * scale))
        if min(size) < 2 or max(size) > LARGEST_PX:
            continue
        left, top = int(uv[0, 0] - size[0] / 2), int(uv[0, 1] - size[1])
        found.append((float(away), _sprite(picture, size, left, top, rng)))
    return found


def own_nose(width_px: int, height_px: int, rng: np.random.Generator) -> Sprite:
    """Return the nose and the wheels of the car that carries the camera."""
    top = height_px * rng.uniform(0.68, 0.95)
    rows = max(int(height_px - top), 8)
    nose = np.zeros((rows, width_px, 4), np.uint8)
    middle = width_px * rng.uniform(0.3, 0.7)
    for _ in range(int(rng.integers(2, 9))):
        at = (middle + rng.normal(0, 0.22) * width_px, rng.uniform(0.3, 1.2) * rows)
        _patch(nose, at, (0.13 * width_px, 0.6 * rows), rng)
    _details(nose, rng)
    return _sprite(nose, (width_px, rows), 0, height_px - rows, rng)


def _sprite(
    picture: Bytes, size: tuple[int, int], left: int, top: int, rng: np.random.Generator
) -> Sprite:
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    cover: Floats = small[..., 3] / np.float32(255)
    color = small[..., :3] * cover[..., None] * np.float32(rng.uniform(0.6, 1.2))
    return Sprite(left, top, color, cover, np.zeros(4))


def _any_thing(rng: np.random.Generator) -> tuple[Made, float]:
    """Return something and how high above the ground it is."""
    kind = rng.random()
    if kind < 0.45:
        return make_thing(rng), 0.0
    if kind < 0.65:
        return _racer(rng), 0.0
    return _oddment(rng), 0.0 if rng.random() < 0.6 else rng.uniform(0.0, 2.0)


def _oddment(rng: np.random.Generator) -> Made:
    """Return a shape in a cone's colours that is no cone: a sign, a flag, a bucket."""
    width, height = rng.uniform(0.15, 1.2, 2) * (1.0 if rng.random() < 0.7 else 2.5)
    side = 96
    sprite = np.zeros((side, side, 4), np.uint8)
    ink = (*vivid(rng).tolist(), 255.0)
    kind = rng.random()
    if kind < 0.3:
        cv2.rectangle(sprite, (2, 2), (side - 3, side - 3), ink, -1)
    elif kind < 0.5:
        cv2.ellipse(sprite, (48, 48), (46, 46), 0, 0, 360, ink, -1)
    else:
        corners = rng.uniform(0, side, (int(rng.integers(3, 7)), 2))
        cv2.fillConvexPoly(sprite, cv2.convexHull(corners.astype(np.int32)), ink)
    for _ in range(int(rng.integers(0, 4))):
        first, last = np.sort(rng.integers(0, side, 2)).tolist()
        part = np.s_[first:last] if rng.random() < 0.5 else np.s_[:, first:last]
        sprite[part][..., :3] = vivid(rng).astype(np.uint8)
    if rng.random() < 0.3:
        color = sprite[..., :3].astype(np.float32)
        write(color, vivid(rng), rng)
        sprite[..., :3] = np.clip(color, 0, 255).astype(np.uint8)
    return sprite, float(width), float(height)


def _racer(rng: np.random.Generator) -> Made:
    """Return a racing car: dark and angular, with wheels, a number and lights."""
    height, width = RACER_PX
    car = np.zeros((height, width, 4), np.uint8)
    for _ in range(int(rng.integers(3, 8))):
        at = (rng.uniform(0.2, 0.8) * width, rng.uniform(0.4, 0.8) * height)
        _patch(car, at, (0.16 * width, 0.2 * height), rng)
    for share in rng.uniform((0.1, 0.6), (0.4, 0.9)):
        radius = int(rng.uniform(0.15, 0.24) * height)
        hub = (int(share * width), height - radius)
        cv2.ellipse(car, hub, (radius, radius), 0, 0, 360, (28, 28, 30, 255), -1)
        cv2.ellipse(car, hub, (radius // 3,) * 2, 0, 0, 360, (110, 110, 112, 255), -1)
    _details(car, rng)
    return car, float(rng.uniform(2.2, 3.2)), float(rng.uniform(0.9, 1.4))


def _patch(
    sprite: Bytes,
    at: tuple[float, float],
    spread: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """Fill an angular patch, more often dark than in a colour."""
    corners = at + rng.normal(0, 1, (int(rng.integers(4, 8)), 2)) * spread
    color = vivid(rng) if rng.random() < 0.4 else np.full(3, rng.uniform(10, 80))
    ink = (*color.tolist(), 255.0)
    cv2.fillConvexPoly(sprite, cv2.convexHull(corners.astype(np.int32)), ink)


def _details(sprite: Bytes, rng: np.random.Generator) -> None:
    """Put numbers, bars, stickers and lamps on what a sprite covers."""
    height, width = sprite.shape[:2]
    drawn = np.ascontiguousarray(sprite[..., :3])
    for _ in range(int(rng.integers(2, 14))):
        at = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        end = (at[0] + int(rng.normal(0, 30)), at[1] + int(rng.normal(0, 12)))
        white = rng.uniform(170, 255)
        ink = vivid(rng).tolist() if rng.random() < 0.5 else [white, white, white]
        kind = rng.random()
        if kind < 0.3:
            text = "".join(rng.choice(list("0123456789AEHKMNRST"), 3))
            cv2.putText(drawn, text, at, 0, rng.uniform(0.3, 1.1), ink, 2)
        elif kind < 0.5:
            cv2.line(drawn, at, end, ink, int(rng.integers(1, 5)), cv2.LINE_AA)
        elif kind < 0.7:
            cv2.rectangle(drawn, at, end, ink, -1)
        else:
            lamp = LIGHTS[int(rng.integers(len(LIGHTS)))]
            radius = int(rng.integers(2, 11))
            cv2.circle(drawn, at, radius, lamp, -1, cv2.LINE_AA)
            cv2.circle(drawn, at, radius // 2, (255, 250, 240), -1, cv2.LINE_AA)
    sprite[..., :3] = drawn
