"""Rendered pictures agree with their truth and with the physics they stand for."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.sim.render import (
    D435,
    LIGHT_NAMES,
    CarState,
    FrameTruth,
    LightName,
    Rig,
    Scene,
    StereoDepth,
    draw_light,
    make_scene,
    render_frame,
)
from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.cone_shape import CONE_SHAPES
from conegraph.sim.render.depth_sensor import measure_depth
from conegraph.sim.render.draw_cones import cast
from conegraph.sim.render.exposure import motion_blur
from conegraph.sim.render.rig import project, ray_slopes
from conegraph.types import Array, ConeClass, TruthMap

ORIGIN = np.zeros(3)
PERFECT = replace(
    D435,
    depth=StereoDepth(
        disparity_sigma_px=0.0,
        disparity_step_px=1e-6,
        depth_step_m=1e-4,
        hole_share=0.0,
        max_m=60.0,
    ),
)
CONES = TruthMap(
    np.array([10, 11, 12, 13, 14, 15]),
    np.array([(4.0, 1.2), (4.0, -1.2), (6.0, 0.0), (8.0, 3.0), (9, -3.0), (-3, 0.0)]),
    np.array([0, 1, 2, 3, 0, 1]),
)


@lru_cache(maxsize=8)
def scene_in(name: LightName, clutter: int = 0) -> Scene:
    rng = np.random.default_rng(5)
    return make_scene(CONES, rng, light=draw_light(rng, name), clutter=clutter)


def shot(
    name: LightName = "bright", rig: Rig = D435, car: CarState | None = None
) -> tuple[RgbdFrame, FrameTruth]:
    rng = np.random.default_rng(0)
    return render_frame(scene_in(name), ORIGIN, rng, rig=rig, car=car)


def back_projected(frame: RgbdFrame, truth: FrameTruth, row: int) -> Array:
    """Return the points (N, 3) in the car frame that a cone's pixels show."""
    x, y = ray_slopes(frame.camera)
    mask = truth.mask(row) & (frame.depth_m > 0)
    depth = frame.depth_m[mask]
    optical = np.column_stack([x[mask] * depth, y[mask] * depth, depth])
    points: Array = optical @ truth.mount.rotation_car_optical.T
    return points + truth.mount.position_m


def test_the_same_generator_makes_the_same_picture() -> None:
    scene = scene_in("bright", 40)
    first, second, other = (
        render_frame(scene, ORIGIN, np.random.default_rng(seed))[0]
        for seed in (3, 3, 4)
    )
    assert np.array_equal(first.color, second.color)
    assert np.array_equal(first.depth_m, second.depth_m)
    assert not np.array_equal(first.color, other.color)


def test_the_same_seed_makes_the_same_world() -> None:
    twice = [
        render_frame(
            make_scene(CONES, np.random.default_rng(9)),
            ORIGIN,
            np.random.default_rng(0),
        )[0]
        for _ in range(2)
    ]
    assert np.array_equal(twice[0].color, twice[1].color)


def test_projection_is_the_inverse_of_the_rays() -> None:
    x, y = ray_slopes(D435.camera)
    rows, columns = np.array([0, 240, 479, 3]), np.array([0, 320, 639, 600])
    rays = np.column_stack([x[rows, columns], y[rows, columns], np.ones(4)])
    points = 7.0 * rays @ D435.mount.rotation_car_optical.T + D435.mount.position_m
    pixels, depth = project(D435.camera, D435.mount, points)
    np.testing.assert_allclose(pixels, np.column_stack([columns, rows]), atol=2e-3)
    np.testing.assert_allclose(depth, 7.0, atol=1e-5)


def test_projection_agrees_with_opencv() -> None:
    rng = np.random.default_rng(0)
    optical = np.column_stack([rng.uniform(-2, 2, (50, 2)), rng.uniform(4, 9, 50)])
    points = optical @ D435.mount.rotation_car_optical.T + D435.mount.position_m
    pixels, _ = project(D435.camera, D435.mount, points)
    lens = np.array(D435.camera.distortion)
    none = np.zeros(3)
    expected, _ = cv2.projectPoints(optical, none, none, D435.camera.matrix, lens)
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-6)


