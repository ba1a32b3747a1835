"""The colour detector on real photographs whose cones are boxed by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from conegraph.bench.figure import Figure
from conegraph.bench.frontend_score import match_boxes
from conegraph.config import HsvConfig
from conegraph.errors import FileFormatError
from conegraph.frontend.base import Picture
from conegraph.frontend.hsv import HsvDetector, colours_of_boxes
from conegraph.io.picture_file import PICTURE_SUFFIXES, read_color
from conegraph.io.yolo_labels import read_yolo_labels
from conegraph.types import Array, ConeClass, IntArray

CLASSES = (ConeClass.BLUE, ConeClass.YELLOW, ConeClass.ORANGE)
"""What the numbers in the label files mean."""
MIN_HEIGHT_PX = 25.0


@dataclass(frozen=True, slots=True)
class Photo:
    """A photograph with its boxes (N, 4), in px, and their classes (N,)."""

    picture: Picture
    box_px: Array
    cone_class: IntArray


def read_photos(folder: Path) -> Iterator[Photo]:
    """Yield the photographs of a folder that have a YOLO label file of their name.

    Raises:
        FileFormatError: none is there, or one cannot be read.
    """
    pictures = (p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES)
    paths = sorted(p for p in pictures if p.with_suffix(".txt").is_file())
    if not paths:
        raise FileFormatError(folder, "holds no picture with a label file beside it")
    for path in paths:
        picture = read_color(path)
        label = path.with_suffix(".txt")
        box, cone_class = read_yolo_labels(label, CLASSES, picture.shape)
        yield Photo(picture, box - 0.5, cone_class)


def photo_figures(folder: Path, config: HsvConfig) -> list[Figure]:
    """Return how well colours are told in given boxes, and how well cones are found."""
    detector = HsvDetector(config)
    right, hits, labelled, detections = [], 0, 0, 0
    for photo in read_photos(folder):
        tall = photo.box_px[:, 3] - photo.box_px[:, 1] >= MIN_HEIGHT_PX
        prob = colours_of_boxes(photo.picture, photo.box_px[tall], config)
        right.append(plain_class(prob) == photo.cone_class[tall])
        found = detector.find(photo.picture)
        hits += len(match_boxes(found.box_px, photo.box_px))
        labelled += len(photo.box_px)
        detections += len(found)
    told = np.concatenate(right)
    share = float(told.mean())
    name = f"photographs: class right in {len(told)} boxes ≥ {MIN_HEIGHT_PX:g} px high"
    precision, recall = hits / max(detections, 1), hits / max(labelled, 1)
    return [
        Figure(name, "≥ 0.9", f"{share:.3f}", share >= 0.9, {"value": share}),
        Figure(
            "photographs: detector's precision, recall",
            "",
            f"{precision:.3f}, {recall:.3f}",
            None,
            {"precision": precision, "recall": recall},
        ),
    ]


def plain_class(prob: Array) -> IntArray:
    """Return the most probable classes (N,), big orange taken for orange."""
    best: IntArray = prob.argmax(axis=1).astype(np.int64)
    return np.where(best == ConeClass.BIG_ORANGE, int(ConeClass.ORANGE), best)
