"""A picture with its cones, and pieces of it as other cameras would show them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array, IntArray

IGNORED = -1
"""Class of a cone that is neither asked for nor wrong."""
LEAST_HEIGHT_PX = 5.0
"""Lower cones are not asked for: too little of them is left."""
LEAST_INSIDE = 0.35


@dataclass(frozen=True, slots=True)
class Sample:
    """A picture and its boxes.

    Attributes:
        picture: (H, W, 3) uint8 RGB.
        box_px: (N, 4) left, top, right, bottom; the corner of the picture is (0, 0).
        kind: (N,) number of the class, or `IGNORED`.
    """

    picture: NDArray[np.uint8]
    box_px: Array
    kind: IntArray


def crop(sample: Sample, side_px: int, rng: np.random.Generator) -> Sample:
    """Return a square piece at a random place and scale, perhaps mirrored.

    Three of five pieces are around a cone, so that few are empty.
    """
    rows, columns = sample.picture.shape[:2]
    zoom = float(np.exp(rng.uniform(np.log(0.55), np.log(1.8))))
    stretch = float(np.exp(rng.normal(0.0, 0.05)))
    span = np.array([side_px / zoom * stretch, side_px / zoom / stretch])
    free = np.array([columns, rows]) - span
    corner = rng.uniform(np.minimum(free, 0), np.maximum(free, 0))
    if len(sample.box_px) and rng.random() < 0.6:
        box = sample.box_px[int(rng.integers(len(sample.box_px)))]
        around = 0.5 * (box[:2] + box[2:]) - rng.uniform(0.15, 0.85, 2) * span
        corner = np.clip(around, np.minimum(free, 0), np.maximum(free, 0))
    scale = side_px / span
    shrink = cv2.INTER_AREA if scale.min() < 0.8 else cv2.INTER_LINEAR
    low = np.maximum(np.floor(corner), 0).astype(int)
    high = np.minimum(np.ceil(corner + span), (columns, rows)).astype(int)
    piece = sample.picture[low[1] : high[1], low[0] : high[0]]
    size = np.round((high - low) * scale).astype(int)
    piece = np.asarray(cv2.resize(piece, size.tolist(), interpolation=shrink))
    picture = np.empty((side_px, side_px, 3), np.uint8)
    picture[:] = rng.integers(0, 256, 3)
    shift = np.maximum(np.round((low - corner) * scale), 0).astype(int)
    fit = np.minimum(size, side_px - shift)
    picture[shift[1] : shift[1] + fit[1], shift[0] : shift[0] + fit[0]] = piece[
        : fit[1], : fit[0]
    ]
    real = size / (high - low)
    box = (sample.box_px - np.tile(low, 2)) * np.tile(real, 2) + np.tile(shift, 2)
    box, kind = clipped(box, sample.kind, side_px, side_px)
    if rng.random() < 0.5:
        picture = np.ascontiguousarray(picture[:, ::-1])
        box = np.column_stack(
            [side_px - box[:, 2], box[:, 1], side_px - box[:, 0], box[:, 3]]
        )
    return Sample(picture, box, kind)


def clipped(
    box_px: Array, kind: IntArray, width_px: int, height_px: int
) -> tuple[Array, IntArray]:
    """Return boxes cut at a picture's edges; what is left of too little is ignored."""
    edges = np.array([width_px, height_px, width_px, height_px])
    cut = np.clip(box_px, 0, edges)
    area = np.prod(cut[:, 2:] - cut[:, :2], axis=1)
    share = area / np.maximum(np.prod(box_px[:, 2:] - box_px[:, :2], axis=1), 1e-9)
    low = cut[:, 3] - cut[:, 1] < LEAST_HEIGHT_PX
    kind = np.where(low | (share < LEAST_INSIDE), IGNORED, kind)
    inside = area > 1.0
    return cut[inside], kind[inside]
