"""What is behind cones: sky, horizon and ground, all made up."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from conegraph.sim.render.paint import cloudy, tile
from conegraph.training.view import Floats, View

SHEET_PX = 512
GROUNDS = np.array(
    [(118, 116, 114), (84, 86, 90), (150, 146, 138), (62, 62, 66), (136, 122, 98)],
    dtype=np.float32,
)
"""Asphalt old, new, concrete, wet asphalt, sand."""
GREENS = np.array(
    [(92, 108, 58), (70, 92, 46), (126, 124, 76), (150, 138, 96), (60, 70, 44)],
    dtype=np.float32,
)
"""Grass in spring, summer, autumn; straw; trees."""
VIVID = np.array(
    [
        (235, 90, 30),
        (225, 50, 40),
        (250, 200, 40),
        (215, 235, 40),
        (35, 90, 190),
        (40, 150, 215),
        (30, 130, 70),
        (235, 235, 230),
        (40, 40, 44),
        (120, 40, 120),
    ],
    dtype=np.float32,
)
"""Colours of what people make: cones' own are among them on purpose."""


@dataclass(frozen=True, slots=True)
class Sheets:
    """Noise that repeats, (K, S, S), from fine to coarse; mean 0, deviation 1."""

    fine: Floats
    rough: Floats
    soft: Floats


def make_sheets(rng: np.random.Generator) -> Sheets:
    """Return noise to cut pieces from."""
    fine, rough, soft = (tile(SHEET_PX, size, rng) for size in (2.0, 7.0, 40.0))
    return Sheets(fine, np.asarray(0.6 * rough + 0.4 * fine, np.float32), soft)


def vivid(rng: np.random.Generator) -> Floats:
    """Return a colour (3,) as people paint things."""
    color = VIVID[int(rng.integers(len(VIVID)))] * rng.uniform(0.6, 1.1)
    shown: Floats = np.clip(color + rng.normal(0, 12, 3), 0, 255)
    return shown


def paint_backdrop(view: View, sheets: Sheets, rng: np.random.Generator) -> Floats:
    """Return the picture (H, W, 3) of a place without anything in it."""
    picture = _sky(view, rng)
    _horizon(picture, view, sheets, rng)
    x, y, size = view.ground()
    below = np.isfinite(x)
    if below.any():
        ground = _ground(x, y, size, sheets, rng)
        if rng.random() < 0.25:
            ground = _wet(picture, ground, view, sheets, rng)
        np.copyto(picture, ground, where=below[..., None])
    return picture


