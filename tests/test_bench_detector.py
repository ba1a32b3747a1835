"""The learned detector's benchmark: what its figures are of a known detector."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from conegraph.bench.detector import precision_figures
from conegraph.bench.detector_photos import photo_figures
from conegraph.bench.figure import Figure
from conegraph.config import Config, YoloConfig
from conegraph.config.detector import ConeLabel
from conegraph.frontend.base import Candidates, Picture
from conegraph.frontend.scale import GroundScale
from conegraph.frontend.yolo import body_pixels, touching
from conegraph.sim.render import draw_light, make_scene, render_frame
from conegraph.types import Array, TruthMap

# Heights of 40, 20, 12 px: the last is too low to be asked for.
BOXES = np.array([[10.0, 10, 30, 50], [50, 10, 62, 30], [80, 10, 88, 22]])


class Fixed:
    """Finds the same boxes in every picture."""

    def __init__(self, box_px: Array, classes: list[int]) -> None:
        self._box_px, self._class = box_px - 0.5, classes

    def find(self, picture: Picture, scale: GroundScale | None = None) -> Candidates:
        """Return the boxes, whatever the picture."""
        sure = np.zeros(len(self._box_px), dtype=bool)
        uv, owner = body_pixels(self._box_px, sure, picture.shape)
        return Candidates(
            self._box_px,
            np.eye(5)[self._class],
            np.ones(len(self._class)),
            uv,
            owner,
            self._box_px[:, :2],
            touching(self._box_px, sure),
        )


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((100, 200, 3), np.uint8))
    lines = []
    for kind, (left, top, right, low) in enumerate(BOXES):
        place = (left + right) / 400, (top + low) / 200
        size = (right - left) / 200, (low - top) / 100
        lines.append(f"{kind} " + " ".join(f"{x:.6f}" for x in (*place, *size)))
    (tmp_path / "a.txt").write_text("\n".join(lines))
    return tmp_path


def values(figures: list[Figure]) -> list[float]:
    return [value for figure in figures for value in figure.values.values()]


def test_who_finds_all_is_right(photos: Path) -> None:
    figures = photo_figures(photos, Fixed(BOXES, [0, 1, 3]))
    assert values(figures) == [1, 1, 1, 1, 1]
    assert all(figure.met for figure in figures)


def test_low_cones_count_neither_way(photos: Path) -> None:
    assert values(photo_figures(photos, Fixed(BOXES[:2], [0, 1]))) == [1] * 5
    low = np.array([[120.0, 10, 130, 20]])
    found = Fixed(np.vstack([BOXES, low]), [0, 1, 2, 2])
    assert values(photo_figures(photos, found)) == [1] * 5


def test_misses_false_boxes_and_wrong_colours_count(photos: Path) -> None:
    false = np.array([[120.0, 10, 140, 50], [150, 10, 170, 50]])
    found = Fixed(np.vstack([BOXES[:1], false]), [1, 0, 0])
    assert values(photo_figures(photos, found)) == [1 / 3, 0.5, 1 / 3, 0.5, 0.0]


def test_a_loose_box_counts_only_for_the_lenient_figure(photos: Path) -> None:
    loose = BOXES[:2] + np.array([[0, 0, 0, 0], [0, 0, 0, 20]])
    # The second is twice as high: its overlap is a half, less for the pixel's edge.
    loose[1, 3] += 1
    found = Fixed(loose, [0, 1])
    assert values(photo_figures(photos, found))[2:4] == [0.5, 0.5]


def test_the_network_alone_is_asked_for_the_classes_that_are_configured() -> None:
    rng = np.random.default_rng(11)
    cones = TruthMap(
        np.arange(2), np.array([[4.0, 1.2], [5.0, -1.4]]), np.array([0, 1])
    )
    scene = make_scene(cones, rng, light=draw_light(rng, "overcast"))
    shots = [render_frame(scene, np.zeros(3), rng)]
    swapped: tuple[ConeLabel, ...] = ("yellow", "blue", "orange", "big_orange")
    for names, expected in ((YoloConfig().classes, 1.0), (swapped, 0.0)):
        learned = YoloConfig(classes=names)
        config = Config(detector=learned)
        figures = precision_figures(shots, config, learned, lambda count: None)
        for figure in (figures[1], figures[3]):
            assert figure.values["blue"] == pytest.approx(expected, abs=0.5)
            assert figure.values["yellow"] == pytest.approx(expected, abs=0.5)
