"""Things beside the track that are no cones: sprites on upright panels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from conegraph.sim.render.light import Light
from conegraph.sim.render.paint import Bytes, Floats, blotches, lit, to_bytes
from conegraph.types import Array

_CLEAR_M = 3.6
"""Nothing stands nearer to a cone, so that the lane stays free."""


Made = tuple[Bytes, float, float]
"""A picture (h, w, 4), and the width and height in m of what it shows."""


@dataclass(frozen=True, slots=True)
class Panel:
    """An upright picture in the world.

    Attributes:
        name: what it shows.
        xy_m: (2,) middle of its foot.
        yaw_rad: direction of its face; None always turns to the camera.
        width_m: how wide.
        height_m: how tall.
        levels: pictures (h, w, 4), colour as the camera shows it times coverage,
            and coverage; each of half the size of the last.
    """

    name: str
    xy_m: Array
    yaw_rad: float | None
    width_m: float
    height_m: float
    levels: tuple[Bytes, ...]


def place_clutter(
    cones_m: Array, count: int, light: Light, rng: np.random.Generator
) -> tuple[Panel, ...]:
    """Return things around the track, none of them in a lane.

    Args:
        cones_m: (N, 2) cones.
        count: how many things to try to place.
        light: what they are lit by.
        rng: draws what, where and how it looks.
    """
    tree = cKDTree(cones_m)
    panels = []
    kinds = list(_KINDS)
    weights = np.array([_KINDS[k][0] for k in kinds])
    for _ in range(count):
        kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
        _, make, turned, far_m = _KINDS[kind]
        beside = cones_m[int(rng.integers(len(cones_m)))]
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(_CLEAR_M, far_m)
        place = beside + away * np.array([np.cos(angle), np.sin(angle)])
        sprite, width, height = make(rng)
        nearest = float(tree.query(place)[0])
        yaw = float(rng.uniform(-np.pi, np.pi)) if turned else None
        clear = max(_CLEAR_M, width / 2 + 1.0) if turned else _CLEAR_M + width / 4
        if nearest < clear:
            continue
        color = _roughened(sprite[..., :3].astype(np.float32), rng)
        levels = _levels(to_bytes(lit(color, light)), sprite[..., 3])
        panels.append(Panel(kind, place, yaw, width, height, levels))
    return tuple(panels)


def make_thing(rng: np.random.Generator) -> Made:
    """Return a picture (h, w, 4) of anything that is no cone, its width and height.

    It is in plain light, in colours not yet multiplied by coverage.
    """
    weights = np.array([weight for weight, *_ in _KINDS.values()])
    kind = int(rng.choice(len(_KINDS), p=weights / weights.sum()))
    sprite, width, height = list(_KINDS.values())[kind][1](rng)
    sprite[..., :3] = to_bytes(_roughened(sprite[..., :3].astype(np.float32), rng))
    return sprite, width, height


def _levels(color: Bytes, cover: Bytes) -> tuple[Bytes, ...]:
    """Return a sprite in ever smaller sizes, its colours times its coverage."""
    share = cover[..., None].astype(np.float32) / 255
    levels = [np.dstack([to_bytes(color * share), cover])]
    while max(levels[-1].shape[:2]) > 4:
        tall, wide = (max(side // 2, 1) for side in levels[-1].shape[:2])
        half = cv2.resize(levels[-1], (wide, tall), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, dtype=np.uint8))
    return tuple(levels)


def _roughened(color: Floats, rng: np.random.Generator) -> Floats:
    noise = 1 + 0.05 * blotches((color.shape[0], color.shape[1]), 6, rng)
    return np.asarray(color * noise[..., None] * rng.uniform(0.75, 1.1), np.float32)


def _canvas(height_m: float, width_m: float) -> Bytes:
    """Return an empty sprite (h, w, 4), finer for small things."""
    scale = min(110.0, 260.0 / height_m)
    return np.zeros(
        (max(int(height_m * scale), 8), max(int(width_m * scale), 8), 4), np.uint8
    )


def _color(rng: np.random.Generator, *choices: tuple[int, int, int]) -> Array:
    base = np.array(choices[int(rng.integers(len(choices)))], dtype=np.float64)
    return np.clip(base + rng.normal(0, 10, 3), 5, 250)


def _ink(color: Array) -> tuple[float, float, float, float]:
    red, green, blue = np.clip(color, 0, 255).tolist()
    return red, green, blue, 255.0


def _box(
    sprite: Bytes, u: tuple[float, float], v: tuple[float, float], color: Array
) -> None:
    """Fill a rectangle given in shares of width (u) and height from the foot (v)."""
    height, width = sprite.shape[:2]
    top, foot = int((1 - v[1]) * height), max(int((1 - v[0]) * height), 1)
    left, right = max(int(u[0] * width), 0), max(int(u[1] * width), 1)
    sprite[max(top, 0) : foot, left:right] = np.round(_ink(color))


def _round(
    sprite: Bytes, at: tuple[float, float], size: tuple[float, float], color: Array
) -> None:
    """Fill an ellipse; centre and half axes in shares, the centre from the foot."""
    height, width = sprite.shape[:2]
    centre = (int(at[0] * width), int((1 - at[1]) * height))
    axes = (max(int(size[0] * width), 1), max(int(size[1] * height), 1))
    cv2.ellipse(sprite, centre, axes, 0, 0, 360, _ink(color), -1)


def _person(rng: np.random.Generator) -> Made:
    height, width = rng.uniform(1.55, 1.95), rng.uniform(0.5, 0.7)
    sprite = _canvas(height, width)
    top = _color(
        rng, (245, 100, 30), (230, 60, 30), (225, 235, 50), (30, 80, 180), (60, 60, 62)
    )
    legs = _color(rng, (40, 44, 70), (70, 66, 60), (200, 80, 30), (30, 30, 32))
    skin = _color(rng, (205, 160, 130), (140, 95, 70), (90, 60, 45))
    stride = rng.uniform(0.0, 0.16)
    _box(sprite, (0.28 - stride, 0.46 - stride / 2), (0.0, 0.5), legs)
    _box(sprite, (0.54 + stride / 2, 0.72 + stride), (0.0, 0.5), legs)
    _round(sprite, (0.5, 0.66), (0.28, 0.21), top)
    _box(sprite, (0.12, 0.26), (0.42, 0.78), top * 0.85)
    _box(sprite, (0.74, 0.88), (0.42, 0.78), top * 0.85)
    if rng.random() < 0.5:
        _box(sprite, (0.24, 0.76), (0.60, 0.64), np.array([215.0, 215.0, 205.0]))
    _round(sprite, (0.5, 0.93), (0.13, 0.065), skin)
    _round(sprite, (0.5, 0.96), (0.13, 0.04), _color(rng, (40, 30, 25), (120, 90, 50)))
    return sprite, width, height


def _tree(rng: np.random.Generator) -> Made:
    height = rng.uniform(2.5, 8.0)
    width = height * rng.uniform(0.5, 0.9)
    sprite = _canvas(height, width)
    _box(sprite, (0.46, 0.54), (0.0, 0.5), _color(rng, (80, 62, 48)))
    green = _color(rng, (58, 84, 36), (78, 98, 44), (96, 92, 40), (44, 66, 40))
    boughs = rng.normal((0.5, 0.62), (0.15, 0.14), (9, 2))
    for depth in np.linspace(0.5, 1.3, 500):
        at = boughs[int(rng.integers(len(boughs)))] + rng.normal(0, 0.065, 2)
        leaf = green * (depth + 0.5 * (at[1] - 0.6) + rng.normal(0, 0.08))
        size = rng.uniform(0.008, 0.03)
        _round(sprite, (at[0], at[1]), (size, size * width / height), leaf)
    return sprite, width, height


def _drum(rng: np.random.Generator) -> Made:
    """A barrel or bollard, often orange with white bands: nearly a cone."""
    height, width = rng.uniform(0.6, 1.1), rng.uniform(0.3, 0.6)
    sprite = _canvas(height, width)
    body = _color(rng, (240, 90, 30), (225, 60, 40), (30, 90, 170), (240, 200, 40))
    _box(sprite, (0.0, 1.0), (0.0, 1.0), body)
    for low in (0.2, 0.6):
        if rng.random() < 0.6:
            _box(sprite, (0.0, 1.0), (low, low + 0.15), np.array([230.0, 230.0, 225.0]))
    round_shade = 0.65 + 0.4 * np.sin(np.linspace(0.2, np.pi - 0.4, sprite.shape[1]))
    sprite[..., :3] = to_bytes(sprite[..., :3] * round_shade[None, :, None])
    return sprite, width, height


def _tyres(rng: np.random.Generator) -> Made:
    rows, columns = int(rng.integers(1, 6)), int(rng.integers(1, 9))
    height, width = 0.21 * rows, 0.62 * columns
    sprite = _canvas(height, width)
    for column in range(columns):
        painted = _color(
            rng, (32, 32, 34), (32, 32, 34), (215, 215, 210), (190, 40, 35)
        )
        for row in range(rows):
            u = ((column + 0.03) / columns, (column + 0.97) / columns)
            dark = painted * rng.uniform(0.75, 1.1)
            _box(sprite, u, (row / rows, (row + 0.9) / rows), dark)
            edge = ((row + 0.9) / rows, (row + 1) / rows)
            _box(sprite, u, edge, dark * 0.4)
    return sprite, width, height


def _banner(rng: np.random.Generator) -> Made:
    height, width = rng.uniform(0.6, 1.1), rng.uniform(1.5, 4.0)
    sprite = _canvas(height, width)
    colors = (
        (30, 80, 190),
        (235, 195, 30),
        (220, 50, 40),
        (40, 130, 70),
        (225, 225, 225),
    )
    ground = _color(rng, *colors)
    _box(sprite, (0.0, 1.0), (0.08, 1.0), ground)
    _box(sprite, (0.01, 0.03), (0.0, 1.0), np.full(3, 90.0))
    _box(sprite, (0.97, 0.99), (0.0, 1.0), np.full(3, 90.0))
    ink = np.full(3, 240.0 if ground.mean() < 150 else 30.0)
    word = "".join(rng.choice(list("AEHKLMNORSTVXZ"), int(rng.integers(3, 8))))
    size = sprite.shape[0] / 45
    at = (int(0.08 * sprite.shape[1]), int(0.65 * sprite.shape[0]))
    cv2.putText(sprite, word, at, 0, size, _ink(ink), max(int(size * 3), 1))
    return sprite, width, height


def _case(rng: np.random.Generator) -> Made:
    """A box, a bin, a tent, a parked car: one plain block of a colour."""
    height, width = rng.uniform(0.3, 1.6), rng.uniform(0.4, 2.2)
    sprite = _canvas(height, width)
    body = _color(
        rng, (40, 42, 46), (200, 202, 200), (30, 70, 150), (190, 40, 36), (210, 170, 40)
    )
    _box(sprite, (0.0, 1.0), (0.0, 1.0), body)
    _box(sprite, (0.0, 1.0), (0.45, 0.5), body * 0.6)
    _box(sprite, (0.05, 0.6), (0.6, 0.9), body * rng.uniform(0.5, 1.3))
    return sprite, width, height


_KINDS: dict[str, tuple[float, Callable[[np.random.Generator], Made], bool, float]] = {
    "person": (3.0, _person, False, 14.0),
    "tree": (3.0, _tree, False, 40.0),
    "drum": (1.5, _drum, False, 12.0),
    "tyres": (2.0, _tyres, True, 14.0),
    "banner": (2.0, _banner, True, 18.0),
    "case": (1.5, _case, True, 20.0),
}
"""Weight, maker, whether it has a face of its own, and how far away it may stand."""
