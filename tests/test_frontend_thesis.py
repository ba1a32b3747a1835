"""Chapter 3's steps on pictures of which every number is known."""

import numpy as np
import pytest

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.config import ColourRange, HsvThesisConfig
from conegraph.frontend.thesis import ThesisFrontEnd
from conegraph.types import ConeClass

LENS = Camera(320, 240, 300.0, 300.0, 160.0, 120.0)
MOUNT = CameraMount(x_m=0.5, height_m=1.0)
BLUE, YELLOW, PINK = (20, 60, 200), (240, 200, 20), (230, 40, 230)


def frame_with(
    *blocks: tuple[int, int, int, tuple[int, int, int]], depth_m: float = 4.0
) -> RgbdFrame:
    """Return a grey picture with squares (left, top, side, colour) at one depth."""
    color = np.full((240, 320, 3), 110, dtype=np.uint8)
    for left, top, side, colour in blocks:
        color[top : top + side, left : left + side] = colour
    depth = np.full((240, 320), depth_m, dtype=np.float32)
    return RgbdFrame(2.0, color, depth, LENS, MOUNT)


def test_the_centroid_is_projected_back() -> None:
    seen = ThesisFrontEnd(HsvThesisConfig()).examine(frame_with((200, 140, 21, BLUE)))
    cones = seen.observations
    # Pixel (210, 150) at 4 m: 4 * 50 / 300 to the right, 4 m ahead of the camera.
    assert cones.xy_m == pytest.approx(np.array([[4.5, -4 * 50 / 300]]), abs=1e-6)
    assert cones.class_prob.argmax(axis=1).tolist() == [ConeClass.BLUE]
    assert seen.box_px == pytest.approx(np.array([[199.5, 139.5, 220.5, 160.5]]), abs=1)
    assert seen.height_m == pytest.approx([1.0 - 4 * 30 / 300])
    assert (np.linalg.eigvalsh(cones.cov_m2) > 0).all()


@pytest.mark.parametrize(
    ("block", "depth_m"),
    [
        ((200, 140, 4, BLUE), 4.0),
        ((200, 140, 21, BLUE), 13.0),
        ((200, 140, 21, BLUE), 0.0),
        ((200, 20, 21, BLUE), 4.0),
        ((200, 140, 21, PINK), 4.0),
    ],
    ids=["too small", "too far", "no depth", "above the region", "another colour"],
)
def test_what_fails_a_test_is_left_out(
    block: tuple[int, int, int, tuple[int, int, int]], depth_m: float
) -> None:
    frame = frame_with(block, depth_m=depth_m)
    assert len(ThesisFrontEnd(HsvThesisConfig()).detect(frame)) == 0


def test_colours_come_from_the_table() -> None:
    pink = ColourRange(cone="unknown", low=(140, 120, 100), high=(165, 255, 255))
    front_end = ThesisFrontEnd(HsvThesisConfig(colours=(pink,)))
    cones = front_end.detect(frame_with((200, 140, 21, PINK), (100, 140, 21, YELLOW)))
    assert cones.class_prob.argmax(axis=1).tolist() == [ConeClass.UNKNOWN]


def test_a_stripe_parts_a_cone_as_it_does_in_the_thesis() -> None:
    front_end = ThesisFrontEnd(HsvThesisConfig())
    parted = frame_with((200, 140, 15, YELLOW), (200, 162, 15, YELLOW))
    assert len(front_end.detect(parted)) == 2
    assert len(front_end.find(parted.color)) == 2


def test_its_sensor_is_as_wide_as_the_lens_and_as_far_as_the_limits() -> None:
    sensor = ThesisFrontEnd(HsvThesisConfig(max_range_m=9.0)).sensor(LENS, MOUNT)
    assert sensor.max_range_m == 9.0
    assert sensor.half_fov_rad == pytest.approx(np.arctan(159 / 300))
