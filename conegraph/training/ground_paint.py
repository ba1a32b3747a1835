"""The ground of made-up pictures: asphalt, grass, lines, kerbs, tyre marks."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.training.palette import GREENS, SHEET_PX, Sheets, vivid
from conegraph.training.view import Floats

GROUNDS = np.array(
    [(118, 116, 114), (84, 86, 90), (150, 146, 138), (62, 62, 66), (136, 122, 98)],
    dtype=np.float32,
)
"""Asphalt old, new, concrete, wet asphalt, sand."""


def paint_ground(
    x: Floats, y: Floats, size: Floats, sheets: Sheets, rng: np.random.Generator
) -> Floats:
    """Return the ground's colours (H, W, 3), with grass, paint, kerbs and lines.

    Args:
        x: (H, W) how far ahead of the camera pixels show the ground, in m.
        y: (H, W) and how far to the left.
        size: (H, W) how large a pixel is there, in m.
        sheets: noise.
        rng: draws what there is.
    """
    x = np.minimum(x, 1e4).astype(np.float32)
    y = np.clip(y, -1e4, 1e4).astype(np.float32)
    color = GROUNDS[int(rng.integers(len(GROUNDS)))] * np.float32(rng.uniform(0.6, 1.4))
    if rng.random() < 0.12:
        color = GREENS[int(rng.integers(len(GREENS)))]
    color = color + rng.normal(0, 5, 3).astype(np.float32)
    fine = _seen(sheets.fine, x, y, rng.uniform(0.006, 0.02), size)
    rough = _seen(sheets.rough, x, y, rng.uniform(0.02, 0.2), size)
    soft = _seen(sheets.soft, x, y, rng.uniform(0.02, 0.1), size)
    strength = rng.uniform((0.02, 0.01, 0.02), (0.14, 0.09, 0.12)).astype(np.float32)
    texture = 1 + strength[0] * fine + strength[1] * rough + strength[2] * soft
    ground = color * texture[..., None]
    for _ in range(int(rng.integers(0, 5))):
        _mark(ground, x, y, size, rough, rng)
    return np.asarray(ground, dtype=np.float32)


def _seen(sheet: Floats, x: Floats, y: Floats, step_m: float, size: Floats) -> Floats:
    """Return noise whose samples are ``step_m`` apart, gone where pixels are larger."""
    scale = np.float32(1.0 / step_m)
    u, v = (x * scale) % SHEET_PX, (y * scale) % SHEET_PX
    noise = cv2.remap(sheet, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    # Pixels are long on the ground where it is seen flat.
    shown = np.clip(3.0 * np.float32(step_m) / np.maximum(size, 1e-6), 0.0, 1.0)
    return np.asarray(noise * np.maximum(shown, 0.15), dtype=np.float32)


def _mark(
    ground: Floats,
    x: Floats,
    y: Floats,
    size: Floats,
    rough: Floats,
    rng: np.random.Generator,
) -> None:
    """Paint one line, dashes, kerb, tyre mark, stretch of grass or coloured area."""
    angle = rng.normal(0, 0.5) if rng.random() < 0.7 else rng.uniform(-1.6, 1.6)
    c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    along, off = c * x + s * y, c * y - s * x
    bent = np.minimum(along, 200.0) ** 2
    off = (
        off - np.float32(rng.uniform(-12, 12)) + np.float32(rng.normal(0, 0.01)) * bent
    )
    kind = rng.random()
    if kind < 0.45:
        layers = _line(along, rng) if kind < 0.3 else _kerb(along, rng)
    elif kind < 0.65:
        half, dark = rng.uniform(0.1, 0.2), rng.uniform(20, 60)
        rubber = np.full_like(off, rng.uniform(0.1, 0.5))
        layers = [(half, rubber, np.full(3, dark))]
    elif kind < 0.85:
        half = rng.uniform(2, 30)
        off = off + np.sign(off.mean()) * half + 0.1 * rough
        green = GREENS[int(rng.integers(len(GREENS)))] * rng.uniform(0.6, 1.3)
        tufts = 0.5 * np.clip(0.5 + 0.5 * rough, 0, 1)
        layers = [(half, np.ones_like(off), 0.9 * green), (half, tufts, 1.15 * green)]
    else:
        half, share = rng.uniform(0.5, 6), rng.uniform(0.2, 0.8)
        worn = share * np.clip(0.8 + 0.3 * rough, 0, 1)
        layers = [(half, worn, vivid(rng) * 0.7 + 30)]
    for half, opacity, color in layers:
        _blend(ground, half, off, size, opacity, color)


Layer = tuple[float, Floats, Floats]
"""Half a stripe's width in m, its opacity (H, W) and its colour (3,)."""


def _line(along: Floats, rng: np.random.Generator) -> list[Layer]:
    """Return a line, most often white, perhaps of dashes."""
    half, opacity = rng.uniform(0.04, 0.12), rng.uniform(0.4, 1.0)
    white = np.full(3, rng.uniform(170, 250))
    color = white if rng.random() < 0.7 else vivid(rng)
    dashed = rng.random() < 0.3
    shown = along % 4.0 < 2.0 if dashed else np.ones_like(along)
    return [(half, opacity * shown, color)]


def _kerb(along: Floats, rng: np.random.Generator) -> list[Layer]:
    """Return blocks in two colours by turns."""
    half, block = rng.uniform(0.2, 0.8), rng.uniform(0.5, 2.0)
    opacity = rng.uniform(0.4, 1.0)
    first = along % (2 * block) < block
    return [(half, opacity * first, vivid(rng)), (half, opacity * ~first, vivid(rng))]


def _blend(
    ground: Floats,
    half: float,
    off: Floats,
    size: Floats,
    opacity: Floats,
    color: Floats,
) -> None:
    """Paint a stripe with soft edges, half as wide as ``half`` metres."""
    soft = np.maximum(size, 0.02)
    cover = np.clip((half - np.abs(off)) / soft + 0.5, 0, 1) * opacity
    # A stripe that is thinner than a pixel covers but a part of it.
    cover = (cover * np.minimum(2 * half / soft, 1.0))[..., None]
    ground *= 1 - cover
    ground += cover * color
