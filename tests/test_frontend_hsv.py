"""Colours are told apart, shapes of cones are found, everything else is not."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conegraph.bench.frontend_photos import MIN_HEIGHT_PX, read_photos
from conegraph.config import HsvConfig
from conegraph.frontend.colours import colour_of_pixels, in_hue_range
from conegraph.frontend.hsv import HsvDetector, colours_of_boxes
from conegraph.frontend.shape import cone_likeness, is_top_heavy
from conegraph.types import ConeClass

ASPHALT = (105, 105, 108)
BODIES = {
    ConeClass.BLUE: (26, 92, 188),
    ConeClass.YELLOW: (246, 202, 26),
    ConeClass.ORANGE: (236, 72, 36),
}
STRIPES = {
    ConeClass.BLUE: (235, 235, 230),
    ConeClass.YELLOW: (28, 28, 30),
    ConeClass.ORANGE: (235, 235, 230),
}
Rgb = tuple[int, int, int]


def road() -> NDArray[np.uint8]:
    return np.full((240, 320, 3), ASPHALT, dtype=np.uint8)


def draw_cone(
    picture: NDArray[np.uint8], kind: ConeClass, left: int, top: int, shade: float = 1.0
) -> list[float]:
    """Draw a cone of 24 x 36 px with a stripe and return its box."""
    shapes: list[tuple[Rgb, list[tuple[int, int]]]] = [
        (BODIES[kind], [(10, 0), (13, 0), (19, 32), (4, 32)]),
        (STRIPES[kind], [(8, 12), (15, 12), (17, 20), (6, 20)]),
        (BODIES[kind], [(0, 32), (23, 32), (23, 35), (0, 35)]),
    ]
    for colour, corners in shapes:
        points = np.array(corners) + np.array([left, top])
        cv2.fillPoly(picture, [points], [shade * c for c in colour])
    return [left - 0.5, top - 0.5, left + 23.5, top + 35.5]


@pytest.mark.parametrize("shade", [1.0, 0.6, 0.35])
@pytest.mark.parametrize("kind", list(BODIES))
def test_a_cone_is_found_with_its_colour_in_any_light(
    kind: ConeClass, shade: float
) -> None:
    picture = np.round(shade * road()).astype(np.uint8)
    box = draw_cone(picture, kind, 100, 80, shade)
    found = HsvDetector(HsvConfig()).find(picture)
    assert found.box_px == pytest.approx(np.array([box]), abs=1.0)
    prob = found.class_prob[0]
    assert prob.sum() == pytest.approx(1.0)
    if kind == ConeClass.ORANGE:
        assert prob[ConeClass.ORANGE] + prob[ConeClass.BIG_ORANGE] > 0.9
    else:
        assert prob[kind] > 0.9
    assert abs(found.axis_uv[0, 0] - 111.5) < 1.0
    assert set(found.owner.tolist()) == {0}
    assert 300 < len(found.pixel_uv) < 24 * 36


def test_neighbours_of_one_colour_are_told_apart() -> None:
    picture = road()
    boxes = [draw_cone(picture, ConeClass.BLUE, left, 80) for left in (100, 120)]
    found = HsvDetector(HsvConfig()).find(picture)
    assert len(found) == 2
    middles = np.sort(found.axis_uv[:, 0])
    assert middles == pytest.approx([np.mean(b[::2]) for b in boxes], abs=2.0)


@pytest.mark.parametrize("what", ["nothing", "bar", "flat", "disc", "meadow", "noise"])
def test_what_is_no_cone_is_not_found(what: str) -> None:
    picture = road()
    if what == "bar":
        cv2.rectangle(picture, (100, 60), (120, 120), BODIES[ConeClass.ORANGE], -1)
    elif what == "flat":
        cv2.rectangle(picture, (100, 100), (160, 108), BODIES[ConeClass.BLUE], -1)
    elif what == "disc":
        cv2.circle(picture, (120, 100), 20, BODIES[ConeClass.ORANGE], -1)
    elif what == "meadow":
        rng = np.random.default_rng(2)
        grain = rng.integers(-12, 13, picture.shape)
        picture = (np.array([118, 122, 60]) + grain).astype(np.uint8)
    elif what == "noise":
        picture = np.random.default_rng(3).integers(90, 120, picture.shape, np.uint8)
    assert len(HsvDetector(HsvConfig()).find(picture)) == 0


def test_red_hues_wrap_around() -> None:
    hues = np.arange(180)
    inside = hues[in_hue_range(hues, 168, 14)]
    assert inside.tolist() == [*range(15), *range(168, 180)]
    hsv = np.array([[[170, 200, 200], [5, 200, 200], [60, 200, 200]]], dtype=np.uint8)
    assert colour_of_pixels(hsv, HsvConfig()).tolist() == [[3, 3, 0]]


def test_colours_of_given_boxes() -> None:
    picture = road()
    kinds = list(BODIES)
    boxes = np.array(
        [draw_cone(picture, k, 40 + 60 * i, 80) for i, k in enumerate(kinds)]
    )
    nothing = np.array([[10.0, 10.0, 30.0, 40.0]])
    prob = colours_of_boxes(picture, np.vstack([boxes, nothing]), HsvConfig())
    assert prob.sum(axis=1) == pytest.approx(np.ones(4))
    assert prob[:2].argmax(axis=1).tolist() == kinds[:2]
    assert prob[2, [ConeClass.ORANGE, ConeClass.BIG_ORANGE]].sum() > 0.9
    assert prob[3, ConeClass.UNKNOWN] == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(1, 1, 3), (3, 5, 3), (480, 2, 3)])
def test_pictures_of_any_size_are_looked_at(shape: tuple[int, int, int]) -> None:
    vivid = np.full(shape, BODIES[ConeClass.BLUE], dtype=np.uint8)
    assert len(HsvDetector(HsvConfig()).find(vivid)) == 0


def test_classes_of_real_cones(data_dir: Path) -> None:
    right, count = 0, 0
    for photo in read_photos(data_dir / "photos_feb_3cones"):
        tall = photo.box_px[:, 3] - photo.box_px[:, 1] >= MIN_HEIGHT_PX
        prob = colours_of_boxes(photo.picture, photo.box_px[tall], HsvConfig())
        best = prob.argmax(axis=1)
        best = np.where(best == ConeClass.BIG_ORANGE, int(ConeClass.ORANGE), best)
        right += int((best == photo.cone_class[tall]).sum())
        count += int(tall.sum())
    assert count > 300
    assert right / count >= 0.95


def test_a_foot_that_sticks_to_a_top_is_noticed() -> None:
    triangle = [(u, v) for v in range(18) for u in range(10 - v // 2, 11 + v // 2)]
    foot = [(u, v) for v in range(3) for u in range(2, 19)]
    owner = np.repeat([0, 1], [len(triangle), len(triangle) + len(foot)])
    pixels = np.array([*triangle, *triangle, *foot])
    box = np.array([[1.5, -0.5, 18.5, 17.5], [1.5, -0.5, 18.5, 17.5]])
    assert is_top_heavy(box, pixels, owner).tolist() == [False, True]
    likeness = cone_likeness(box, pixels, owner)
    assert likeness[0] > 0.5
    assert likeness[1] > 0.0
