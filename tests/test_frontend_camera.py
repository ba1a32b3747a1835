"""Rays and their projections undo each other; a mount and its plane are one thing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.frontend.camera import (
    half_fov_rad,
    mount_on_plane,
    plane_of_mount,
    project,
    ray_grid,
    rays,
    undistorted,
)

LENS = Camera(640, 480, 465.0, 460.0, 321.3, 238.1, (-0.06, 0.02, 4e-4, -3e-4, 0.01))
PINHOLE = Camera(640, 480, 465.0, 460.0, 321.3, 238.1)
angles = st.floats(-0.4, 0.4)


@given(st.floats(0, 639), st.floats(0, 479), st.floats(0.3, 30))
def test_a_ray_projects_back_to_its_pixel(u: float, v: float, z_m: float) -> None:
    at = np.array([[u, v]])
    assert project(LENS, z_m * rays(LENS, at)) == pytest.approx(at, abs=0.02)


def test_the_corners_of_a_wide_lens_are_not_left_bent() -> None:
    lens = Camera(1280, 720, 700.0, 700.0, 640.0, 360.0, (-0.25, 0.08, 1e-3, 0.0, 0.0))
    corners = np.array([[0.0, 0.0], [1279.0, 0.0], [0.0, 719.0], [1279.0, 719.0]])
    assert project(lens, rays(lens, corners)) == pytest.approx(corners, abs=1e-3)


@given(angles, angles, st.floats(-3, 3), st.floats(0.2, 3))
def test_a_mount_is_found_again_from_its_plane(
    pitch: float, roll: float, yaw: float, height_m: float
) -> None:
    mount = CameraMount(0.3, -0.1, height_m, pitch, roll, yaw)
    found = mount_on_plane(mount, plane_of_mount(mount))
    assert found.height_m == pytest.approx(height_m)
    assert found.pitch_rad == pytest.approx(pitch, abs=1e-9)
    assert found.roll_rad == pytest.approx(roll, abs=1e-9)
    assert (found.x_m, found.y_m, found.yaw_rad) == (0.3, -0.1, yaw)


def test_the_plane_gives_the_depth_of_the_ground() -> None:
    mount = CameraMount(height_m=0.9, pitch_rad=0.14, roll_rad=0.02)
    at = rays(LENS, np.array([[100.0, 400.0], [320.0, 300.0], [600.0, 470.0]]))
    points = at / (at @ plane_of_mount(mount))[:, None]
    heights = points @ mount.rotation_car_optical.T + mount.position_m
    assert heights[:, 2] == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_grid_holds_every_nth_ray() -> None:
    grid = ray_grid(LENS, 8)
    assert grid.shape == (60, 80, 2)
    assert grid[10, 20] == pytest.approx(rays(LENS, np.array([[160.0, 80.0]]))[0, :2])


def test_the_view_is_as_wide_as_its_nearer_side() -> None:
    assert half_fov_rad(PINHOLE) == pytest.approx(np.arctan((639 - 321.3) / 465.0))


def test_an_undistorted_picture_shows_things_where_a_pinhole_would() -> None:
    color = np.zeros((480, 640, 3), dtype=np.uint8)
    color[60:63, 40:43] = 255
    depth_m = np.where(color[..., 0] > 0, 7.0, 0.0).astype(np.float32)
    frame = RgbdFrame(0.0, color, depth_m, LENS, CameraMount())
    flat = undistorted(frame)
    ray = rays(LENS, np.array([[41.0, 61.0]]))
    bright = np.argwhere(flat.color[..., 0] > 128).mean(axis=0)[::-1]
    assert bright == pytest.approx(project(PINHOLE, ray)[0], abs=0.5)
    assert set(np.unique(flat.depth_m)) == {0.0, 7.0}
    assert flat.camera == PINHOLE


def test_a_picture_without_distortion_stays_as_it_is() -> None:
    color = np.zeros((480, 640, 3), dtype=np.uint8)
    depth_m = np.zeros((480, 640), dtype=np.float32)
    frame = RgbdFrame(0.0, color, depth_m, PINHOLE, CameraMount())
    assert undistorted(frame) is frame


def test_no_pixels_have_no_rays() -> None:
    assert rays(LENS, np.zeros((0, 2))).shape == (0, 3)
    assert project(LENS, np.zeros((0, 3))).shape == (0, 2)
