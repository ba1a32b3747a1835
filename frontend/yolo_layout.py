"""YOLO's ways of taking pictures and of saying what is in them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.frontend.base import Picture
from conegraph.types import Array

Floats = NDArray[np.float32]
GREY = 114
"""What is left of the input beside the picture."""
SIZE_MULTIPLE = 32
MAX_CANDIDATES = 2000
ROUNDING = 1e-3
"""By how much scores may leave [0, 1]: engines round."""


@dataclass(frozen=True, slots=True)
class Input:
    """A picture as a network takes it.

    Attributes:
        blob: (1, 3, h, w) in [0, 1], RGB, the picture in the upper left corner.
        scale: (2,) width and height of an input pixel, in those of the picture.
    """

    blob: Floats
    scale: Array


def letterboxed(picture: Picture, max_side_px: int, input_px: tuple[int, int]) -> Input:
    """Return a picture (H, W, 3) as a network takes it.

    Args:
        picture: RGB.
        max_side_px: larger pictures are made smaller.
        input_px: width and height that the network takes; any multiple of
            `SIZE_MULTIPLE` where they are 0.
    """
    rows, columns = picture.shape[:2]
    fixed = min(input_px) > 0
    limit = input_px if fixed else (max_side_px, max_side_px)
    share = min(limit[0] / columns, limit[1] / rows)
    if not fixed:
        share = min(share, 1.0)
    size = (max(round(columns * share), 1), max(round(rows * share), 1))
    if size != (columns, rows):
        way = cv2.INTER_AREA if share < 1 else cv2.INTER_LINEAR
        picture = np.asarray(cv2.resize(picture, size, interpolation=way), np.uint8)
    width, height = (
        input_px
        if fixed
        else (-(-side // SIZE_MULTIPLE) * SIZE_MULTIPLE for side in size)
    )
    blob = np.full((1, 3, height, width), GREY / 255, dtype=np.float32)
    np.divide(picture.transpose(2, 0, 1), 255, out=blob[0, :, : size[1], : size[0]])
    return Input(blob, np.array([columns, rows]) / size)


def decoded(output: Floats, n_classes: int) -> tuple[Array, Array]:
    """Return boxes (N, 4), left, top, right, bottom in px, and class scores (N, C).

    Recognised by their shapes are YOLO v8, v9 and v11, (1, 4 + C, N), and YOLO v5 and
    v7, (1, N, 5 + C), whose classes are under the condition that there is anything at
    all. The former's transpose is refused: it looks like v5 with a class less.

    Raises:
        ValueError: the shape is of none of them, or scores are not within [0, 1].
    """
    shape = output.shape
    if len(shape) != 3 or shape[0] != 1:
        raise ValueError(f"its output {shape} is no list of boxes")
    rows = output[0].astype(np.float64)
    if shape[2] == 5 + n_classes:
        score = rows[:, 5:] * rows[:, 4:5]
    elif shape[1] == 4 + n_classes:
        rows = rows.T
        score = rows[:, 4:]
    else:
        raise ValueError(
            f"its output {shape} is neither (1, {4 + n_classes}, N) nor "
            f"(1, N, {5 + n_classes}): detector.classes names {n_classes} classes"
        )
    sane = np.isfinite(rows).all() and score.min(initial=0.0) >= -ROUNDING
    if not sane or score.max(initial=0.0) > 1.0 + ROUNDING:
        raise ValueError("its scores are not within 0 and 1, or it says no numbers")
    half = rows[:, 2:4] / 2
    box_px = np.hstack([rows[:, :2] - half, rows[:, :2] + half])
    return box_px, np.clip(score, 0.0, 1.0)


def strongest(
    box_px: Array, score: Array, min_score: float, overlap: float
) -> NDArray[np.int64]:
    """Return rows of the boxes (N, 4) that stay, by falling score (N,).

    Of two that overlap by more than ``overlap`` (intersection over union) the
    stronger stays, whatever their classes: a cone has one colour.
    """
    likely = np.flatnonzero(score >= min_score)
    order = likely[np.argsort(-score[likely], kind="stable")][:MAX_CANDIDATES]
    sized = np.hstack([box_px[order, :2], box_px[order, 2:] - box_px[order, :2]])
    kept = cv2.dnn.NMSBoxes(sized.tolist(), score[order].tolist(), min_score, overlap)
    return order[np.asarray(kept, dtype=np.int64).ravel()].astype(np.int64)
