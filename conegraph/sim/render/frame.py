"""One RGB-D picture of a scene, and the truth about every cone in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.geometry import to_child
from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.depth_sensor import measure_depth
from conegraph.sim.render.draw_cones import draw_cone
from conegraph.sim.render.draw_panels import draw_panel
from conegraph.sim.render.exposure import develop, motion_blur
from conegraph.sim.render.far import paint_far
from conegraph.sim.render.light import Light
from conegraph.sim.render.paint import cut
from conegraph.sim.render.rig import D435, Rig, ray_slopes
from conegraph.sim.render.scene import Scene
from conegraph.sim.render.shadows import cast_shadows
from conegraph.sim.render.visible import (
    SeenCone,
    SeenPanel,
    cones_ahead,
    panels_ahead,
)
from conegraph.types import Array, IntArray, Mask


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
    canvas = paint_far(scene, eye, pose_world_car)
    cones = cones_ahead(scene, eye, pose_world_car)
    panels = panels_ahead(scene, eye, pose_world_car)
    upright = [seen.corners_m for seen in panels]
    placed = [seen.cone for seen in cones]
    cast_shadows(canvas, eye, placed, upright, sun_car, scene.light)
    alone = _draw_upright(canvas, eye, scene.light, cones, panels, sun_car)
    color = motion_blur(canvas, eye, (car.u_mps, car.r_radps), scene.light.exposure_s)
    color = develop(color, cut(scene.noise, canvas.label.shape, rng))
    depth = measure_depth(rig.depth, canvas.depth_m, rng)
    frame = RgbdFrame(car.stamp_s, color, depth, rig.camera, rig.mount)
    return frame, _truth(scene, canvas, cones, alone, mount)


def _sun_seen(scene: Scene, pose: Array) -> Array:
    sun = scene.light.sun_direction
    flat = to_child(np.array([0.0, 0.0, pose[2]]), sun[None, :2])[0]
    return np.array([*flat, sun[2]])


def _draw_upright(
    canvas: Canvas,
    eye: Eye,
    light: Light,
    cones: list[SeenCone],
    panels: list[SeenPanel],
    sun_car: Array,
) -> IntArray:
    """Draw everything that stands, far things first; return each cone's own pixels."""
    alone = np.zeros(len(cones), dtype=np.int64)
    row = {id(cone): k for k, cone in enumerate(cones)}
    dim = 0.6 + 0.4 * light.in_shade
    upright: list[SeenCone | SeenPanel] = [*cones, *panels]
    for seen in sorted(upright, key=lambda seen: -seen.away_m):
        if isinstance(seen, SeenPanel):
            draw_panel(canvas, eye, seen.panel, seen.corners_m, dim)
            continue
        own = draw_cone(canvas, eye, seen.cone, seen.window, sun_car, light)
        alone[row[id(seen)]] = own
    return alone


def _truth(
    scene: Scene,
    canvas: Canvas,
    cones: list[SeenCone],
    alone: IntArray,
    mount: CameraMount,
) -> FrameTruth:
    order = np.array([seen.cone.index for seen in cones], dtype=np.int64)
    boxes = np.array([seen.box_px for seen in cones]).reshape(-1, 4)
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
        np.array([seen.cone.xy_m for seen in cones]).reshape(-1, 2),
        scene.cones.cone_class[order],
        cut,
        visible,
        share * visible / np.maximum(alone, 1),
        label,
        mount,
    )
