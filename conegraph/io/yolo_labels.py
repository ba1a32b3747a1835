"""Label files as YOLO's tools write them: a line a box, in shares of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import read_text
from conegraph.types import Array, IntArray

MAX_LINES, MAX_BYTES = 5000, 1_000_000


def read_yolo_labels(
    path: Path, classes: Sequence[int], shape: tuple[int, ...]
) -> tuple[Array, IntArray]:
    """Return boxes (N, 4), left, top, right, bottom in px, and classes (N,).

    A line is ``class x y width height`` of the box's middle, in shares of the picture.
    The corner of the picture is (0, 0).

    Args:
        path: the file.
        classes: what its numbers 0, 1, … mean.
        shape: height and width of the picture.

    Raises:
        FileFormatError: it cannot be read, or a line is no class, middle and size.
    """
    lines = read_text(path, MAX_BYTES).splitlines()
    if len(lines) > MAX_LINES:
        raise FileFormatError(path, f"holds more than {MAX_LINES} boxes")
    boxes, kinds = [], []
    for number, line in enumerate(lines, 1):
        try:
            kind, *place = line.split()
            u, v, width, height = (float(word) for word in place)
            sane = np.isfinite([u, v, width, height]).all() and min(width, height) > 0
            if int(kind) < 0 or not sane:
                raise ValueError
            kinds.append(classes[int(kind)])
        except (ValueError, IndexError):
            reason = f"{line[:60]!r} is no class, middle and size"
            raise FileFormatError(path, reason, line=number) from None
        boxes.append([u - width / 2, v - height / 2, u + width / 2, v + height / 2])
    size = np.array([shape[1], shape[0], shape[1], shape[0]])
    return np.array(boxes).reshape(-1, 4) * size, np.array(kinds, dtype=np.int64)
