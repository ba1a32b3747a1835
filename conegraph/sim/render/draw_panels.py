"""Upright pictures: a sprite warped into the place where the camera sees it."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.clutter import Panel
from conegraph.sim.render.paint import Bytes, to_bytes
from conegraph.sim.render.rig import project
from conegraph.types import Array

_NEAREST_M = 0.5


def panel_corners(
    panel: Panel, xy_car_m: Array, yaw_car_rad: float | None, eye_m: Array
) -> Array:
    """Return (4, 3) corners in the car frame: top left, top right, feet right, left.

    Left and right are those of somebody who looks at its face.
    """
    if yaw_car_rad is None:
        towards = eye_m[:2] - xy_car_m
        yaw_car_rad = float(np.arctan2(towards[1], towards[0]))
    right = np.array([-np.sin(yaw_car_rad), np.cos(yaw_car_rad)]) * panel.width_m / 2
    left_foot, right_foot = xy_car_m - right, xy_car_m + right
    tall = panel.height_m
    return np.array(
        [
            [*left_foot, tall],
            [*right_foot, tall],
            [*right_foot, 0.0],
            [*left_foot, 0.0],
        ]
    )


def draw_panel(
    canvas: Canvas, eye: Eye, panel: Panel, corners_m: Array, brightness: float
) -> None:
    """Draw a panel over what is there already, and its depth.

    Args:
        canvas: what to draw into.
        eye: the camera.
        panel: what to draw.
        corners_m: (4, 3) from `panel_corners`.
        brightness: factor on its colours.
    """
    pixels, depth = project(eye.camera, eye.mount, corners_m)
    if depth.min() < _NEAREST_M:
        return
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    size = np.array([eye.camera.width_px, eye.camera.height_px])
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, size)
    if (high - low < 1).any():
        return
    u0, v0, u1, v1 = (int(n) for n in (*low, *high))
    sprite = _near_size(panel.levels, pixels)
    tall, wide = sprite.shape[:2]
    source = np.array([[0, 0], [wide, 0], [wide, tall], [0, tall]], np.float32) - 0.5
    target = (pixels - low).astype(np.float32)
    warp = cv2.getPerspectiveTransform(source, target)
    shown = cv2.warpPerspective(sprite, warp, (u1 - u0, v1 - v0)).astype(np.float32)
    cover = shown[..., 3:] / 255
    patch = canvas.color[v0:v1, u0:u1]
    painted = np.float32(brightness) * shown[..., :3]
    patch[...] = to_bytes(patch * (1 - cover) + painted)
    mine = cover[..., 0] >= 0.5
    away = _plane_depth(eye, corners_m, (u0, v0, u1, v1))
    canvas.depth_m[v0:v1, u0:u1][mine] = away[mine]
    canvas.label[v0:v1, u0:u1][mine] = -1


def _near_size(levels: tuple[Bytes, ...], pixels: Array) -> Bytes:
    """Return the smallest picture that is not smaller than it is seen."""
    tall = max(np.hypot(*(pixels[3] - pixels[0])), np.hypot(*(pixels[2] - pixels[1])))
    wide = max(np.hypot(*(pixels[1] - pixels[0])), np.hypot(*(pixels[2] - pixels[3])))
    enough = [p for p in levels if p.shape[0] >= tall and p.shape[1] >= wide]
    return enough[-1] if enough else levels[0]


def _plane_depth(
    eye: Eye, corners_m: Array, window: tuple[int, int, int, int]
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return the depth (h, w) at which the rays of a window meet the panel's plane."""
    u0, v0, u1, v1 = window
    optical = (corners_m - eye.mount.position_m) @ eye.mount.rotation_car_optical
    normal = np.cross(optical[1] - optical[0], optical[3] - optical[0])
    x, y = eye.slope_x[v0:v1, u0:u1], eye.slope_y[v0:v1, u0:u1]
    steep = normal[0] * x + normal[1] * y + normal[2]
    near, far = optical[:, 2].min(), optical[:, 2].max()
    depth = float(normal @ optical[0]) / np.where(np.abs(steep) < 1e-9, 1e-9, steep)
    return np.clip(depth, near, far).astype(np.float32)
