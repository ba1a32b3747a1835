"""Cones that touch in the picture, told apart by their tops."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from conegraph.frontend.blobs import boxes
from conegraph.frontend.scale import CONE_HEIGHT_M
from conegraph.types import Array, IntArray

MIN_HEIGHT_PX = 9
MIN_WIDTH_M = 0.36
"""Two cones are wider than this; a small one is not, however its foot is turned."""
MIN_APART_M = 0.14
"""Tops nearer to each other than this are one cone's."""
MIN_DIP = 0.30
"""Between two tops the outline falls by this share of the lower one's height."""


def split_towers(
    pixel_uv: IntArray, owner: IntArray, px_per_m: Array
) -> tuple[IntArray, IntArray]:
    """Part outlines with several tops at the lowest columns between them.

    Args:
        pixel_uv: (M, 2) coloured pixels, sorted by owner.
        owner: (M,) the outline that each is of.
        px_per_m: (N,) size of a metre at each.

    Returns:
        The new owners (M,) of the pixels, and for each of them, (N',), the outline
        that it comes from.
    """
    start = np.flatnonzero(np.diff(owner, prepend=-1, append=-1))
    size = boxes(pixel_uv[:, 0], pixel_uv[:, 1], owner)
    width, height = size[:, 2] - size[:, 0], size[:, 3] - size[:, 1]
    # Several cones in a row are taken for a wide one where only width gives a scale.
    px_per_m = np.minimum(px_per_m, height / CONE_HEIGHT_M)
    large = (width > MIN_WIDTH_M * px_per_m) & (height >= MIN_HEIGHT_PX)
    made, origin = owner.copy(), list(range(len(px_per_m)))
    for row in np.flatnonzero(large).tolist():
        a, b = start[row], start[row + 1]
        u, v = pixel_uv[a:b].T
        cuts = _cuts(u - u.min(), v, MIN_APART_M * px_per_m[row]) + u.min()
        side = np.searchsorted(cuts, u)
        for k in range(1, len(cuts) + 1):
            made[a:b][side == k] = len(origin)
            origin.append(row)
    return made, np.array(origin)


def _cuts(u: IntArray, v: IntArray, apart_px: float) -> IntArray:
    """Return the columns to cut at, between the tops of one outline."""
    profile = np.zeros(int(u.max()) + 1)
    np.maximum.at(profile, u, v.max() + 1 - v)
    window = max(3, 2 * int(apart_px / 2) + 1)
    highest = maximum_filter1d(profile, window, mode="constant")
    peaks = np.flatnonzero((profile == highest) & (profile > 0.35 * profile.max()))
    # A flat top is one peak, at its first column.
    peaks = peaks[np.diff(peaks, prepend=-window) > 1]
    cuts: list[int] = []
    last = peaks[0]
    for peak in peaks[1:]:
        between = profile[last : peak + 1]
        if between.min() < (1.0 - MIN_DIP) * min(profile[last], profile[peak]):
            cuts.append(int(last) + int(between.argmin()))
            last = peak
        elif profile[peak] > profile[last]:
            last = peak
    return np.array(cuts, dtype=np.int64)
