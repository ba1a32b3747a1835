"""What is around a cone: it stands out from its sides, and has a top.

Colours are compared without their grey, so that shade and shine do not count.
"""

from __future__ import annotations

import numpy as np

from conegraph.frontend.base import Picture
from conegraph.types import Array, IntArray

LEAST_STRENGTH = 300.0
"""Squared difference of colours below which nothing can be told."""
SIDE_LEVELS = (0.5, 0.65, 0.8)
"""How far down a box its sides are looked at."""
TOP_LEVELS = (0.08, 0.16, 0.24)
"""How far down a cone its colour is looked for above the stripe."""


def colours_at(picture: Picture, row: Array, column: Array) -> Array:
    """Return colours less their grey (N, R, 3) at rows (N, R), mean of columns (N, C).

    What lies outside the picture is taken from its edge.
    """
    rows, columns = picture.shape[:2]
    v = np.clip(np.round(row), 0, rows - 1).astype(np.int64)[:, :, None]
    u = np.clip(np.round(column), 0, columns - 1).astype(np.int64)[:, None, :]
    strip = picture[v, u].astype(np.float64).mean(axis=2)
    coloured: Array = strip - strip.mean(axis=2, keepdims=True)
    return coloured


def own_colours(picture: Picture, pixel_uv: IntArray, owner: IntArray, n: int) -> Array:
    """Return the mean colour less its grey (N, 3) of the pixels of each."""
    u, v = pixel_uv.T
    own = picture[v, u].astype(np.float64)
    own -= own.mean(axis=1, keepdims=True)
    count = np.maximum(np.bincount(owner, minlength=n), 1)
    sums = [np.bincount(owner, weights=channel, minlength=n) for channel in own.T]
    return np.column_stack(sums) / count[:, None]


def side_contrast(picture: Picture, box_px: Array, own: Array) -> Array:
    """Return how much cones (N,) differ from what is beside them, 0 to about 1.

    It is ``|c - s|^2 / |c|^2`` with c the cone's colour and s that of the side that
    differs more: on the other one a cone of the same colour may stand. Dry grass has
    a yellow cone's hue, and no such sides.
    """
    left, top, right, bottom = box_px.T
    row = top[:, None] + np.array(SIDE_LEVELS) * (bottom - top)[:, None]
    away = 1.5 + 0.1 * (right - left)
    strength = np.maximum((own**2).sum(axis=1), LEAST_STRENGTH)
    apart = [
        ((colours_at(picture, row, side[:, None]) - own[:, None]) ** 2)
        .sum(axis=2)
        .mean(axis=1)
        for side in (left - away, right + away)
    ]
    contrast: Array = np.maximum(*apart) / strength
    return contrast


def top_shares(
    picture: Picture, own: Array, middle: Array, top: Array, height_px: Array
) -> Array:
    """Return how much of a cone's colour (N,) is where its top should be.

    Args:
        picture: (H, W, 3) RGB.
        own: (N, 3) the colours of the cones.
        middle: (N,) columns of their axes.
        top: (N,) rows where their tops should be.
        height_px: (N,) their heights.
    """
    column = middle[:, None]
    above = (top - 0.12 * height_px - 1.5)[:, None]
    behind = colours_at(picture, above, column)[:, 0]
    contrast = own - behind
    strength = np.maximum((contrast**2).sum(axis=1), LEAST_STRENGTH)
    row = top[:, None] + np.array(TOP_LEVELS) * height_px[:, None]
    seen = colours_at(picture, row, column) - behind[:, None]
    share = np.einsum("nrc,nc->nr", seen, contrast) / strength[:, None]
    best: Array = share.max(axis=1)
    return best
