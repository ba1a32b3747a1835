"""From a sharp picture to the one that a camera on a moving car takes."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.paint import Bytes, Floats
from conegraph.types import Array

_COARSE = 4
_SHARP_PX = 0.7
_FEW_TAPS_PX = 4.0


def motion_blur(
    canvas: Canvas, eye: Eye, velocity: tuple[float, float], exposure_s: float
) -> Bytes:
    """Return the picture smeared by the car's motion while the shutter is open.

    A point at ``Z (x, y, 1)`` in a camera that moves with v and turns with w moves
    in the picture by (Longuet-Higgins and Prazdny)::

        x' = -(v_x - x v_z) / Z - (w_y - w_z y) + x (w_x y - w_y x)
        y' = -(v_y - y v_z) / Z - (w_z x - w_x) + y (w_x y - w_y x)

    Args:
        canvas: the sharp picture of the middle of the exposure, and its depth.
        eye: the camera.
        velocity: forward speed in m/s and yaw rate in rad/s of the car.
        exposure_s: how long the shutter is open.
    """
    speed, turn = velocity
    if exposure_s * max(abs(speed), abs(turn)) < 1e-4:
        return canvas.color
    back = eye.mount.rotation_car_optical.T
    lever = np.array([-eye.mount.y_m * turn, eye.mount.x_m * turn, 0.0])
    v = back @ (np.array([speed, 0.0, 0.0]) + lever)
    w = back @ np.array([0.0, 0.0, turn])
    du, dv = _flow(canvas, eye, v * exposure_s, w * exposure_s)
    longest = np.sqrt((du * du + dv * dv).max(axis=1))
    rows = np.flatnonzero(longest >= _SHARP_PX)
    if not len(rows):
        return canvas.color
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    taps = 3 if longest.max() < _FEW_TAPS_PX else 5
    blurred = canvas.color.copy()
    blurred[part] = _smeared(canvas.color, part, du[part], dv[part], taps)
    return blurred


def _flow(canvas: Canvas, eye: Eye, v: Array, w: Array) -> tuple[Floats, Floats]:
    """Return the way (H, W) in pixels of every pixel, from a coarse grid."""
    pick = (slice(_COARSE // 2, None, _COARSE),) * 2
    x, y, depth = eye.slope_x[pick], eye.slope_y[pick], canvas.depth_m[pick]
    near = np.where(depth > 0, 1 / np.maximum(depth, 0.1), 0)
    common = w[0] * y - w[1] * x
    across = -(v[0] - x * v[2]) * near - (w[1] - w[2] * y) + x * common
    down = -(v[1] - y * v[2]) * near - (w[2] * x - w[0]) + y * common
    size = (canvas.label.shape[1], canvas.label.shape[0])
    du, dv = (
        np.asarray(cv2.resize((f * part).astype(np.float32), size), np.float32)
        for f, part in ((eye.camera.fx_px, across), (eye.camera.fy_px, down))
    )
    return du, dv


def _smeared(picture: Bytes, rows: slice, du: Floats, dv: Floats, taps: int) -> Bytes:
    """Return the mean (R, W, 3) of rows of the picture, moved along their flow."""
    u = np.arange(picture.shape[1], dtype=np.float32)[None]
    v = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None]
    total = np.zeros((*du.shape, 3), np.uint16)
    for share in np.linspace(-0.5, 0.5, taps, dtype=np.float32):
        seen = cv2.remap(
            picture,
            u + share * du,
            v + share * dv,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        cv2.add(total, seen, dst=total, dtype=cv2.CV_16U)
    return np.asarray(cv2.convertScaleAbs(total, alpha=1 / taps), dtype=np.uint8)


def develop(
    picture: Bytes, noise: np.ndarray[tuple[int, ...], np.dtype[np.int16]]
) -> Bytes:
    """Return the picture as the lens softens it and the sensor adds noise (H, W, 3)."""
    soft = cv2.GaussianBlur(picture, (3, 3), 0.6)
    return np.asarray(cv2.add(soft, noise, dtype=cv2.CV_8U), dtype=np.uint8)
