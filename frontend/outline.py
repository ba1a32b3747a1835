"""Where in a box a cone's axis and foot are, to a fraction of a pixel.

A network tells where a box is to a pixel or so; the picture says it better. Going from
a cone to what is beside or below it, the share of cone in a pixel is how far its colour
has come from the other's to the cone's. Only what is not grey counts: shade and shine
do not, and rows of a white stripe say nothing.
"""

from __future__ import annotations

import numpy as np

from conegraph.frontend.base import Picture
from conegraph.frontend.surround import LEAST_STRENGTH
from conegraph.types import Array, Mask

BODY_LEVELS = np.linspace(0.2, 0.65, 13)
"""How far down a box its sides are sought: above the foot, whose corners stick out."""
SIDES = np.linspace(-0.5, 0.5, 41)
"""Where the sides are looked for, in widths of the box from its middle."""
N_BESIDE = 3
"""Outermost columns, and lowest rows, that show what is not the cone."""
TOP_HALF, FOOT_HALF = 0.09, 0.37
"""Half widths of a cone's body at top and foot, in widths of its box."""
LEAST_ROWS = 3
FOOT_LEVELS = np.linspace(0.88, 1.14, 27)
FOOT_COLUMNS = np.array([-0.12, 0.0, 0.12])
FOOT_INSIDE = 0.94
"""Above this level pixels are the foot's for sure."""


def axis_columns(picture: Picture, box_px: Array) -> tuple[Array, Mask]:
    """Return the columns (N,) of the axes of upright cones, and which were found.

    On each row the sides are sought between the box's own; the axis is in the middle
    of them, in the median over the rows. Where none is found it is that of the box.
    """
    size = box_px[:, 2:] - box_px[:, :2]
    middle = box_px[:, [0, 2]].mean(axis=1)
    row = box_px[:, 1, None] + BODY_LEVELS * size[:, 1, None]
    off = SIDES * size[:, 0, None]
    seen = _at(picture, row, middle[:, None] + off)
    edge = _beside(seen)
    half = TOP_HALF + (FOOT_HALF - TOP_HALF) * BODY_LEVELS
    inside = np.abs(SIDES) <= 0.6 * half[:, None]
    body = np.einsum("rc,nrcd->nrd", inside / inside.sum(axis=1)[:, None], seen)
    share, clear = _shares(seen, edge, body[:, :, None])
    within = np.minimum(2.0 * share, 1.0) * (np.abs(SIDES) <= 1.5 * half[:, None])
    weight = within.sum(axis=2)
    shift = np.einsum("nrc,nc->nr", within, off) / np.maximum(weight, 1e-9)
    clear &= weight > 0
    found = clear.sum(axis=1) >= LEAST_ROWS
    shift = np.where(clear, shift, np.nan)
    shift[~found] = 0.0
    return middle + np.nanmedian(shift, axis=1), found


def foot_levels(picture: Picture, box_px: Array, middle: Array) -> Array:
    """Return the rows (N,) of the lower edges of cones whose axes are at ``middle``.

    The lower edge of the box stays where the foot has no colour of its own.
    """
    size = box_px[:, 2:] - box_px[:, :2]
    row = box_px[:, 1, None] + FOOT_LEVELS * size[:, 1, None]
    column = middle[:, None] + FOOT_COLUMNS * size[:, 0, None]
    # One row of the downward way takes the place of the rows above.
    seen = _at(picture, row, column).mean(axis=2)[:, None]
    below = seen[:, :, -N_BESIDE:].mean(axis=2, keepdims=True)
    foot = seen[:, :, FOOT_LEVELS <= FOOT_INSIDE].mean(axis=2, keepdims=True)
    share, clear = _shares(seen, below, foot)
    step = (FOOT_LEVELS[1] - FOOT_LEVELS[0]) * size[:, 1]
    found = row[:, 0] + step * (share[:, 0].sum(axis=1) - 0.5)
    inside = row[:, -1] < len(picture) - 0.5
    return np.where(clear[:, 0] & inside, found, box_px[:, 3])


def _at(picture: Picture, row: Array, column: Array) -> Array:
    """Return colours less their grey (N, R, C, 3) at rows (N, R) and columns (N, C)."""
    rows, columns = picture.shape[:2]
    v = np.clip(np.round(row), 0, rows - 1).astype(np.int64)[:, :, None]
    u = np.clip(np.round(column), 0, columns - 1).astype(np.int64)[:, None, :]
    seen = picture[v, u].astype(np.float64)
    colour: Array = seen - seen.mean(axis=3, keepdims=True)
    return colour


def _beside(seen: Array) -> Array:
    """Return what would be seen without the cone: between both ends, in proportion."""
    left = seen[:, :, :N_BESIDE].mean(axis=2, keepdims=True)
    right = seen[:, :, -N_BESIDE:].mean(axis=2, keepdims=True)
    way = np.linspace(0.0, 1.0, seen.shape[2])[:, None]
    between: Array = left + way * (right - left)
    return between


def _shares(seen: Array, other: Array, own: Array) -> tuple[Array, Mask]:
    """Return shares of cone (N, R, C), ``(x - o) . (c - o) / |c - o|^2`` in [0, 1].

    And say on which rows (N, R) own and other colour differ enough.
    """
    apart = own - other
    strength = (apart**2).sum(axis=3)
    along = ((seen - other) * apart).sum(axis=3)
    share = np.clip(along / np.maximum(strength, 1e-9), 0.0, 1.0)
    return share, np.asarray(strength.mean(axis=2) > LEAST_STRENGTH)
