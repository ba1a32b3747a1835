"""How much an outline looks like a cone's."""

from __future__ import annotations

import numpy as np

from conegraph.types import Array, IntArray, Mask

MIN_SHAPE_PX = 7.0
"""Lower cones have no taper to speak of."""
RATIO, RATIO_SPREAD = 1.35, 0.40
"""Height over width of a cone's box, and how its logarithm spreads."""
LEAST = 0.05
TOP_HEAVY = 1.1
"""The upper third of a cone alone is never so much wider than the middle one."""
BODY_LEVEL = 0.7
"""The foot begins this far down a cone's box."""


def cone_likeness(box_px: Array, pixel_uv: IntArray, owner: IntArray) -> Array:
    """Return how much each outline (N,) looks like a cone's, 0 to 1.

    Cones are somewhat higher than wide, narrower above than below, and fill about
    half of their box; the fewer pixels there are, the less their shape says.

    Args:
        box_px: (N, 4) boxes.
        pixel_uv: (M, 2) coloured pixels.
        owner: (M,) the box that each is in.

    Returns:
        (N,) likeness, exactly 0 for what is no cone.
    """
    width, height = (box_px[:, 2:] - box_px[:, :2]).T
    ratio, area = height / width, np.bincount(owner, minlength=len(box_px))
    tall = np.exp(-0.5 * (np.log(ratio / RATIO) / RATIO_SPREAD) ** 2)
    taper = np.clip((_taper(box_px, pixel_uv, owner) - 1.0) / 0.6, 0.0, 1.0)
    full = np.clip((area / (width * height) - 0.15) / 0.2, 0.0, 1.0)
    likeness = tall * np.where(height < MIN_SHAPE_PX, 1.0, taper) * full
    return np.where(likeness > LEAST, likeness, 0.0)


def axis_points(box_px: Array, pixel_uv: IntArray, owner: IntArray) -> Array:
    """Return a point (N, 2) on the axis of each: the middle of what is above the foot.

    The foot says less of it: neighbours hide it, and turned, it looks lopsided from
    nearby.
    """
    n = len(box_px)
    height = box_px[:, 3] - box_px[:, 1]
    level = (pixel_uv[:, 1] - box_px[owner, 1]) / height[owner]
    body = level < BODY_LEVEL
    points = [_mean(axis.astype(np.float64), owner, body, n) for axis in pixel_uv.T]
    return np.column_stack(points)


def is_top_heavy(box_px: Array, pixel_uv: IntArray, owner: IntArray) -> Mask:
    """Say which (N,) are wider above than in the middle: another cone sticks there."""
    high, body, _ = _spreads(box_px, pixel_uv, owner)
    return np.asarray((body > 0) & (high > TOP_HEAVY * body))


def _taper(box_px: Array, pixel_uv: IntArray, owner: IntArray) -> Array:
    """Return the spread of the lowest third over that of the others, 1 for a bar.

    The narrower of the others counts: to the upper one, the foot of a cone behind may
    stick.
    """
    high, body, low = _spreads(box_px, pixel_uv, owner)
    # A stripe may leave no pixels between.
    body = np.where(body > 0, body, high)
    ratio: Array = low / np.maximum(np.minimum(high, body), 0.25)
    return ratio


def _spreads(
    box_px: Array, pixel_uv: IntArray, owner: IntArray
) -> tuple[Array, Array, Array]:
    """Return how far from the axis (N,) the upper, middle and lower third spread."""
    n = len(box_px)
    count = np.bincount(owner, minlength=n)
    middle = np.bincount(owner, weights=pixel_uv[:, 0], minlength=n) / count
    height = box_px[:, 3] - box_px[:, 1]
    level = (pixel_uv[:, 1] - box_px[owner, 1]) / height[owner]
    spread = np.abs(pixel_uv[:, 0] - middle[owner]) + 0.25
    third = np.minimum((3 * level).astype(np.int64), 2)
    high, body, low = (_mean(spread, owner, third == k, n) for k in range(3))
    return high, body, low


def _mean(value: Array, owner: IntArray, use: Mask, n: int) -> Array:
    count = np.bincount(owner[use], minlength=n)
    total = np.bincount(owner[use], weights=value[use], minlength=n)
    mean: Array = total / np.maximum(count, 1)
    return mean
