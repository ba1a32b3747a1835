"""Which pixels have a cone's colour."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.config import HsvConfig
from conegraph.frontend.base import Picture
from conegraph.types import ConeClass, Mask

COLOURS = (ConeClass.BLUE, ConeClass.YELLOW, ConeClass.ORANGE)
NONE = 0
"""What a pixel is that has none of the `COLOURS`; others are 1 + their index."""
Table = NDArray[np.uint8]


def in_hue_range(hue: NDArray[np.integer], first: int, last: int) -> Mask:
    """Say which hues lie between two; a range whose first is above its last wraps."""
    if first <= last:
        return np.asarray((hue >= first) & (hue <= last))
    return np.asarray((hue >= first) | (hue <= last))


@lru_cache(maxsize=8)
def _tables(config: HsvConfig) -> tuple[Table, Table, Table]:
    level = np.arange(256)
    hue = np.full(256, NONE)
    ranges = (config.blue_hue, config.yellow_hue, config.orange_hue)
    for index, ends in enumerate(ranges):
        hue[in_hue_range(level, *ends)] = 1 + index
    # Values above are not hues: OpenCV's go up to 179.
    hue[180:] = NONE
    saturation = np.where(level >= config.min_saturation, 255, 0)
    value = np.where(level >= config.min_value, 255, 0)
    return hue.astype(np.uint8), saturation.astype(np.uint8), value.astype(np.uint8)


def colour_of_pixels(hsv: Picture, config: HsvConfig) -> NDArray[np.uint8]:
    """Return (H, W) `NONE`, or 1 + the index in `COLOURS`, of a picture in HSV.

    Every channel goes through a table of its own and what all three let pass is
    kept, which sorts a picture into all colours in one pass.
    """
    hue, saturation, value = (
        cv2.LUT(channel, table)
        for channel, table in zip(cv2.split(hsv), _tables(config), strict=True)
    )
    passed = cv2.bitwise_and(saturation, value)
    return np.asarray(cv2.bitwise_and(hue, passed), dtype=np.uint8)
