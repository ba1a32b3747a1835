"""Places and covariances of cones whose depth, foot and size are known exactly."""

from dataclasses import replace

import numpy as np
import pytest

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.config import LocalizationConfig
from conegraph.frontend.base import Candidates
from conegraph.frontend.camera import plane_of_mount, project
from conegraph.frontend.ground import GroundPlane
from conegraph.frontend.localize import BODY_DEPTH_M, FOOT_EDGE_SHARE, Places, localize
from conegraph.frontend.scale import FOOT_M, GroundScale
from conegraph.frontend.sizes import fits, measure_sizes, with_size
from conegraph.types import Array, ConeClass

LENS = Camera(640, 480, 465.0, 465.0, 319.5, 239.5)
MOUNT = CameraMount(x_m=0.4, height_m=0.9, pitch_rad=0.14)
EXACT = GroundPlane(plane_of_mount(MOUNT), np.zeros((3, 3)), 0.004, True)
BLUE = (26, 92, 188)
NO_DEPTH = 0.0


def pixel_of(x_m: float, y_m: float, z_m: float) -> Array:
    point = np.array([[x_m, y_m, z_m]]) - MOUNT.position_m
    at: Array = project(LENS, point @ MOUNT.rotation_car_optical)[0]
    return at


def cone_at(
    x_m: float, y_m: float, *, body_range_m: float | None, height_m: float = 0.325
) -> tuple[RgbdFrame, Candidates]:
    """Paint a blue block with a cone's outline, its middle at a place on the ground.

    Its depth is that of an upright surface at a range, or missing.
    """
    away = np.hypot(x_m - MOUNT.x_m, y_m)
    near = 1.0 - FOOT_EDGE_SHARE * FOOT_M / away
    foot = pixel_of(MOUNT.x_m + near * (x_m - MOUNT.x_m), near * y_m, 0.0)
    top = pixel_of(x_m, y_m, height_m)
    half = 0.5 * 0.275 / away * LENS.fx_px
    middle = pixel_of(x_m, y_m, 0.12)[0]
    left, right = round(middle - half), round(middle + half)
    first, last = round(top[1] + 0.5), min(round(foot[1] - 0.5), 479)
    color = np.full((480, 640, 3), 105, dtype=np.uint8)
    color[first : last + 1, left : right + 1] = BLUE
    depth_m = np.zeros((480, 640), dtype=np.float32)
    v, u = np.mgrid[first : last + 1, left : right + 1]
    if body_range_m is not None:
        ray = np.column_stack([(u.ravel() - 319.5) / 465, (v.ravel() - 239.5) / 465])
        ray = np.column_stack([ray, np.ones(len(ray))])
        flat = np.linalg.norm(ray @ MOUNT.rotation_car_optical[:2].T, axis=1)
        depth_m[v.ravel(), u.ravel()] = body_range_m / flat
    pixels = np.column_stack([u.ravel(), v.ravel()])
    box = np.array([[left - 0.5, first - 0.5, right + 0.5, last + 0.5]])
    prob = np.eye(5)[[ConeClass.BLUE]]
    axis = np.array([[middle, top[1] + 0.5 * (foot[1] - top[1])]])
    found = Candidates(
        box,
        prob,
        np.ones(1),
        pixels,
        np.zeros(len(pixels), dtype=int),
        axis,
        np.zeros(1, dtype=bool),
    )
    return RgbdFrame(0.0, color, depth_m, LENS, MOUNT), found


def place(frame: RgbdFrame, found: Candidates) -> Places:
    return localize(frame, found, EXACT, LocalizationConfig())


@pytest.mark.parametrize(("x_m", "y_m"), [(4.0, 0.0), (7.0, 2.0), (12.0, -3.0)])
def test_the_foot_alone_tells_the_place(x_m: float, y_m: float) -> None:
    found = place(*cone_at(x_m, y_m, body_range_m=None))
    # Painted to whole pixels: half a row is half a row on the ground.
    away = np.hypot(x_m - MOUNT.x_m, y_m)
    row_m = 0.5 * away**2 / (LENS.fy_px * MOUNT.height_m)
    assert np.hypot(*(found.xy_m[0] - [x_m, y_m])) < row_m + 0.02
    assert found.lift_sigma_m[0] > 1e3


def test_the_range_is_as_uncertain_as_the_row_of_the_foot() -> None:
    config = LocalizationConfig()
    frame, cone = cone_at(12.4, 0.0, body_range_m=None)
    found = localize(frame, cone, EXACT, config)
    edge_m = found.range_m[0] - FOOT_EDGE_SHARE * FOOT_M
    row_m = edge_m**2 * config.edge_sigma_px / (LENS.fy_px * MOUNT.height_m)
    expected = np.hypot(row_m * np.cos(MOUNT.pitch_rad), config.foot_sigma_m)
    assert found.range_sigma_m[0] == pytest.approx(expected, rel=0.02)
    pixel_m, behind_m = 12.0 / 465, config.behind_sigma_m * (12.0 / 15.0) ** 2
    across_m = np.linalg.norm(
        [pixel_m * config.center_sigma_px, config.axis_sigma_m, behind_m]
    )
    assert np.sqrt(found.cov_m2[0, 1, 1]) == pytest.approx(across_m, rel=0.05)


