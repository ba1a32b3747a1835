"""One RGB-D picture of a scene, and the truth about every cone in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.geometry import to_child
from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.cone_shape import CONE_SHAPES
from conegraph.sim.render.depth_sensor import measure_depth
from conegraph.sim.render.draw_cones import PlacedCone, draw_cone
from conegraph.sim.render.draw_panels import draw_panel, panel_corners
from conegraph.sim.render.exposure import develop, motion_blur
from conegraph.sim.render.ground import paint_ground
from conegraph.sim.render.paint import Bytes, Floats, cut
from conegraph.sim.render.rig import D435, Rig, project, ray_slopes
from conegraph.sim.render.scene import Scene
from conegraph.sim.render.shadows import cast_shadows
from conegraph.types import Array, IntArray, Mask

_FARTHEST_CONE_M = 50.0
_FARTHEST_PANEL_M = 90.0
_FARTHEST_GROUND_M = 150.0
_NEAREST_M = 0.25
_DEPTH_LIMIT_M = 60.0


@dataclass(frozen=True, slots=True)
class CarState:
    """How the car moves while the picture is taken.

    Attributes:
        stamp_s: middle of the exposure.
        u_mps: forward speed.
        r_radps: yaw rate.
        pitch_rad: pitch of the body, nose down positive, on top of the mount's.
        roll_rad: roll of the body, right side down positive.
    """

    stamp_s: float = 0.0
    u_mps: float = 0.0
    r_radps: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """What a picture shows, cone by cone, and how the camera really sat.

    Every cone is listed whose outline reaches into the picture, also one that hides
    behind another: then its visible fraction is 0.

    Attributes:
        cone_id: (N,) ids in the scene's cones.
        xy_m: (N, 2) foot centres in the car frame.
        cone_class: (N,) of `ConeClass`.
        box_px: (N, 4) u0, v0, u1, v1 around the whole outline, cut at the picture's
            edges; pixel centres are at whole numbers, so u is in [-0.5, W - 0.5].
        visible_px: (N,) pixels that show it.
        visible_fraction: (N,) of the pixels of an unhidden cone in a picture
            without edges, the share that shows it.
        label: (H, W) row of the cone that a pixel shows, -1 where it shows none.
        mount: where the camera sat, with the body's pitch and roll.
    """

    cone_id: IntArray
    xy_m: Array
    cone_class: IntArray
    box_px: Array
    visible_px: IntArray
    visible_fraction: Array
    label: NDArray[np.int32]
    mount: CameraMount

    def __len__(self) -> int:
        return len(self.cone_id)

    def mask(self, row: int) -> Mask:
        """Return the pixels (H, W) that show the cone of a row."""
        shown: Mask = self.label == row
        return shown


def render_frame(
    scene: Scene,
    pose_world_car: Array,
    rng: np.random.Generator,
    *,
    rig: Rig = D435,
    car: CarState | None = None,
) -> tuple[RgbdFrame, FrameTruth]:
    """Return what an RGB-D camera on a car sees of a scene.

    Every pixel's ray goes through the distorted lens: nothing is warped afterwards,
    and depth is along the optical axis at the pixel where colour shows it. Near
    things hide far ones; shadows, haze, motion blur, noise and the failings of a
    stereo depth sensor are those of the scene's light and the rig.

    Args:
        scene: from `make_scene`.
        pose_world_car: (3,) the car in the scene's world.
        rng: draws the noise of this picture; the same state gives the same picture.
        rig: the camera; frames speak of its ``mount``, not of the tilted one.
        car: how the car moves, standing level by default.

    Returns:
        The frame and its truth.
    """
    car = car or CarState()
    mount = rig.tilted(car.pitch_rad, car.roll_rad)
    eye = Eye(rig.camera, mount, *ray_slopes(rig.camera))
    sun_car = _sun_seen(scene, pose_world_car)
    canvas = _far_things(scene, eye, pose_world_car)
    cones = _cones_ahead(scene, eye, pose_world_car)
    panels = _panels_ahead(scene, eye, pose_world_car)
    upright = [corners for _, corners, _ in panels]
    cast_shadows(canvas, eye, [c for c, _, _ in cones], upright, sun_car, scene.light)
    alone = _draw_upright(canvas, eye, scene, cones, panels, sun_car)
    color = motion_blur(canvas, eye, (car.u_mps, car.r_radps), scene.light.exposure_s)
    color = develop(color, cut(scene.noise, canvas.label.shape, rng))
    depth = measure_depth(rig.depth, canvas.depth_m, rng)
    frame = RgbdFrame(car.stamp_s, color, depth, rig.camera, rig.mount)
    return frame, _truth(scene, canvas, cones, alone, mount)


def _sun_seen(scene: Scene, pose: Array) -> Array:
    sun = scene.light.sun_direction
    flat = to_child(np.array([0.0, 0.0, pose[2]]), sun[None, :2])[0]
    return np.array([*flat, sun[2]])


def _far_things(scene: Scene, eye: Eye, pose: Array) -> Canvas:
    """Return a canvas with ground, sky and horizon."""
    turn = np.array([np.cos(pose[2]), np.sin(pose[2])])
    to_car = eye.mount.rotation_car_optical
    to_world = np.vstack(
        [
            turn[0] * to_car[0] - turn[1] * to_car[1],
            turn[1] * to_car[0] + turn[0] * to_car[1],
            to_car[2],
        ]
    ).astype(np.float32)
    x, y = eye.slope_x, eye.slope_y
    ray_x, ray_y, ray_z = (a * x + b * y + c for a, b, c in to_world)
    height = np.float32(eye.mount.height_m)
    down = np.minimum(ray_z, np.float32(-1e-4))
    reach = -height / down
    ground = (ray_z < -1e-4) & (reach < _FARTHEST_GROUND_M)
    color = np.empty((*x.shape, 3), np.uint8)
    full = ground.all(axis=1)
    some = ground.any(axis=1)
    top = int(np.argmax(some)) if some.any() else len(some)
    all_below = int(len(full) - np.argmin(full[::-1])) if not full.all() else 0
    if all_below:
        sky = slice(0, all_below)
        color[sky] = scene.backdrop.paint(ray_x[sky], ray_y[sky], ray_z[sky])
    if top < len(some):
        below = slice(top, None)
        eye_at = pose[:2] + np.array(
            [
                turn[0] * eye.mount.x_m - turn[1] * eye.mount.y_m,
                turn[1] * eye.mount.x_m + turn[0] * eye.mount.y_m,
            ]
        )
        far = np.minimum(reach[below], _FARTHEST_GROUND_M)
        gx = np.float32(eye_at[0]) + ray_x[below] * far
        gy = np.float32(eye_at[1]) + ray_y[below] * far
        middle = far[:, far.shape[1] // 2]
        footprint = middle / np.float32(eye.camera.fy_px)
        footprint = footprint * np.sqrt(np.maximum(1, middle / height))
        seen = paint_ground(scene.ground, gx, gy, footprint, pose[:2])
        seen = _hazy(seen, np.exp(-far / np.float32(scene.light.haze_m)), scene)
        np.copyto(color[below], seen, where=ground[below][..., None])
    depth = np.where(ground & (reach < _DEPTH_LIMIT_M), reach, 0).astype(np.float32)
    label = np.full(x.shape, -1, np.int32)
    return Canvas(color, depth, label)


def _hazy(picture: Bytes, clear: Floats, scene: Scene) -> Bytes:
    """Return the picture mixed with the air's colour; ``clear`` (H, W) is left."""
    left = (255 * clear).astype(np.uint8)
    seen = cv2.multiply(picture, cv2.merge([left] * 3), scale=1 / 255)
    air = [cv2.convertScaleAbs(255 - left, alpha=c / 255) for c in scene.backdrop.haze]
    return np.asarray(cv2.add(seen, cv2.merge(air)), dtype=np.uint8)


