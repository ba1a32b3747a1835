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
TALL_PX = 960
"""Pictures are drawn at least this high: labels on small ones would hide cones."""
MOST = 4


def draw_boxes(
    picture: Picture, box_px: Array, class_prob: Array, xy_m: Array | None = None
) -> Picture:
    """Return an RGB picture with boxes, classes and, where known, ranges.

    One with cones that is less than `TALL_PX` high is enlarged, up to `MOST` times.

    Args:
        picture: (H, W, 3) RGB.
        box_px: (N, 4) left, top, right, bottom edges.
        class_prob: (N, 5) in the order of `ConeClass`.
        xy_m: (N, 2) positions in the car frame.
    """
    classes: IntArray = class_prob.argmax(axis=1)
    larger = min(-(-TALL_PX // picture.shape[0]), MOST) if len(box_px) else 1
    drawn = picture.repeat(larger, axis=0).repeat(larger, axis=1)
    thick = max(1, round(drawn.shape[0] / TALL_PX))
    # A pixel's edge is half a pixel before its middle, at any size.
    corners = np.round(larger * (box_px + 0.5) - 0.5).astype(int).tolist()
    for row, (left, top, right, bottom) in enumerate(corners):
        kind = ConeClass(int(classes[row]))
        said = CLASS_LABELS[kind].replace("_", " ")
        if xy_m is not None:
            said += f" {np.hypot(*xy_m[row]):.1f} m"
        cv2.rectangle(drawn, (left, top), (right, bottom), COLOURS[kind], thick)
        place = (left, max(top - 3 * thick, 10))
        _write(drawn, said, place, COLOURS[kind], thick)
    return drawn


def _write(
    drawn: Picture,
    said: str,
    place: tuple[int, int],
    colour: tuple[int, int, int],
    thick: int,
) -> None:
    """Write in a colour with a black edge; thicker letters would also be wider."""
    edge = [(right, down) for right in (-1, 0, 1) for down in (-1, 0, 1)]
    face, size = cv2.FONT_HERSHEY_SIMPLEX, 0.4 * thick
    for right, down in edge:
        at = (place[0] + right * thick, place[1] + down * thick)
        cv2.putText(drawn, said, at, face, size, BLACK, thick, cv2.LINE_AA)
    cv2.putText(drawn, said, place, face, size, colour, thick, cv2.LINE_AA)


def as_png(picture: Picture) -> bytes:
    """Return an RGB picture (H, W, 3) as the bytes of a PNG file."""
    _, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return data.tobytes()
