"""The user's own labelled pictures, as YOLO's tools keep them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from zlib import crc32

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.config import YoloConfig
from conegraph.errors import FileFormatError
from conegraph.io.csv_table import read_text
from conegraph.io.picture_file import PICTURE_SUFFIXES, read_color
from conegraph.io.yolo_labels import read_yolo_labels
from conegraph.training.collage import CLASSES
from conegraph.training.sample import Sample

NAMES = "classes.txt"


HELD_OUT_OF = 10
"""One of so many pictures is not learned, but tested with."""


def held_out(name: str) -> bool:
    """Whether a picture is one to test with; its name alone tells, on every machine."""
    return crc32(name.encode()) % HELD_OUT_OF == 0


def split(pictures: Mapping[str, Sample]) -> tuple[list[Sample], list[Sample]]:
    """Return the pictures to learn from, and those to test with.

    With so few that one of the two would be empty, all are learned from.
    """
    test = [sample for name, sample in pictures.items() if held_out(name)]
    learn = [sample for name, sample in pictures.items() if not held_out(name)]
    return (learn, test) if learn else (test, [])


def read_folder(folder: Path) -> dict[str, Sample]:
    """Return the pictures of a folder, by name, that have a label file of their name.

    A label is a line ``class x y width height``, of the box's middle and in shares of
    the picture. Where the folder holds a ``classes.txt``, its lines name the classes;
    without it they are blue, yellow, orange, big_orange. Pictures lie in the folder
    or in ``images``, labels beside them or in ``labels``. Large pictures are made
    smaller, as they are before they are looked at: each takes 5 MB at the most.

    Raises:
        FileFormatError: there are none, or one cannot be read.
    """
    number = _numbers(folder)
    pictures, labels = folder / "images", folder / "labels"
    places = (pictures if pictures.is_dir() else folder).iterdir()
    found = {}
    for path in sorted(p for p in places if p.suffix.lower() in PICTURE_SUFFIXES):
        beside = (labels if labels.is_dir() else path.parent) / f"{path.stem}.txt"
        if beside.is_file():
            picture = _shrunk(read_color(path))
            box, kind = read_yolo_labels(beside, number, picture.shape)
            found[path.name] = Sample(picture, box, kind)
    if not found:
        raise FileFormatError(folder, "holds no picture with a label file of its name")
    return found


def _shrunk(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the picture, no larger than the detector takes pictures by default."""
    rows, columns = picture.shape[:2]
    share = YoloConfig().max_side_px / max(rows, columns)
    if share >= 1.0:
        return picture
    size = (max(round(columns * share), 1), max(round(rows * share), 1))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _numbers(folder: Path) -> list[int]:
    """Return for each class of the folder its number among `CLASSES`."""
    names = [c.label for c in CLASSES]
    path = folder / NAMES
    if not path.is_file():
        return list(range(len(names)))
    given = read_text(path).split()
    wrong = [name for name in given if name not in names]
    if wrong:
        raise FileFormatError(path, f"{wrong[0]!r} is none of {', '.join(names)}")
    return [names.index(name) for name in given]