Window = tuple[int, int, int, int]


def _cones_ahead(
    scene: Scene, eye: Eye, pose: Array
) -> list[tuple[PlacedCone, Window, Array]]:
    """Return the cones whose outline reaches into the picture: window and box."""
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
        found.append((cone, window, box))
    return found


def _window(box: Array, eye: Eye) -> Window | None:
    """Return the pixels inside the picture that a box touches, None without any."""
    low = np.maximum(np.floor(box[:2]).astype(int), 0)
    size = (eye.camera.width_px, eye.camera.height_px)
    high = np.minimum(np.ceil(box[2:]).astype(int) + 1, size)
    if (high <= low).any():
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _panels_ahead(
    scene: Scene, eye: Eye, pose: Array
) -> list[tuple[int, Array, float]]:
    """Return index, corners and distance of the panels that are near enough."""
    if not scene.clutter:
        return []
    places = np.array([panel.xy_m for panel in scene.clutter])
    xy = to_child(pose, places)
    found = []
    for i, panel in enumerate(scene.clutter):
        away = float(np.hypot(*xy[i]))
        if xy[i, 0] < 1.0 or away > _FARTHEST_PANEL_M:
            continue
        yaw = None if panel.yaw_rad is None else panel.yaw_rad - float(pose[2])
        corners = panel_corners(panel, xy[i], yaw, eye.mount.position_m)
        if panel.yaw_rad is not None and _from_behind(corners, eye):
            corners = corners[[1, 0, 3, 2]]
        found.append((i, corners, away))
    return found


