"""The row at which a cone meets the ground, to a fraction of a pixel.

A pixel is a metre at 20 m, and blur spreads a cone's colour over the ground below it:
the lowest pixel that passes a threshold is not where the cone ends. Going down a few
columns at its middle, the share of cone in a pixel is how far its colour has come from
the ground's to the cone's; the shares add up to the length of cone that is there. Only
what is not grey counts: in a cone's shadow the ground is darker, and still grey.
"""

from __future__ import annotations

import numpy as np

from conegraph.frontend.base import Candidates, Picture
from conegraph.frontend.surround import LEAST_STRENGTH, colours_at
from conegraph.types import Array

COLUMNS = np.linspace(-0.16, 0.16, 5)
"""Where to look, in widths of the cone from its middle."""
INSIDE, OUTSIDE = 2, 2
"""Rows above and below the lowest coloured one at which the edge is sought."""
GROUND_ROWS = 2
"""Rows below those that show the ground."""


def foot_rows(picture: Picture, found: Candidates, middle: Array) -> Array:
    """Return the rows (N,) at which cones meet the ground, at their middles.

    With c the cone's colour, g the ground's and x a pixel's, its share of cone is
    ``(x - g) . (c - g) / |c - g|^2``, kept in [0, 1]. The edge is as far below the
    upper end of the window as the shares in the window add up to.

    Args:
        picture: (H, W, 3) RGB.
        found: cones in it, with their pixels.
        middle: (N,) the column at which each cone's axis meets the ground.
    """
    width = found.box_px[:, 2] - found.box_px[:, 0]
    low = _lowest(found, middle, width)
    column = middle[:, None] + COLUMNS * width[:, None]
    row = low[:, None] + np.arange(-INSIDE, OUTSIDE + GROUND_ROWS + 1)
    strip = colours_at(picture, row, column)
    ground = strip[:, -GROUND_ROWS:].mean(axis=1)
    inside = strip[:, : INSIDE + 1] - ground[:, None]
    vivid = np.einsum("nrc,nrc->nr", inside, inside).argmax(axis=1)
    contrast = inside[np.arange(len(inside)), vivid]
    strength = np.einsum("nc,nc->n", contrast, contrast)
    window = strip[:, : INSIDE + OUTSIDE + 1] - ground[:, None]
    share = np.einsum("nrc,nc->nr", window, contrast)
    share = np.clip(share / np.maximum(strength, 1e-9)[:, None], 0.0, 1.0)
    edge = low - INSIDE - 0.5 + share.sum(axis=1)
    clear = (strength > LEAST_STRENGTH) & (row[:, -1] < len(picture))
    return np.where(clear, edge, low + 0.5)


def _lowest(found: Candidates, middle: Array, width: Array) -> Array:
    """Return the lowest coloured row (N,) near every cone's middle."""
    u, v = found.pixel_uv.T
    reach = np.maximum(np.abs(COLUMNS).max() * width, 1.0)
    near = np.abs(u - middle[found.owner]) <= reach[found.owner]
    low = np.full(len(found), -np.inf)
    np.maximum.at(low, found.owner[near], v[near])
    lowest: Array = np.where(np.isfinite(low), low, found.box_px[:, 3] - 0.5)
    return lowest.astype(np.int64)
