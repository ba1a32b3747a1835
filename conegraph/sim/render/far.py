"""What everything else is drawn over: ground, sky and horizon."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.ground import paint_ground
from conegraph.sim.render.paint import Bytes, Floats
from conegraph.sim.render.scene import Scene
from conegraph.types import Array, Mask

_FARTHEST_GROUND_M = 150.0
_DEPTH_LIMIT_M = 60.0


def paint_far(scene: Scene, eye: Eye, pose_world_car: Array) -> Canvas:
    """Return a canvas with ground, sky and horizon, and nothing that stands."""
    c, s = np.cos(pose_world_car[2]), np.sin(pose_world_car[2])
    to_world_car = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    to_world = (to_world_car @ eye.mount.rotation_car_optical).astype(np.float32)
    at = to_world_car @ eye.mount.position_m + np.array([*pose_world_car[:2], 0.0])
    x, y, z = (a * eye.slope_x + b * eye.slope_y + c for a, b, c in to_world)
    reach = -np.float32(at[2]) / np.minimum(z, np.float32(-1e-4))
    ground: Mask = (z < -1e-4) & (reach < _FARTHEST_GROUND_M)
    color = np.empty((*x.shape, 3), np.uint8)
    some: Mask = np.any(ground, axis=1)
    partly: Mask = np.any(~ground, axis=1)
    below = slice(_first(some), None)
    above = slice(0, len(ground) - _first(partly[::-1]))
    if above.stop:
        color[above] = scene.backdrop.paint(x[above], y[above], z[above])
    if below.start < len(ground):
        far = np.minimum(reach[below], np.float32(_FARTHEST_GROUND_M))
        gx = np.float32(at[0]) + x[below] * far
        gy = np.float32(at[1]) + y[below] * far
        footprint = _footprint(far[:, far.shape[1] // 2], eye)
        seen = paint_ground(scene.ground, gx, gy, footprint, pose_world_car[:2])
        seen = _hazy(seen, np.exp(-far / np.float32(scene.light.haze_m)), scene)
        mixed = max(above.stop - below.start, 0)
        np.copyto(
            color[below][:mixed], seen[:mixed], where=ground[below][:mixed, :, None]
        )
        color[below][mixed:] = seen[mixed:]
    depth = np.where(ground & (reach < _DEPTH_LIMIT_M), reach, 0).astype(np.float32)
    return Canvas(color, depth, np.full(x.shape, -1, np.int32))


def _first(rows: Mask) -> int:
    """Return the first row (N,) that holds, N if none does."""
    return int(np.argmax(rows)) if rows.any() else len(rows)


def _footprint(depth_m: Floats, eye: Eye) -> Floats:
    """Return about how much ground (R,) a pixel covers at depths (R,).

    Across the view it is Z / f, along it Z^2 / (f h): their geometric mean, and no
    less than the first.
    """
    along = np.sqrt(np.maximum(depth_m / np.float32(eye.mount.height_m), 1))
    return np.asarray(depth_m / np.float32(eye.camera.fy_px) * along, np.float32)


def _hazy(picture: Bytes, clear: Floats, scene: Scene) -> Bytes:
    """Return the picture mixed with the air's colour; ``clear`` (H, W) is left."""
    left = (255 * clear).astype(np.uint8)
    seen = cv2.multiply(picture, cv2.merge([left] * 3), scale=1 / 255)
    air = [cv2.convertScaleAbs(255 - left, alpha=c / 255) for c in scene.backdrop.haze]
    return np.asarray(cv2.add(seen, cv2.merge(air)), dtype=np.uint8)