def test_doubt_about_the_plane_is_doubt_about_the_range() -> None:
    frame, cone = cone_at(12.4, 0.0, body_range_m=None)
    sure = localize(frame, cone, EXACT, LocalizationConfig())
    pitch_rad = 0.01
    # A turn about the lateral axis moves the plane's normal by (0, -dz, dy) of it.
    turn = pitch_rad * np.array([0.0, -EXACT.plane[2], EXACT.plane[1]])
    tilted = replace(EXACT, cov=np.outer(turn, turn))
    unsure = localize(frame, cone, tilted, LocalizationConfig())
    edge_m = sure.range_m[0] - FOOT_EDGE_SHARE * FOOT_M
    tilt_m = (edge_m**2 + MOUNT.height_m**2) * pitch_rad / MOUNT.height_m
    assert unsure.range_sigma_m[0] == pytest.approx(
        np.hypot(sure.range_sigma_m[0], tilt_m), rel=0.02
    )


def test_a_neighbour_that_touches_is_a_reason_for_doubt() -> None:
    frame, cone = cone_at(12.4, 0.0, body_range_m=12.0 - BODY_DEPTH_M)
    alone = place(frame, cone)
    crowded = place(frame, replace(cone, crowded=np.array([True])))
    assert crowded.range_sigma_m[0] > 2 * alone.range_sigma_m[0]
    assert np.sqrt(crowded.cov_m2[0, 1, 1]) > 0.03


def test_depth_and_foot_that_agree_are_better_together() -> None:
    away = 3.0
    alone = place(*cone_at(3.4, 0.0, body_range_m=None))
    both = place(*cone_at(3.4, 0.0, body_range_m=away - BODY_DEPTH_M))
    assert both.range_sigma_m[0] < alone.range_sigma_m[0]
    assert both.xy_m[0] == pytest.approx([3.4, 0.0], abs=0.02)
    assert abs(both.lift_m[0]) < 0.01


def test_where_a_foot_is_hidden_depth_counts() -> None:
    frame, cone = cone_at(6.4, 0.0, body_range_m=6.0 - BODY_DEPTH_M)
    rows = cone.pixel_uv[:, 1]
    seen = rows < rows.max() - 6
    box = cone.box_px.copy()
    box[0, 3] -= 7
    color = frame.color.copy()
    color[rows.max() - 6 :] = BLUE
    hidden = replace(
        cone, box_px=box, pixel_uv=cone.pixel_uv[seen], owner=cone.owner[seen]
    )
    found = place(replace(frame, color=color), hidden)
    error_m = abs(found.range_m[0] - 6.0)
    assert error_m < 0.05
    assert found.range_sigma_m[0] > error_m


def test_a_cone_cut_by_the_lower_edge_is_placed_by_its_depth() -> None:
    frame, cone = cone_at(1.6, 0.0, body_range_m=1.2 - BODY_DEPTH_M)
    assert cone.box_px[0, 3] == 479.5
    found = place(frame, cone)
    assert found.range_m[0] == pytest.approx(1.2, abs=0.03)


def test_no_candidates_have_no_places() -> None:
    frame, _ = cone_at(5.0, 0.0, body_range_m=None)
    assert place(frame, Candidates.empty()).xy_m.shape == (0, 2)


@pytest.mark.parametrize(
    ("height_m", "blue", "orange", "big"),
    [(0.325, True, True, 0.0), (0.505, False, True, 1.0), (0.9, False, False, None)],
)
def test_sizes_tell_cones_from_other_things_and_from_each_other(
    height_m: float, blue: bool, orange: bool, big: float | None
) -> None:
    frame, cone = cone_at(5.4, 0.5, body_range_m=None, height_m=height_m)
    places = place(frame, cone)
    sizes = measure_sizes(frame, cone, places, EXACT)
    assert sizes.height_m[0] == pytest.approx(height_m, abs=0.02)
    either = np.array([[0.01, 0.01, 0.48, 0.48, 0.02]])
    assert fits(cone.class_prob, sizes, 14.0).tolist() == [blue]
    assert fits(either, sizes, 14.0).tolist() == [orange]
    shared = with_size(either, sizes)
    assert shared.sum() == pytest.approx(1.0)
    if big is not None:
        assert shared[0, ConeClass.BIG_ORANGE] == pytest.approx(0.96 * big, abs=0.02)


def test_what_the_side_of_the_picture_cuts_may_be_higher_than_it_looks() -> None:
    frame, cone = cone_at(5.4, 0.5, body_range_m=None, height_m=0.2)
    either = np.array([[0.0, 0.0, 0.2, 0.6, 0.2]])
    whole = measure_sizes(frame, cone, place(frame, cone), EXACT)
    assert whole.misfit_d2[0, 1] > 14.0
    cut = replace(cone, box_px=cone.box_px * np.array([0, 1, 1, 1]))
    sizes = measure_sizes(frame, cut, place(frame, cut), EXACT)
    np.testing.assert_allclose(sizes.misfit_d2, 0.0)
    # Nothing speaks for either size but the detector.
    np.testing.assert_allclose(with_size(either, sizes), either)


def test_a_metre_on_the_ground_is_as_large_as_it_looks() -> None:
    scale = GroundScale(LENS, EXACT.plane)
    foot, head = pixel_of(8.0, 1.0, 0.0), pixel_of(8.0, 1.0, 0.01)
    metre_px = scale.px_per_m(foot[None])[0]
    assert metre_px == pytest.approx((foot[1] - head[1]) / 0.01, rel=0.01)


def test_no_cone_within_range_is_above_the_first_row() -> None:
    scale = GroundScale(LENS, EXACT.plane)
    first = scale.first_row(20.0)
    assert first < pixel_of(20.0, 0.0, 0.505)[1]
    assert first > pixel_of(20.0, 0.0, 1.5)[1]