def _from_behind(corners: Array, eye: Eye) -> bool:
    """Return whether the camera looks at the back of a panel; it is painted too."""
    right, up = corners[1] - corners[0], corners[0] - corners[3]
    face = np.cross(right, up)
    return bool(face @ (eye.mount.position_m - corners[0]) < 0)


def _draw_upright(
    canvas: Canvas,
    eye: Eye,
    scene: Scene,
    cones: list[tuple[PlacedCone, Window, Array]],
    panels: list[tuple[int, Array, float]],
    sun_car: Array,
) -> IntArray:
    """Draw everything that stands, far things first; return each cone's own pixels."""
    at = eye.mount.position_m[:2]
    alone = np.zeros(len(cones), dtype=np.int64)
    jobs = [
        (float(np.hypot(*(c.xy_m - at))), k, True) for k, (c, _, _) in enumerate(cones)
    ]
    jobs += [(away, k, False) for k, (_, _, away) in enumerate(panels)]
    light = scene.light
    for _, k, is_cone in sorted(jobs, key=lambda job: -job[0]):
        if is_cone:
            cone, window, _ = cones[k]
            alone[k] = draw_cone(canvas, eye, cone, window, sun_car, light)
        else:
            index, corners, _ = panels[k]
            dim = 0.6 + 0.4 * light.in_shade
            draw_panel(canvas, eye, scene.clutter[index], corners, dim)
    return alone


def _truth(
    scene: Scene,
    canvas: Canvas,
    cones: list[tuple[PlacedCone, Window, Array]],
    alone: IntArray,
    mount: CameraMount,
) -> FrameTruth:
    order = np.array([c.index for c, _, _ in cones], dtype=np.int64)
    boxes = np.array([box for _, _, box in cones]).reshape(-1, 4)
    row_of = np.full(len(scene.cones) + 1, -1, np.int32)
    row_of[order] = np.arange(len(order), dtype=np.int32)
    label = row_of[canvas.label]
    visible = np.bincount(label[label >= 0], minlength=len(order)).astype(np.int64)
    rows, columns = label.shape
    edges = np.array([columns, rows, columns, rows]) - 0.5
    cut = np.clip(boxes, -0.5, edges)
    inside = np.prod(cut[:, 2:] - cut[:, :2], axis=1)
    whole = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    share = inside / np.maximum(whole, 1e-9)
    return FrameTruth(
        scene.cones.id[order],
        np.array([c.xy_m for c, _, _ in cones]).reshape(-1, 2),
        scene.cones.cone_class[order],
        cut,
        visible,
        share * visible / np.maximum(alone, 1),
        label,
        mount,
    )
