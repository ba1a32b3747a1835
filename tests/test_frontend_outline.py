"""Axis and foot of a cone in a box, to a fraction of a pixel."""

import cv2
import numpy as np
import pytest

from conegraph.frontend.base import Picture
from conegraph.frontend.outline import axis_columns, foot_levels
from conegraph.types import Array

SCALE = 8
YELLOW, GROUND = (230, 190, 40), (120, 118, 116)


def drawn(axis_px: float, low_px: float, height_px: float) -> tuple[Picture, Array]:
    """Return a yellow cone on grey, drawn large and made small, and its box."""
    half_foot, half_low, half_top = 0.35, 0.26, 0.07
    shape = [
        (-half_foot, 0.0),
        (-half_foot, 0.06),
        (-half_low, 0.06),
        (-half_top, 1.0),
        (half_top, 1.0),
        (half_low, 0.06),
        (half_foot, 0.06),
        (half_foot, 0.0),
    ]
    corners = np.array(
        [(axis_px + u * height_px, low_px - v * height_px) for u, v in shape]
    )
    large = np.full((100 * SCALE, 140 * SCALE, 3), GROUND, np.uint8)
    # A pixel's centre has a whole number.
    points = np.round((corners + 0.5) * SCALE).astype(np.int32)
    cv2.fillPoly(large, [points], YELLOW)
    picture = cv2.resize(large, (140, 100), interpolation=cv2.INTER_AREA)
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    return np.asarray(picture, dtype=np.uint8), box[None]


@pytest.mark.parametrize("height_px", [14.0, 30.0, 60.0])
@pytest.mark.parametrize("off_px", [0.0, 0.3, 0.7])
def test_axis_and_foot_are_found_in_a_box_that_is_off(
    height_px: float, off_px: float
) -> None:
    picture, box = drawn(70 + off_px, 80.2 + off_px, height_px)
    moved = box + height_px * np.array([0.03, -0.02, 0.03, -0.04])
    axis, found = axis_columns(picture, moved)
    assert found.all()
    assert axis[0] == pytest.approx(70 + off_px, abs=0.02 * height_px)
    low = foot_levels(picture, moved, axis)
    assert low[0] == pytest.approx(80.2 + off_px, abs=0.4)
    # Better than the box, which is off by this much.
    assert abs(axis[0] - 70 - off_px) < 0.5 * 0.03 * height_px


def test_a_grey_thing_keeps_its_box() -> None:
    picture = np.full((100, 140, 3), 117, np.uint8)
    picture[40:80, 60:80] = 30
    box = np.array([[59.0, 39.0, 82.0, 79.0]])
    axis, found = axis_columns(picture, box)
    assert not found.any()
    assert axis.tolist() == [70.5]
    assert foot_levels(picture, box, axis).tolist() == [79.0]


def test_no_boxes_at_all() -> None:
    picture = np.zeros((10, 10, 3), np.uint8)
    axis, found = axis_columns(picture, np.zeros((0, 4)))
    assert len(axis) == len(found) == 0
    assert len(foot_levels(picture, np.zeros((0, 4)), axis)) == 0
