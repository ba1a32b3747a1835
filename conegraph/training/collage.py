"""Made-up photographs of cones: a place, cones and other things, and the truth."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.training.backdrop import paint_backdrop
from conegraph.training.cone_look import draw_look, placed
from conegraph.training.cone_sprite import Sprite, draw_sprite, paste
from conegraph.training.palette import Sheets
from conegraph.training.sample import IGNORED, Sample
from conegraph.training.things import own_nose, things_ahead
from conegraph.training.view import Floats, View, draw_view
from conegraph.types import Array, ConeClass

WIDTH_PX, HEIGHT_PX = 672, 512
CLASSES = (
    ConeClass.BLUE,
    ConeClass.YELLOW,
    ConeClass.ORANGE,
    ConeClass.BIG_ORANGE,
)
LEAST_VISIBLE = 0.35
"""Cones of which less is seen are neither asked for nor wrong."""
MAX_CONES = 45


def make_collages(count: int, sheets: Sheets, rng: np.random.Generator) -> list[Sample]:
    """Return pictures of one place with other cones and things in each."""
    view, reach_m = draw_view(rng, WIDTH_PX, HEIGHT_PX)
    empty = paint_backdrop(view, sheets, rng)
    return [_furnished(empty, view, reach_m, sheets, rng) for _ in range(count)]


def _furnished(
    empty: Floats,
    view: View,
    reach_m: tuple[float, float],
    sheets: Sheets,
    rng: np.random.Generator,
) -> Sample:
    """Return the place with cones, and their boxes, hidden parts included."""
    picture, (near, far) = empty.copy(), reach_m
    label = np.full(picture.shape[:2], -1, np.int16)
    at, classes = _places(view, near, far, rng)
    fallen = rng.random(len(at)) < (0.15 if rng.random() < 0.3 else 0.0)
    sunny = rng.random() < 0.55
    mirror = rng.uniform(0.15, 0.6) if rng.random() < 0.2 else 0.0
    looks = {c: [draw_look(rng, c) for _ in range(2)] for c in CLASSES}
    cones: list[tuple[float, int, Sprite]] = []
    if sunny:
        _shadows(picture, view, at, rng)
    for row, xy in enumerate(at):
        look = looks[CLASSES[classes[row]]][int(rng.random() < 0.25)]
        yaw = float(rng.uniform(-np.pi, np.pi))
        if fallen[row] and rng.random() < 0.5:
            yaw = float(rng.choice((0.5, -0.5)) * np.pi + rng.normal(0, 0.5))
        faces, points = placed(look, xy, yaw, fallen=bool(fallen[row]))
        sprite = draw_sprite(view, look, faces, points, sheets.rough, rng)
        if sprite is not None:
            cones.append((float(np.hypot(*xy)), row, sprite))
    things: list[tuple[float, int, Sprite]] = [
        (away, -1, sprite) for away, sprite in things_ahead(view, near, far, rng)
    ]
    alone = np.zeros(len(at), dtype=np.int64)
    for _, row, sprite in sorted([*cones, *things], key=lambda item: -item[0]):
        if mirror and row >= 0:
            _mirrored(picture, sprite, mirror)
        covered = paste(picture, label, sprite, row)
        if row >= 0:
            alone[row] = covered
    _foreground(picture, label, rng)
    shown = np.bincount(label[label >= 0], minlength=len(at))
    keep = np.array([row for _, row, _ in cones], dtype=np.int64)
    box = np.array([sprite.box_px for *_, sprite in cones]).reshape(-1, 4)
    share = shown[keep] / np.maximum(alone[keep], 1)
    kind = np.where(share >= LEAST_VISIBLE, classes[keep], IGNORED)
    seen = share > 0.02
    color = np.clip(picture, 0, 255).astype(np.uint8)
    return Sample(color, box[seen], kind[seen])


def _places(
    view: View, near: float, far: float, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """Return where cones stand (N, 2), in rows and alone, and their classes (N,)."""
    wide = 0.5 * view.width_px / view.focal_px
    rows = []
    kinds = []
    for _ in range(int(rng.integers(0, 6))):
        count = int(rng.integers(3, 14))
        away = np.exp(rng.uniform(np.log(near), np.log(far)))
        start = np.array([away, away * rng.uniform(-wide, wide)])
        angle = rng.uniform(-np.pi, np.pi)
        bend, step = rng.normal(0, 0.15), rng.uniform(0.35, 5.0)
        heading = angle + bend * np.arange(count)
        moves = step * np.column_stack([np.cos(heading), np.sin(heading)])
        rows.append(start + np.cumsum(moves, axis=0) + rng.normal(0, 0.1, (count, 2)))
        kinds.append(np.full(count, rng.integers(len(CLASSES))))
    alone = int(rng.integers(0, 12))
    away = np.exp(rng.uniform(np.log(near), np.log(far), alone))
    rows.append(np.column_stack([away, away * rng.uniform(-wide, wide, alone)]))
    kinds.append(rng.integers(0, len(CLASSES), alone))
    at, kind = np.vstack(rows), np.concatenate(kinds)
    fits = (at[:, 0] > 0.7 * near) & (np.abs(at[:, 1]) < 1.1 * wide * at[:, 0] + 0.3)
    at, kind = at[fits][:MAX_CONES], kind[fits][:MAX_CONES]
    gap = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1))
    crowded = np.triu(gap < 0.33, 1).any(axis=0)
    return at[~crowded], kind[~crowded].astype(np.int64)


def _shadows(picture: Floats, view: View, at: Array, rng: np.random.Generator) -> None:
    """Darken the ground where the sun is hidden by cones."""
    angle, long = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 2.5) * 0.33
    tip = long * np.array([np.cos(angle), np.sin(angle)])
    aside = 0.1 * np.array([-np.sin(angle), np.cos(angle)])
    mask = np.zeros(picture.shape[:2], np.float32)
    for xy in at:
        corners = np.array([xy + aside, xy - aside, xy + tip])
        uv, depth = view.pixels(np.column_stack([corners, np.zeros(3)]))
        if depth.min() > 0.5 and np.abs(uv).max() < 3000:
            cv2.fillConvexPoly(mask, (uv * 16).astype(np.int32), 1.0, cv2.LINE_AA, 4)
    picture *= 1.0 - np.float32(rng.uniform(0.2, 0.6)) * mask[..., None]


def _mirrored(picture: Floats, sprite: Sprite, share: float) -> None:
    height = sprite.cover.shape[0]
    fade = np.linspace(share, 0.2 * share, height, dtype=np.float32)[:, None]
    top = sprite.top + height - max(int(0.08 * height), 1)
    color = cv2.blur(sprite.color[::-1], (1, max(height // 12, 1)))
    flipped = Sprite(
        sprite.left,
        top,
        color * fade[..., None],
        sprite.cover[::-1] * fade,
        sprite.box_px,
    )
    paste(picture, None, flipped, -1)


def _foreground(
    picture: Floats, label: NDArray[np.int16], rng: np.random.Generator
) -> None:
    """Put the car's own nose or a fence in front of it all, sometimes."""
    rows, columns = label.shape
    if rng.random() < 0.35:
        paste(picture, label, own_nose(columns, rows, rng), -1)
    if rng.random() < 0.08:
        step, slope = int(rng.integers(12, 50)), rng.uniform(-1.2, 1.2)
        wire = [rng.uniform(40, 190)] * 3
        for u in range(-columns, 2 * columns, step):
            for sign in (1, -1):
                end = (int(u + sign * slope * rows), rows)
                cv2.line(picture, (u, 0), end, wire, 1, cv2.LINE_AA)