def test_a_level_ray_meets_the_body_at_its_radius() -> None:
    shape = CONE_SHAPES[ConeClass.BIG_ORANGE]
    level = 0.25
    share = (level - 0.02) / (shape.height_m - 0.02)
    radius = shape.base_radius_m + share * (shape.top_radius_m - shape.base_radius_m)
    ray = tuple(np.array([[v]], np.float32) for v in (1.0, 0.0, 0.0))
    hits = cast(shape, np.array([-3.0, 0, level], np.float32), (ray[0], ray[1], ray[2]))
    assert hits.t[0, 0] == pytest.approx(3.0 - radius, abs=1e-5)
    assert hits.body[0, 0]
    slope = (shape.base_radius_m - shape.top_radius_m) / (shape.height_m - 0.02)
    normal = np.array([n[0, 0] for n in hits.normal])
    expected = np.array([-1, 0, slope]) / np.hypot(1, slope)
    np.testing.assert_allclose(normal, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("mount", "car"),
    [
        (D435.mount, CarState()),
        (D435.mount, CarState(pitch_rad=-0.03, roll_rad=0.05)),
        (CameraMount(0.4, -0.3, 1.2, 0.2, -0.04, 0.1), CarState(pitch_rad=0.02)),
    ],
    ids=["as mounted", "leaning", "mounted askew"],
)
def test_every_cone_pixel_lies_on_its_cone(mount: CameraMount, car: CarState) -> None:
    frame, truth = shot(rig=replace(PERFECT, mount=mount), car=car)
    assert set(truth.cone_id.tolist()) == {10, 11, 12, 13, 14}
    for row in range(len(truth)):
        points = back_projected(frame, truth, row)
        shape = CONE_SHAPES[int(truth.cone_class[row])]
        away = np.hypot(*(points[:, :2] - truth.xy_m[row]).T)
        # Depth spreads over edges by a pixel: some points lie behind or before.
        inside = (away < shape.side_m * 0.75) & (points[:, 2] < shape.height_m + 0.02)
        assert inside.mean() > 0.93, row
        assert np.median(away) < shape.side_m / 2


def test_boxes_hold_their_masks_and_no_more() -> None:
    _, truth = shot()
    for row in range(len(truth)):
        v, u = np.nonzero(truth.mask(row))
        seen = np.array([u.min() - 0.5, v.min() - 0.5, u.max() + 0.5, v.max() + 0.5])
        np.testing.assert_allclose(truth.box_px[row], seen, atol=1.6)
        assert truth.visible_px[row] == len(u)
    assert (truth.visible_fraction > 0.99).all()


def test_a_cone_at_the_edge_shows_a_part() -> None:
    scene = scene_in("bright")
    half = np.arctan(-ray_slopes(D435.camera)[0][280, 0] / np.cos(D435.mount.pitch_rad))
    pose = np.array([0.0, 0.0, np.arctan2(1.2, 4.0) - half])
    _, truth = render_frame(scene, pose, np.random.default_rng(0))
    row = int(np.flatnonzero(truth.cone_id == 10)[0])
    assert 0.3 < truth.visible_fraction[row] < 0.7
    assert truth.box_px[row, 0] == -0.5


def test_a_cone_behind_another_is_listed_and_hidden() -> None:
    cones = TruthMap(
        np.arange(3),
        np.array([(2.2, 0.0), (2.32, 0.0), (5.0, 2.0)]),
        np.array([3, 0, 1]),
    )
    rng = np.random.default_rng(1)
    scene = make_scene(cones, rng, light=draw_light(rng, "overcast"), clutter=0)
    low = replace(D435, mount=CameraMount(height_m=0.5, pitch_rad=0.1))
    _, truth = render_frame(scene, ORIGIN, rng, rig=low)
    fraction = dict(zip(truth.cone_id.tolist(), truth.visible_fraction, strict=True))
    assert fraction[0] == pytest.approx(1.0, abs=0.01)
    assert fraction[1] < 0.35
    assert fraction[2] == pytest.approx(1.0, abs=0.01)


def test_ground_depth_is_that_of_the_plane() -> None:
    camera = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
    rig = Rig(camera, CameraMount(height_m=1.0, pitch_rad=0.5), PERFECT.depth)
    cones = TruthMap(np.array([0]), np.array([(-9.0, 0.0)]), np.array([0]))
    scene = make_scene(cones, np.random.default_rng(0), clutter=0)
    car = CarState(pitch_rad=0.1)
    frame, truth = render_frame(
        scene, ORIGIN, np.random.default_rng(0), rig=rig, car=car
    )
    assert truth.mount.pitch_rad == pytest.approx(0.6)
    assert frame.mount.pitch_rad == 0.5
    assert frame.depth_m[24, 32] == pytest.approx(1.0 / np.sin(0.6), abs=2e-3)
    assert len(truth) == 0


@pytest.mark.parametrize("name", LIGHT_NAMES)
def test_cones_keep_their_colour_in_any_light(name: LightName) -> None:
    frame, truth = shot(name)
    hsv = cv2.cvtColor(frame.color, cv2.COLOR_RGB2HSV)
    turned = {0: (95, 118), 1: (17, 36), 2: (-12, 14), 3: (-12, 14)}
    for row in range(len(truth)):
        pixels = hsv[truth.mask(row)].astype(int)
        vivid = pixels[pixels[:, 1] > 100]
        hue = np.where(vivid[:, 0] > 150, vivid[:, 0] - 180, vivid[:, 0])
        low, high = turned[int(truth.cone_class[row])]
        assert low <= np.median(hue) <= high, (name, row)


