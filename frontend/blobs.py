"""From the pixels of one colour to whole cones, stripes and all."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array, IntArray, Mask

MIN_PIECE_PX = 2
MAX_PIECES = 600
"""The largest are kept: a picture of confetti must not take minutes."""
MANY_PX = 200_000
"""Larger pictures may have more pieces than 16 bits can number."""
LEDGE_M = 0.06
"""What sticks out below a foot must be this high to be the top of another cone."""
LEDGE_SHARE = 0.6
"""It must be narrower than this share of the foot."""
MIN_LEDGE_PX = 3
STRIPE_M = 0.105
"""A white or black stripe is lower than this."""
HEIGHT_SLACK = 1.2


@dataclass(frozen=True, slots=True)
class Pieces:
    """Connected pixels of one colour.

    Attributes:
        colour: (N,) as the picture of colours numbers them.
        box_px: (N, 4) edges, left, top, right, bottom.
        pixel_uv: (M, 2) the pixels, sorted by owner.
        owner: (M,) the piece that each is of.
    """

    colour: IntArray
    box_px: Array
    pixel_uv: IntArray
    owner: IntArray


def find_pieces(colours: NDArray[np.uint8]) -> Pieces:
    """Return the connected pieces of a picture (H, W) of colours, specks left out."""
    kind = cv2.CV_16U if colours.size < MANY_PX else cv2.CV_32S
    _, labels = cv2.connectedComponents(colours, connectivity=8, ltype=kind)
    at = np.flatnonzero(colours != 0)
    colour = colours.ravel()[at].astype(np.int64)
    # Touching pixels of two colours are two pieces.
    key = labels.ravel()[at].astype(np.int64) * 256 + colour
    order = np.argsort(key, kind="stable")
    at, key = at[order], key[order]
    start = np.flatnonzero(np.diff(key, prepend=-1))
    area = np.diff(start, append=len(key))
    enough = area >= MIN_PIECE_PX
    if enough.sum() > MAX_PIECES:
        enough = np.zeros(len(area), dtype=bool)
        enough[np.argsort(-area, kind="stable")[:MAX_PIECES]] = True
    held = np.repeat(enough, area)
    v, u = np.divmod(at[held], colours.shape[1])
    owner = np.repeat(np.arange(int(enough.sum())), area[enough])
    return Pieces(
        key[start[enough]] % 256,
        boxes(u, v, owner),
        np.column_stack([u, v]),
        owner,
    )


def split_ledges(pieces: Pieces, px_per_m: Array) -> tuple[Pieces, IntArray]:
    """Part pieces where they become suddenly narrower from one row to the next below.

    Going down, a cone only becomes wider; where it does not, the foot of one ends
    above the top of another that stands before it.

    Args:
        pieces: the pieces.
        px_per_m: (N,) size of a metre at each.

    Returns:
        The parts, and the piece (N',) that each comes from.
    """
    v, owner = pieces.pixel_uv[:, 1], pieces.owner
    top = (pieces.box_px[:, 1] + 0.5).astype(np.int64)
    rows = (pieces.box_px[:, 3] - pieces.box_px[:, 1]).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(rows)])
    line = first[owner] + v - top[owner]
    piece_of = np.repeat(np.arange(len(rows)), rows)
    width = np.bincount(line, minlength=first[-1]).astype(np.float64)
    inside = piece_of[1:] == piece_of[:-1]
    falls = inside & (width[1:] < LEDGE_SHARE * width[:-1])
    # A corner that points at the camera ends a foot in a row or two.
    left = first[piece_of[:-1] + 1] - np.arange(1, len(width))
    falls &= left >= np.maximum(LEDGE_M * px_per_m[piece_of[:-1]], 2.0)
    falls &= width[:-1] >= MIN_LEDGE_PX
    if falls.sum() > MAX_PIECES:
        return pieces, np.arange(len(rows))
    part_of_line = np.cumsum(np.concatenate([[False], falls | ~inside]))
    part = part_of_line[line]
    order = np.argsort(part, kind="stable")
    uv, part = pieces.pixel_uv[order], part[order]
    origin = np.empty(int(part_of_line[-1]) + 1, dtype=np.int64)
    origin[part_of_line] = piece_of
    box = boxes(uv[:, 0], uv[:, 1], part)
    return Pieces(pieces.colour[origin], box, uv, part), origin


def boxes(u: IntArray, v: IntArray, owner: IntArray) -> Array:
    """Return the edges (N, 4) around the pixels of every owner, sorted by owner."""
    if not len(owner):
        return np.zeros((0, 4))
    start = np.flatnonzero(np.diff(owner, prepend=-1))
    low = [np.minimum.reduceat(axis, start) - 0.5 for axis in (u, v)]
    high = [np.maximum.reduceat(axis, start) + 0.5 for axis in (u, v)]
    return np.column_stack([*low, *high])


def stack_pieces(
    pieces: Pieces, px_per_m: Array, height_m: Array, may_stand: Mask
) -> IntArray:
    """Say which pieces are one cone: stripes cut it into pieces above each other.

    Every piece rests on the nearest wider one below it of its colour that a stripe
    could part it from. What then reaches higher than a cone can, seen from the foot,
    is a cone of its own behind.

    Args:
        pieces: the pieces.
        px_per_m: (N,) size of a metre at the lower edge of each.
        height_m: (N,) how high cones of its colour are at most.
        may_stand: (N,) whether others may rest on it.

    Returns:
        (N,) the row of the foot of the cone that each piece belongs to.
    """
    left, top, right, bottom = pieces.box_px.T
    width, middle = right - left, (left + right) / 2
    # Rows are the piece below, columns the one above.
    gap = top[:, None] - bottom[None, :]
    rests = (gap >= -1.0 - 0.25 * (bottom - top)[None, :]) & (
        gap <= (STRIPE_M * px_per_m)[:, None] + 1.0
    )
    rests &= np.abs(middle[:, None] - middle[None, :]) <= 0.35 * width[:, None] + 1.0
    rests &= width[None, :] <= 1.1 * width[:, None] + 1.0
    rests &= bottom[None, :] < bottom[:, None]
    rests &= pieces.colour[:, None] == pieces.colour[None, :]
    rests &= may_stand[:, None]
    own = np.arange(len(width))
    nearest = np.where(rests, gap, np.inf).argmin(axis=0) if len(own) else own
    below = np.where(rests.any(axis=0), nearest, own)
    foot = _feet(below)
    cone_px = HEIGHT_SLACK * height_m * px_per_m
    too_high = top < bottom[foot] - cone_px[foot] - 2.0
    below = np.where(too_high & ~too_high[below], own, below)
    return _feet(below)


def _feet(below: IntArray) -> IntArray:
    """Follow every piece down to the one that rests on nothing."""
    foot = below
    while not np.array_equal(foot, below[foot]):
        foot = below[foot]
    return foot
