"""Boxes are drawn around what they mean, in pictures large enough for their labels."""

import numpy as np
import pytest

from conegraph.frontend.drawing import MOST, TALL_PX, draw_boxes


@pytest.mark.parametrize(
    ("height", "factor"), [(2, MOST), (240, 4), (480, 2), (961, 1)]
)
def test_a_box_is_where_its_pixels_are_when_enlarged(height: int, factor: int) -> None:
    picture = np.zeros((height, 30, 3), np.uint8)
    box = np.array([[9.5, -0.5, 19.5, height - 0.5]])
    drawn = draw_boxes(picture, box, np.eye(5)[:1])
    assert drawn.shape == (factor * height, factor * 30, 3)
    middle = drawn[factor * height - 1].any(axis=1).nonzero()[0]
    assert abs(int(middle.min()) - factor * 10) <= 1
    assert abs(int(middle.max()) - factor * 20) <= 1


def test_nothing_is_drawn_or_enlarged_without_cones() -> None:
    picture = np.full((TALL_PX // 4, 30, 3), 7, np.uint8)
    drawn = draw_boxes(picture, np.zeros((0, 4)), np.zeros((0, 5)))
    assert np.array_equal(drawn, picture)
    assert drawn is not picture
