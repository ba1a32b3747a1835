"""Average precision: how well boxes are found, whatever the threshold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.training.sample import IGNORED
from conegraph.types import Array, IntArray, Mask

MIN_OVERLAP = 0.5
"""Intersection over union from which a box is found: AP50."""


@dataclass(frozen=True, slots=True)
class Boxes:
    """Boxes of one picture.

    Attributes:
        box_px: (N, 4) left, top, right, bottom.
        kind: (N,) numbers of their classes, or `IGNORED`.
        score: (N,) how sure each is; ones where they are true.
    """

    box_px: Array
    kind: IntArray
    score: Array


def average_precision(
    found: Sequence[Boxes],
    real: Sequence[Boxes],
    kind: int,
    height_px: tuple[float, float] = (0.0, np.inf),
) -> float:
    """Return the area under precision over recall of a class, nan without any box.

    Precision is made to fall with recall, as in the PASCAL challenge since 2010.
    Boxes that are ignored, or of another height than asked for, are neither asked for
    nor wrong.

    Args:
        found: what was found in each picture.
        real: what is there.
        kind: the class.
        height_px: least and greatest height.
    """
    scores, rights, asked = [], [], 0
    for seen, true in zip(found, real, strict=True):
        wanted = (true.kind == kind) & _within(true.box_px, height_px)
        asked += int(wanted.sum())
        mine = np.flatnonzero(seen.kind == kind)
        mine = mine[np.argsort(-seen.score[mine], kind="stable")]
        verdict = _judged(seen.box_px[mine], true, kind, wanted, height_px)
        scores.append(seen.score[mine][verdict >= 0])
        rights.append(verdict[verdict >= 0])
    if not asked:
        return float("nan")
    order = np.argsort(-np.concatenate(scores), kind="stable")
    right = np.concatenate(rights)[order].cumsum()
    precision = right / np.arange(1, len(right) + 1)
    falling = np.maximum.accumulate(precision[::-1])[::-1]
    steps = np.diff(right, prepend=0)
    return float((falling * steps).sum() / asked)


def _judged(
    box_px: Array,
    true: Boxes,
    kind: int,
    wanted: Mask,
    height_px: tuple[float, float],
) -> IntArray:
    """Return for boxes, strongest first, 1 right, 0 wrong, -1 not counted."""
    verdict = np.where(_within(box_px, height_px), 0, -1)
    open_ = (true.kind == kind) | (true.kind == IGNORED)
    overlap = overlaps(box_px, true.box_px)
    for row, shares in enumerate(overlap):
        # Of a wanted cone and one that is not, the wanted one is meant.
        likely = np.where(open_ & (shares >= MIN_OVERLAP), shares + wanted, 0.0)
        if not likely.any():
            continue
        best = int(likely.argmax())
        verdict[row] = 1 if wanted[best] else -1
        open_[best] = true.kind[best] == IGNORED
    return verdict.astype(np.int64)


def overlaps(box_px: Array, other_px: Array) -> Array:
    """Return intersections over unions (N, M) of boxes (N, 4) and (M, 4)."""
    low = np.maximum(box_px[:, None, :2], other_px[None, :, :2])
    high = np.minimum(box_px[:, None, 2:], other_px[None, :, 2:])
    common = np.clip(high - low, 0.0, None).prod(axis=2)
    area = [np.prod(box[:, 2:] - box[:, :2], axis=1) for box in (box_px, other_px)]
    union = area[0][:, None] + area[1][None, :] - common
    share: Array = common / np.maximum(union, 1e-9)
    return share


def _within(box_px: Array, height_px: tuple[float, float]) -> Mask:
    height = box_px[:, 3] - box_px[:, 1]
    return np.asarray((height >= height_px[0]) & (height < height_px[1]))
