"""Noise and colour that ground, sky and things are painted with."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from conegraph.sim.render.light import Light

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]


def blotches(
    shape: tuple[int, int], size_px: float, rng: np.random.Generator
) -> Floats:
    """Return smooth normal noise (H, W) whose blotches are about ``size_px`` wide."""
    factor = max(int(size_px / 3), 1)
    small = (-(-shape[0] // factor) + 8, -(-shape[1] // factor) + 8)
    white = rng.standard_normal(small, dtype=np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), max(size_px / factor / 2, 0.3))
    wide = (small[1] * factor, small[0] * factor)
    noise = cv2.resize(smooth, wide, interpolation=cv2.INTER_CUBIC)
    noise = noise[: shape[0], : shape[1]]
    return np.asarray(noise / noise.std(), dtype=np.float32)


def tile(side_px: int, size_px: float, rng: np.random.Generator) -> Floats:
    """Return noise (side, side) like `blotches` that repeats without a seam."""
    white = rng.standard_normal((side_px, side_px), dtype=np.float32)
    edge = int(4 * size_px) + 1
    padded = np.pad(white, edge, mode="wrap")
    smooth = cv2.GaussianBlur(padded, (0, 0), max(size_px / 2, 0.3))
    noise = np.asarray(smooth)[edge:-edge, edge:-edge]
    return np.asarray(noise / noise.std(), dtype=np.float32)


def cloudy(
    shape: tuple[int, int], size_px: float, octaves: int, rng: np.random.Generator
) -> Floats:
    """Return noise (H, W) of several sizes, each half as wide and half as strong."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        total += np.float32(0.5**octave) * blotches(shape, size_px / 2**octave, rng)
    return np.asarray(total / total.std(), dtype=np.float32)


def lit(color: ArrayLike, light: Light) -> Floats:
    """Return display values (..., 3) as the camera shows them in this light.

    Greys by ``saturation``, then tint and exposure; not clipped.
    """
    plain = np.asarray(color, dtype=np.float32)
    grey = plain @ np.array([0.30, 0.59, 0.11], dtype=np.float32)
    mixed = grey[..., None] + np.float32(light.saturation) * (plain - grey[..., None])
    factor = np.array(light.tint, dtype=np.float32) * np.float32(light.exposure)
    return np.asarray(mixed * factor, dtype=np.float32)


def to_bytes(picture: NDArray[Any]) -> Bytes:
    """Return display values rounded and clipped to uint8."""
    shown: Bytes = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    return shown


def cut(
    sheet: NDArray[Any], shape: tuple[int, ...], rng: np.random.Generator
) -> NDArray[Any]:
    """Return a piece of a sheet (H, W, ...) at a random place.

    A piece larger than the sheet sees it repeated.
    """
    down, right = rng.integers(0, 2**31, 2).tolist()
    spare = (sheet.shape[0] - shape[0], sheet.shape[1] - shape[1])
    if min(spare) > 0:
        top, left = down % spare[0], right % spare[1]
        return sheet[top : top + shape[0], left : left + shape[1]]
    rows = (down + np.arange(shape[0])) % sheet.shape[0]
    columns = (right + np.arange(shape[1])) % sheet.shape[1]
    return sheet[np.ix_(rows, columns)]
