"""Rays of a lens: what direction every pixel looks in, without its distortion.

The front end does not resample pictures. It works on the distorted one and asks
for the rays of the few pixels that matter, which costs less and blurs nothing.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.types import Array

UNTIL = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-6)
"""OpenCV's five rounds leave 0.05 px at the corners of a common wide lens."""
Floats = NDArray[np.float32]
Maps = tuple[cv2.typing.MatLike, cv2.typing.MatLike]


def rays(camera: Camera, uv_px: Array) -> Array:
    """Return the rays (N, 3) = (X/Z, Y/Z, 1) of pixels (N, 2), undistorted.

    Points at depth Z on a ray are ``Z`` times it, in the optical frame.
    """
    uv = np.asarray(uv_px, dtype=np.float64).reshape(-1, 1, 2)
    out = np.ones((len(uv), 3))
    if len(uv):
        flat = cv2.undistortPoints(
            uv,
            camera.matrix,
            np.array(camera.distortion),
            R=np.eye(3),
            P=np.eye(3),
            criteria=UNTIL,
        )
        out[:, :2] = flat[:, 0]
    return out


def project(camera: Camera, points_m: Array) -> Array:
    """Return the pixels (N, 2) of points (N, 3) of the optical frame, distorted."""
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 1, 3)
    if not len(points):
        return np.zeros((0, 2))
    at, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    return np.asarray(at[:, 0], dtype=np.float64)


def half_fov_rad(camera: Camera) -> float:
    """Return half the horizontal field of view, to the nearer side."""
    middle = np.full(2, camera.cy_px)
    sides = np.column_stack([[0.0, camera.width_px - 1.0], middle])
    return float(np.arctan(np.abs(rays(camera, sides)[:, 0]).min()))


@lru_cache(maxsize=8)
def ray_grid(camera: Camera, step_px: int) -> Floats:
    """Return the rays (H', W', 2) = (X/Z, Y/Z) of every ``step_px``-th pixel."""
    v, u = np.mgrid[0 : camera.height_px : step_px, 0 : camera.width_px : step_px]
    at = rays(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    grid = at[:, :2].reshape(*u.shape, 2).astype(np.float32)
    grid.flags.writeable = False
    return grid


def undistorted(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame as a lens without distortion would have taken it.

    Colours are interpolated, depths are those of the nearest pixel, since between
    two depths there often is nothing.
    """
    lens = frame.camera
    if not any(lens.distortion):
        return frame
    smooth, nearest = _maps(lens)
    color = cv2.remap(frame.color, *smooth, cv2.INTER_LINEAR)
    depth_m = cv2.remap(frame.depth_m, *nearest, cv2.INTER_NEAREST)
    return RgbdFrame(
        frame.stamp_s,
        np.asarray(color, dtype=np.uint8),
        np.asarray(depth_m, dtype=np.float32),
        _pinhole(lens),
        frame.mount,
    )


def _pinhole(lens: Camera) -> Camera:
    return Camera(
        lens.width_px, lens.height_px, lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px
    )


@lru_cache(maxsize=4)
def _maps(lens: Camera) -> tuple[Maps, Maps]:
    size = (lens.width_px, lens.height_px)
    u, v = cv2.initUndistortRectifyMap(
        lens.matrix, np.array(lens.distortion), np.eye(3), lens.matrix, size, cv2.CV_32F
    )
    smooth = cv2.convertMaps(u, v, cv2.CV_16SC2)
    nearest = cv2.convertMaps(u, v, cv2.CV_16SC2, nninterpolation=True)
    return (smooth[0], smooth[1]), (nearest[0], nearest[1])


def mount_on_plane(mount: CameraMount, plane: Array) -> CameraMount:
    """Return the mount with height, pitch and roll as the ground shows them.

    With the plane ``1/Z = p . (x, y, 1)``, the height is ``1/|p|`` and the ground's
    downward normal n is ``p/|p|``, for which a mount of that pitch and roll has
    ``n = (cos pitch sin roll, cos pitch cos roll, sin pitch)``.
    """
    height_m = 1.0 / float(np.linalg.norm(plane))
    x, y, z = np.asarray(plane) * height_m
    return CameraMount(
        mount.x_m,
        mount.y_m,
        height_m,
        float(np.arcsin(np.clip(z, -1.0, 1.0))),
        float(np.arctan2(x, y)),
        mount.yaw_rad,
    )


def plane_of_mount(mount: CameraMount) -> Array:
    """Return the ground (3,) in inverse depth, ``1/Z = p . (X/Z, Y/Z, 1)``.

    A point of the ray has car-frame height ``h + Z R_3 . r``, which is zero on the
    ground, R_3 being the last row of the rotation from optical to car frame.
    """
    plane: Array = -mount.rotation_car_optical[2] / mount.height_m
    return plane