def _sky(view: View, rng: np.random.Generator) -> Floats:
    shape = (view.height_px, view.width_px)
    level = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None, None]
    blue = np.array([110, 155, 215], np.float32) * np.float32(rng.uniform(0.6, 1.1))
    pale = np.array([205, 215, 228], np.float32) * np.float32(rng.uniform(0.7, 1.1))
    covered = np.float32(rng.uniform(-1.5, 2.5))
    small = (shape[0] // 4, shape[1] // 4)
    clouds = cloudy(small, float(rng.uniform(15, 60)), 3, rng) + covered
    clouds = cv2.resize(np.clip(clouds, 0, 1.5), (shape[1], shape[0]))[..., None]
    plain = blue + level * (pale - blue)
    bright = np.float32(rng.uniform(170, 255))
    return np.asarray(plain + np.minimum(clouds, 1) * (bright - 30 * clouds - plain))


def _horizon(
    picture: Floats, view: View, sheets: Sheets, rng: np.random.Generator
) -> None:
    """Paint hills, trees, stands, walls and banners in strips, far ones first."""
    row = view.horizon_px()
    metre = view.focal_px / 60.0
    for _ in range(int(rng.integers(1, 6))):
        high = rng.uniform(0.8, 9.0) * metre * rng.uniform(0.3, 1.5)
        low = row + rng.uniform(0.0, 1.2) * metre
        left = rng.uniform(-0.4, 0.8) * view.width_px
        right = left + rng.uniform(0.2, 1.6) * view.width_px
        kind = rng.random()
        if kind < 0.45:
            _trees(picture, (left, low - high, right, low), sheets, rng)
        elif kind < 0.6:
            _crowd(picture, (left, low - high, right, low), rng)
        else:
            _wall(picture, (left, low - 0.5 * high, right, low), rng)


Box = tuple[float, float, float, float]


def _window(picture: Floats, box: Box) -> tuple[int, int, int, int]:
    rows, columns = picture.shape[:2]
    left, right = np.clip([box[0], box[2]], 0, columns).astype(int).tolist()
    top, low = np.clip([box[1], box[3] + 1], 0, rows).astype(int).tolist()
    return left, top, right, low


def _trees(picture: Floats, box: Box, sheets: Sheets, rng: np.random.Generator) -> None:
    left, top, right, low = _window(picture, box)
    if right - left < 4 or low - top < 2:
        return
    green = GREENS[int(rng.integers(len(GREENS)))] * np.float32(rng.uniform(0.4, 1.1))
    crown = sheets.soft[int(rng.integers(SHEET_PX))].repeat(3)[: right - left]
    crown = (
        crown * 0.25
        + 0.1 * sheets.rough[int(rng.integers(SHEET_PX))].repeat(2)[: right - left]
    )
    edge = top + (low - top) * np.clip(0.4 + crown, 0, 1)
    part = picture[top:low, left:right]
    shape = part.shape[:2]
    leaf = green * (1 + 0.25 * _piece(sheets.rough, shape, rng))[..., None]
    inside = np.arange(top, low)[:, None] >= edge[None, :]
    np.copyto(part, leaf.astype(np.float32), where=inside[..., None])


def _piece(sheet: Floats, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    down, right = rng.integers(0, SHEET_PX, 2).tolist()
    rows = (down + np.arange(shape[0])) % SHEET_PX
    columns = (right + np.arange(shape[1])) % SHEET_PX
    return np.asarray(sheet[np.ix_(rows, columns)])


def _crowd(picture: Floats, box: Box, rng: np.random.Generator) -> None:
    """Paint stands, houses or shelves: a grid of cells of any colour."""
    left, top, right, low = _window(picture, box)
    if right - left < 4 or low - top < 4:
        return
    cell = rng.uniform(3, 20)
    shape = (max(int((low - top) / cell), 1), max(int((right - left) / cell), 1), 3)
    base = rng.uniform(50, 200)
    cells = base + rng.uniform(5, 70) * rng.standard_normal(shape)
    if rng.random() < 0.5:
        some = rng.random(shape[:2]) < 0.15
        cells[some] = VIVID[rng.integers(0, len(VIVID), int(some.sum()))]
    else:
        cells = cells.mean(axis=2, keepdims=True).repeat(3, axis=2)
    way = cv2.INTER_NEAREST if rng.random() < 0.5 else cv2.INTER_LINEAR
    small = np.clip(cells, 0, 255).astype(np.float32)
    picture[top:low, left:right] = cv2.resize(
        small, (right - left, low - top), interpolation=way
    )


def _wall(picture: Floats, box: Box, rng: np.random.Generator) -> None:
    """Paint a wall: plain, of blocks in two colours, of tyres, or lettered."""
    left, top, right, low = _window(picture, box)
    wide, high = right - left, low - top
    if wide < 4 or high < 2:
        return
    part = picture[top:low, left:right]
    color, other = vivid(rng), vivid(rng)
    part[:] = color
    kind = rng.random()
    if kind < 0.35:
        step = rng.uniform(0.4, 4.0) * high
        second = (np.arange(wide) / step).astype(int) % 2 == 1
        part[:, second] = other
    elif kind < 0.6:
        step = rng.uniform(0.3, 0.9) * high
        u = np.arange(wide, dtype=np.float32)[None] / np.float32(step)
        v = np.arange(high, dtype=np.float32)[:, None] / np.float32(0.4 * step)
        dark = 0.35 + 0.65 * np.abs(np.sin(np.pi * u)) * np.abs(np.sin(np.pi * v))
        part *= dark[..., None]
    if kind > 0.5:
        write(part, other, rng)
    part *= np.linspace(1.0, rng.uniform(0.5, 1.0), high)[:, None, None].astype(
        np.float32
    )


def write(part: Floats, ink: Floats, rng: np.random.Generator) -> None:
    """Write words over a part (h, w, 3) of a picture."""
    high, wide = part.shape[:2]
    word = "".join(rng.choice(list("ABCDEFGHIKLMNORSTUVX  0123456789"), 40))
    size = high / 30 * rng.uniform(0.3, 1.0)
    letters = np.zeros((high, wide), np.uint8)
    at = (int(rng.uniform(-0.2, 0.6) * wide), int(rng.uniform(0.6, 0.9) * high))
    cv2.putText(letters, word, at, 0, size, 255, max(int(3 * size), 1))
    part[letters > 127] = ink


def _ground(
    x: Floats, y: Floats, size: Floats, sheets: Sheets, rng: np.random.Generator
) -> Floats:
    """Return the ground's colours (H, W, 3), with grass, paint, kerbs and lines."""
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


def _wet(
    above: Floats, ground: Floats, view: View, sheets: Sheets, rng: np.random.Generator
) -> Floats:
    """Return the ground as it mirrors, blurred, what stands over it."""
    row = int(np.clip(view.horizon_px(), 1, view.height_px - 1))
    rows = np.clip(2 * row - np.arange(view.height_px), 0, row)
    mirror = np.asarray(cv2.blur(above[rows], (5, 25)))
    sheet = cv2.resize(sheets.soft, (view.width_px, view.height_px))
    share = np.clip(rng.uniform(0.1, 0.5) + 0.2 * sheet, 0, 0.7)[..., None]
    return np.asarray(ground * np.float32(0.8) * (1 - share) + share * mirror)
