"""A picture of what was found in a picture."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.frontend.base import Picture
from conegraph.types import CLASS_LABELS, Array, ConeClass, IntArray

COLOURS = {
    ConeClass.BLUE: (61, 139, 255),
    ConeClass.YELLOW: (255, 214, 10),
    ConeClass.ORANGE: (255, 154, 46),
    ConeClass.BIG_ORANGE: (255, 90, 31),
    ConeClass.UNKNOWN: (176, 176, 176),
}
BLACK = (0, 0, 0)
SMALL_PX = 480
"""Pictures are taken to be looked at on a screen of which this is half the height."""


def draw_boxes(
    picture: Picture, box_px: Array, class_prob: Array, xy_m: Array | None = None
) -> Picture:
    """Return a copy of an RGB picture with boxes, classes and, where known, ranges.

    Args:
        picture: (H, W, 3) RGB.
        box_px: (N, 4) left, top, right, bottom edges.
        class_prob: (N, 5) in the order of `ConeClass`.
        xy_m: (N, 2) positions in the car frame.
    """
    drawn = picture.copy()
    classes: IntArray = class_prob.argmax(axis=1)
    thick = max(1, round(picture.shape[0] / SMALL_PX))
    corners = np.round(box_px).astype(int).tolist()
    for row, (left, top, right, bottom) in enumerate(corners):
        kind = ConeClass(int(classes[row]))
        said = CLASS_LABELS[kind].replace("_", " ")
        if xy_m is not None:
            said += f" {np.hypot(*xy_m[row]):.1f} m"
        cv2.rectangle(drawn, (left, top), (right, bottom), COLOURS[kind], thick)
        place = (left, max(top - 3 * thick, 10))
        for width, colour in ((3 * thick, BLACK), (thick, COLOURS[kind])):
            cv2.putText(
                drawn,
                said,
                place,
                cv2.FONT_HERSHEY_SIMPLEX,
                0.4 * thick,
                colour,
                width,
                cv2.LINE_AA,
            )
    return drawn


def as_png(picture: Picture) -> bytes:
    """Return an RGB picture (H, W, 3) as the bytes of a PNG file."""
    _, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return data.tobytes()
