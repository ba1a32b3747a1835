"""The camera on the car: its lens, where it sits, its depth sensor; and its rays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount
from conegraph.sim.render.depth_sensor import StereoDepth
from conegraph.types import Array

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Rig:
    """An RGB-D camera on a car.

    Attributes:
        camera: the colour lens; depth is registered to it.
        mount: where it sits while the car stands still.
        depth: how depth is measured.
    """

    camera: Camera
    mount: CameraMount
    depth: StereoDepth = field(default_factory=StereoDepth)

    def tilted(self, pitch_rad: float, roll_rad: float) -> CameraMount:
        """Return where the camera sits while the body pitches and rolls."""
        return replace(
            self.mount,
            pitch_rad=self.mount.pitch_rad + pitch_rad,
            roll_rad=self.mount.roll_rad + roll_rad,
        )


D435 = Rig(
    Camera(640, 480, 465.0, 465.0, 321.3, 238.1, (-0.06, 0.02, 4e-4, -3e-4, 0.0)),
    CameraMount(height_m=0.9, pitch_rad=float(np.radians(8.0))),
)
"""A RealSense D435 above the front axle: 69 degrees wide, nose slightly down."""


@lru_cache(maxsize=4)
def ray_slopes(camera: Camera) -> tuple[Floats, Floats]:
    """Return x/z and y/z (H, W) of the ray through every pixel's centre.

    Points at depth Z on the ray are ``(x/z, y/z, 1) Z`` in the optical frame.
    """
    shape = (camera.height_px, camera.width_px)
    u, v = np.meshgrid(
        np.arange(shape[1], dtype=float), np.arange(shape[0], dtype=float)
    )
    pixels = np.stack([u.ravel(), v.ravel()], -1)[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    slopes = cv2.undistortPoints(
        pixels,
        camera.matrix,
        np.array(camera.distortion),
        R=np.eye(3),
        P=np.eye(3),
        criteria=criteria,
    ).reshape(*shape, 2)
    x, y = (np.ascontiguousarray(slopes[..., k], dtype=np.float32) for k in (0, 1))
    x.flags.writeable = y.flags.writeable = False
    return x, y


def project(camera: Camera, mount: CameraMount, points_m: Array) -> tuple[Array, Array]:
    """Return pixels (N, 2) and depths (N,) of points (N, 3) in the car frame.

    With slopes x = X/Z, y = Y/Z and r2 = x^2 + y^2, the lens of Brown and Conrady::

        k  = 1 + k1 r2 + k2 r2^2 + k3 r2^3
        x' = x k + 2 p1 x y + p2 (r2 + 2 x^2)
        y' = y k + p1 (r2 + 2 y^2) + 2 p2 x y

    Pixels of points that are not in front of the camera mean nothing.
    """
    optical = (points_m - mount.position_m) @ mount.rotation_car_optical
    depth = optical[:, 2]
    x, y = (optical[:, :2] / np.where(depth > 1e-6, depth, 1e-6)[:, None]).T
    k1, k2, p1, p2, k3 = camera.distortion
    # Far outside the picture the polynomial folds back into it.
    r2 = np.minimum(x * x + y * y, 2.0)
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    u = camera.fx_px * bent_x + camera.cx_px
    v = camera.fy_px * bent_y + camera.cy_px
    return np.column_stack([u, v]), depth
