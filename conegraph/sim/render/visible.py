"""Which cones and which things reach into a picture, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.geometry import to_child
from conegraph.sim.render.canvas import Eye
from conegraph.sim.render.clutter import Panel
from conegraph.sim.render.cone_shape import CONE_SHAPES
from conegraph.sim.render.draw_cones import PlacedCone
from conegraph.sim.render.draw_panels import panel_corners
from conegraph.sim.render.rig import project
from conegraph.sim.render.scene import Scene
from conegraph.types import Array

_FARTHEST_CONE_M = 50.0
_FARTHEST_PANEL_M = 90.0
_NEAREST_M = 0.25
_NEAREST_PANEL_M = 1.0

Window = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class SeenCone:
    """A cone whose outline reaches into the picture.

    Attributes:
        cone: the cone.
        window: pixels u0, v0, u1, v1 (exclusive) of the picture that hold it.
        box_px: (4,) u0, v0, u1, v1 around its outline, also beyond the edges.
        away_m: distance from the camera on the ground.
    """

    cone: PlacedCone
    window: Window
    box_px: Array
    away_m: float


@dataclass(frozen=True, slots=True)
class SeenPanel:
    """A panel near enough to be seen: its corners (4, 3) in the car frame."""

    panel: Panel
    corners_m: Array
    away_m: float


def cones_ahead(scene: Scene, eye: Eye, pose: Array) -> list[SeenCone]:
    """Return the cones whose outline reaches into the picture."""
    xy = to_child(pose, scene.cones.xy_m)
    away = np.hypot(*(xy - eye.mount.position_m[:2]).T)
    near = np.flatnonzero(away < _FARTHEST_CONE_M)
    yaw = scene.cone_yaw_rad - pose[2]
    outline = scene.outline_m[near]
    c, s = np.cos(yaw[near])[:, None], np.sin(yaw[near])[:, None]
    points = outline.copy()
    points[..., 0] = c * outline[..., 0] - s * outline[..., 1] + xy[near, :1]
    points[..., 1] = s * outline[..., 0] + c * outline[..., 1] + xy[near, 1:]
    pixels, depth = project(eye.camera, eye.mount, points.reshape(-1, 3))
    pixels = pixels.reshape(*points.shape[:2], 2)
    boxes = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
    in_front = depth.reshape(points.shape[:2]).min(axis=1) >= _NEAREST_M
    found = []
    for i, box in zip(near[in_front], boxes[in_front], strict=True):
        window = _window(box, eye)
        if window is None:
            continue
        cone = PlacedCone(
            int(i),
            xy[i],
            float(yaw[i]),
            CONE_SHAPES[int(scene.cones.cone_class[i])],
            scene.body_color[i],
            scene.stripe_color[i],
            float(scene.sunlit[i]),
        )
        found.append(SeenCone(cone, window, box, float(away[i])))
    return found


def _window(box: Array, eye: Eye) -> Window | None:
    """Return the pixels inside the picture that a box touches, None without any."""
    low = np.maximum(np.floor(box[:2]).astype(int), 0)
    size = (eye.camera.width_px, eye.camera.height_px)
    high = np.minimum(np.ceil(box[2:]).astype(int) + 1, size)
    if (high <= low).any():
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def panels_ahead(scene: Scene, eye: Eye, pose: Array) -> list[SeenPanel]:
    """Return the panels that are ahead and near enough."""
    if not scene.clutter:
        return []
    places = np.array([panel.xy_m for panel in scene.clutter])
    xy = to_child(pose, places)
    found = []
    for panel, at in zip(scene.clutter, xy, strict=True):
        away = float(np.hypot(*(at - eye.mount.position_m[:2])))
        if at[0] < _NEAREST_PANEL_M or away > _FARTHEST_PANEL_M:
            continue
        yaw = None if panel.yaw_rad is None else panel.yaw_rad - float(pose[2])
        corners = panel_corners(panel, at, yaw, eye.mount.position_m)
        if panel.yaw_rad is not None and _from_behind(corners, eye):
            corners = corners[[1, 0, 3, 2]]
        found.append(SeenPanel(panel, corners, away))
    return found


def _from_behind(corners: Array, eye: Eye) -> bool:
    """Return whether the camera looks at the back of a panel; it is painted too."""
    right, up = corners[1] - corners[0], corners[0] - corners[3]
    face = np.cross(right, up)
    return bool(face @ (eye.mount.position_m - corners[0]) < 0)
