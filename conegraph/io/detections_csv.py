"""What detectors found in pictures, as a table: one row a cone."""

from __future__ import annotations

import csv
from pathlib import Path
from types import TracebackType
from typing import TextIO

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.types import CLASS_LABELS, Array, ConeObservations

COLUMNS = (
    "picture",
    *("left", "top", "right", "bottom", "score", "class"),
    *(f"p_{label}" for label in CLASS_LABELS),
    *("t", "x", "y", "cov_xx", "cov_xy", "cov_yy"),
)
"""Edges are in px, a pixel's centre being at whole numbers; t, x, y and the covariances
stay empty where the picture has no depth."""


class DetectionsCsv:
    """Writes detections, picture by picture."""

    def __init__(self, path: Path) -> None:
        """Open the file and write its header.

        Raises:
            FileFormatError: it cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: TextIO = path.open("w", encoding="utf-8", newline="")
        except OSError as error:
            reason = f"cannot be written: {error.strerror}"
            raise FileFormatError(path, reason) from error
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(COLUMNS)

    def __enter__(self) -> DetectionsCsv:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def add(
        self,
        picture: str,
        box_px: Array,
        class_prob: Array,
        score: Array,
        cones: ConeObservations | None = None,
    ) -> None:
        """Write the cones of one picture.

        Args:
            picture: its name.
            box_px: (N, 4) left, top, right, bottom edges.
            class_prob: (N, 5) probabilities in the order of `ConeClass`.
            score: (N,) how much each looks like a cone.
            cones: where they stand, for pictures with depth.
        """
        for row, box in enumerate(box_px):
            prob = class_prob[row]
            place: list[str] = [""] * 6
            if cones is not None:
                cov = cones.cov_m2[row]
                numbers = [cones.stamp_s, *cones.xy_m[row], *cov[np.triu_indices(2)]]
                place = [f"{number:.6g}" for number in numbers]
                place[0] = f"{cones.stamp_s:.9f}"
            self._rows.writerow(
                [
                    picture,
                    *(f"{edge:.2f}" for edge in box),
                    f"{score[row]:.3f}",
                    CLASS_LABELS[int(prob.argmax())],
                    *(f"{share:.4f}" for share in prob),
                    *place,
                ]
            )