def test_dusk_is_darker_than_noon() -> None:
    bright, dusk = (shot(name)[0].color.mean() for name in ("bright", "dusk"))
    assert dusk < 0.75 * bright


def test_stripes_are_where_the_shape_has_them() -> None:
    frame, truth = shot("overcast", PERFECT)
    row = int(np.flatnonzero(truth.cone_class == ConeClass.YELLOW)[0])
    mask = truth.mask(row)
    v, u = np.nonzero(mask)
    brightness = frame.color.max(axis=2).astype(float)
    top, bottom = v.min(), v.max()
    middle = (u.min() + u.max()) // 2
    share = (bottom - np.arange(top, bottom + 1)) / (bottom - top)
    column = brightness[top : bottom + 1, middle]
    black = column[(share > 0.47) & (share < 0.62)].mean()
    yellow = column[(share > 0.2) & (share < 0.36)].mean()
    assert black < 0.45 * yellow


def test_depth_noise_grows_with_the_square_of_depth() -> None:
    sensor = StereoDepth(disparity_step_px=1e-5, hole_share=0.0)
    for depth in (2.0, 4.0, 8.0):
        true = np.full((480, 640), depth, np.float32)
        measured = measure_depth(sensor, true, np.random.default_rng(2))
        seen = measured[measured > 0]
        sigma = depth**2 * 0.08 / (385.0 * 0.05)
        # The tail of 1 / d is heavier than a normal one: compare the middle.
        low, high = np.quantile(seen, [0.16, 0.84])
        assert (high - low) / 2 == pytest.approx(sigma, rel=0.12)
        assert np.median(seen) == pytest.approx(depth, rel=0.02)
        np.testing.assert_allclose(seen * 1000, np.round(seen * 1000), atol=2e-3)


def test_holes_come_as_often_as_asked() -> None:
    true = np.full((480, 640), 2.0, np.float32)
    for share in (0.01, 0.1):
        sensor = StereoDepth(hole_share=share)
        holes = [
            (measure_depth(sensor, true, np.random.default_rng(k)) == 0).mean()
            for k in range(8)
        ]
        assert np.mean(holes) == pytest.approx(share, rel=0.5)


def test_one_eye_sees_behind_the_left_edge_only() -> None:
    sensor = replace(PERFECT.depth, max_m=20.0)
    true = np.full((40, 200), 8.0, np.float32)
    true[:, 100:140] = 2.0
    measured = measure_depth(sensor, true, np.random.default_rng(0))
    shift = 385.0 * 0.05 * (1 / 2.0 - 1 / 8.0)
    assert (measured[20, :100] == 0).sum() == pytest.approx(shift, abs=2)
    assert (measured[20, 142:] > 0).all()


def test_turning_smears_by_the_angle_turned() -> None:
    camera = Camera(201, 101, 300.0, 300.0, 100.0, 50.0)
    eye = Eye(camera, CameraMount(), *ray_slopes(camera))
    line = np.zeros((101, 201, 3), np.uint8)
    line[:, 99:102] = 240
    blank = np.zeros((101, 201), np.float32)
    canvas = Canvas(line, blank, np.full((101, 201), -1, np.int32))
    smeared = motion_blur(canvas, eye, (0.0, 2.0), 0.02)
    row = smeared[50, :, 0].astype(float)
    spread = np.flatnonzero(row > 10)
    assert spread[-1] - spread[0] + 1 == pytest.approx(3 + 300 * 2.0 * 0.02, abs=2.1)
    assert row.sum() == pytest.approx(3 * 240, rel=0.05)
    assert motion_blur(canvas, eye, (0.0, 0.0), 0.02) is line


def test_things_beside_the_track_hide_cones_and_are_no_cones() -> None:
    scene = scene_in("bright", 40)
    bare = scene_in("bright")
    assert len(scene.clutter) > 20
    clear = np.array([p.xy_m for p in scene.clutter])
    away = np.linalg.norm(clear[:, None] - CONES.xy_m[None], axis=2).min(axis=1)
    assert away.min() >= 3.6
    pose = np.array([-12.0, 6.0, -0.2])
    seen, truth = render_frame(scene, pose, np.random.default_rng(0))
    empty, alone = render_frame(bare, pose, np.random.default_rng(0))
    assert np.array_equal(truth.cone_id, alone.cone_id)
    assert (truth.visible_px <= alone.visible_px).all()
    assert np.abs(seen.color.astype(int) - empty.color).max() > 60
