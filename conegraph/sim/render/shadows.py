"""Shadows of things on the ground, and the dark line under their feet."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.draw_cones import PlacedCone
from conegraph.sim.render.light import Light
from conegraph.sim.render.rig import project
from conegraph.types import Array

_CONTACT = 0.72
_NEAREST_M = 0.3
_LOWEST_SUN = 0.05
_SUB_BITS = 4


def cast_shadows(
    canvas: Canvas,
    eye: Eye,
    cones: list[PlacedCone],
    panels: list[Array],
    sun_car: Array,
    light: Light,
) -> None:
    """Darken the ground where cones and panels take its light.

    Args:
        canvas: holds the ground and nothing on it yet.
        eye: the camera.
        cones: the cones.
        panels: corners (4, 3) of each panel, in the car frame.
        sun_car: (3,) towards the sun, in the car frame.
        light: the light.
    """
    left = np.full(canvas.label.shape, 255, np.uint8)
    feet = [_contact(cone) for cone in cones]
    _darken(left, eye, feet, _CONTACT)
    if light.sun >= 0.3 and sun_car[2] > _LOWEST_SUN:
        away = -sun_car[:2] / sun_car[2]
        fallen = [_fallen(corners, away) for corners in panels]
        fallen += [_fallen(_body(c), away) for c in cones if c.sunlit > 0.5]
        _darken(left, eye, fallen, light.in_shade)
    rows = np.flatnonzero((left < 255).any(axis=1))
    if len(rows):
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        factor = cv2.merge([left[part]] * 3)
        cv2.multiply(canvas.color[part], factor, dst=canvas.color[part], scale=1 / 255)


def _contact(cone: PlacedCone) -> Array:
    """Return the ground (4, 3) that a foot keeps the light from."""
    reach = 0.6 * cone.shape.side_m * np.sqrt(2)
    angle = cone.yaw_rad + np.radians([45, 135, 225, 315])
    corners = cone.xy_m + reach * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([corners, np.zeros(4)])


def _body(cone: PlacedCone) -> Array:
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    shape = cone.shape
    low = np.column_stack([cone.xy_m + shape.base_radius_m * ring, np.zeros(12)])
    top = np.full(12, shape.height_m)
    return np.vstack(
        [low, np.column_stack([cone.xy_m + shape.top_radius_m * ring, top])]
    )


def _fallen(points_m: Array, away: Array) -> Array:
    """Return where on the ground points (N, 3) throw their shadow."""
    flat = points_m[:, :2] + points_m[:, 2:] * away
    return np.column_stack([flat, np.zeros(len(flat))])


def _darken(
    left: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
    eye: Eye,
    outlines: list[Array],
    factor: float,
) -> None:
    """Fill the hulls of outlines on the ground with a factor, as a share of 255."""
    if not outlines:
        return
    pixels, depth = project(eye.camera, eye.mount, np.vstack(outlines))
    cuts = np.cumsum([len(outline) for outline in outlines])[:-1]
    limit = 8.0 * max(left.shape)
    for uv, away in zip(np.split(pixels, cuts), np.split(depth, cuts), strict=True):
        if away.min() < _NEAREST_M or np.abs(uv).max() > limit:
            continue
        fixed = np.round(uv * 2**_SUB_BITS).astype(np.int32)[:, None]
        hull = cv2.convexHull(fixed)
        cv2.fillConvexPoly(left, hull, (255 * factor,), cv2.LINE_AA, _SUB_BITS)
