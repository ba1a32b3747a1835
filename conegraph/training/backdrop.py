"""What is behind cones: sky, horizon and ground, all made up."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.paint import cloudy
from conegraph.training.ground_paint import paint_ground
from conegraph.training.palette import GREENS, SHEET_PX, VIVID, Sheets, vivid, write
from conegraph.training.view import Floats, View


def paint_backdrop(view: View, sheets: Sheets, rng: np.random.Generator) -> Floats:
    """Return the picture (H, W, 3) of a place without anything in it."""
    picture = _sky(view, rng)
    _horizon(picture, view, sheets, rng)
    x, y, size = view.ground()
    below = np.isfinite(x)
    if below.any():
        ground = paint_ground(x, y, size, sheets, rng)
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
