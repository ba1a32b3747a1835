"""How well a detector finds the cones of labelled pictures, per class and size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.config import YoloConfig
from conegraph.frontend.yolo import YoloDetector
from conegraph.training.average_precision import Boxes, average_precision
from conegraph.training.collage import CLASSES
from conegraph.training.sample import Sample
from conegraph.types import Array

SIZES_PX = ((8.0, 16.0), (16.0, 32.0), (32.0, np.inf))
LEAST_PX = 8.0
LEAST_SCORE = 0.02
"""Weaker boxes no longer change an average precision."""


@dataclass(frozen=True, slots=True)
class Precisions:
    """AP50 of every class of `CLASSES`, of all sizes and of each of `SIZES_PX`."""

    by_class: tuple[float, ...]
    by_size: tuple[tuple[float, ...], ...]

    @property
    def mean(self) -> float:
        """MAP50: the mean over the classes that are there."""
        return mean_known(self.by_class)


def mean_known(shares: Sequence[float]) -> float:
    """Return the mean of the shares that are no nan, nan without any."""
    known = [share for share in shares if not np.isnan(share)]
    return float(np.mean(known)) if known else float("nan")


def precisions(
    config: YoloConfig, samples: Iterable[Sample], done: Callable[[int], None]
) -> Precisions:
    """Run a network over labelled pictures and return how well it finds their cones.

    Args:
        config: the network; its threshold gives way to `LEAST_SCORE`.
        samples: the pictures.
        done: is told how many were looked at.
    """
    detector = YoloDetector(config.model_copy(update={"min_score": LEAST_SCORE}))
    found, real = [], []
    for count, sample in enumerate(samples, 1):
        seen = detector.find(sample.picture)
        found.append(as_boxes(seen.box_px, seen.class_prob, seen.score))
        real.append(true_boxes(sample))
        done(count)
    return judged(found, real)


def judged(found: Sequence[Boxes], real: Sequence[Boxes]) -> Precisions:
    """Return how well what was found in each picture fits what is there."""
    kinds = range(len(CLASSES))
    return Precisions(
        tuple(average_precision(found, real, k, (LEAST_PX, np.inf)) for k in kinds),
        tuple(
            tuple(average_precision(found, real, k, size) for k in kinds)
            for size in SIZES_PX
        ),
    )


def as_boxes(box_px: Array, class_prob: Array, score: Array) -> Boxes:
    """Return what a detector found, whose pixels' middles have whole numbers.

    As YOLO's own tools do, every box stands under every class, with its score times
    the class's probability: of a cone that may be either, both are ranked. Under a
    class that it cannot be it stands not.
    """
    ranked = score[:, None] * class_prob[:, [int(c) for c in CLASSES]]
    kind, row = np.nonzero(ranked.T)
    return Boxes(box_px[row] + 0.5, kind, ranked[row, kind])


def true_boxes(sample: Sample) -> Boxes:
    """Return the boxes that a picture is labelled with."""
    return Boxes(sample.box_px, sample.kind, np.ones(len(sample.kind)))
