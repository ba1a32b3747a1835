"""Cones, ray by ray: a cut-off circular cone on a square foot."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.sim.render.canvas import Canvas, Eye
from conegraph.sim.render.cone_shape import PLATE_M, ConeShape
from conegraph.sim.render.light import GAMMA, Light
from conegraph.sim.render.paint import Floats, to_bytes
from conegraph.types import Array

_SKY_BELOW = 0.55
"""Light that comes back from the ground, as a share of that from the sky."""


@dataclass(frozen=True, slots=True)
class PlacedCone:
    """A cone as the camera meets it.

    Attributes:
        index: its row in the scene.
        xy_m: (2,) where it stands in the car frame.
        yaw_rad: how its foot is turned in the car frame.
        shape: its shape.
        body: (3,) its colour.
        stripes: (S, 3) the colours of its stripes.
        sunlit: how much of the sun reaches it.
    """

    index: int
    xy_m: Array
    yaw_rad: float
    shape: ConeShape
    body: Floats
    stripes: Floats
    sunlit: float


@dataclass(frozen=True, slots=True)
class Hits:
    """Where rays meet a cone: (h, w) arrays in the frame of its foot.

    Attributes:
        t: depth along the optical axis, infinite where the ray misses.
        body: whether it is the round body that is met.
        height_m: height of the point.
        normal: (h, w) components x, y, z of the surface's normal.
    """

    t: Floats
    body: NDArray[np.bool_]
    height_m: Floats
    normal: tuple[Floats, Floats, Floats]


def draw_cone(
    canvas: Canvas,
    eye: Eye,
    cone: PlacedCone,
    window: tuple[int, int, int, int],
    sun_car: Array,
    light: Light,
) -> int:
    """Draw a cone over what is there already.

    Args:
        canvas: what to draw into.
        eye: the camera.
        cone: the cone.
        window: pixels u0, v0, u1, v1 (exclusive) inside the picture that hold it.
        sun_car: (3,) towards the sun, in the car frame.
        light: the light.

    Returns:
        How many pixels of the picture it covers, with nothing before it.
    """
    u0, v0, u1, v1 = window
    samples = 3 if v1 - v0 < 80 else 2 if v1 - v0 < 200 else 1
    turn = _turn(cone.yaw_rad)
    to_foot = (turn @ eye.mount.rotation_car_optical).astype(np.float32)
    offset = eye.mount.position_m - np.array([*cone.xy_m, 0.0])
    origin = (turn @ offset).astype(np.float32)
    x, y = _sampled(eye, window, samples)
    rays = tuple(
        to_foot[k, 0] * x + to_foot[k, 1] * y + to_foot[k, 2] for k in range(3)
    )
    hits = cast(cone.shape, origin, (rays[0], rays[1], rays[2]))
    met = np.isfinite(hits.t)
    color = _shaded(cone, hits, (turn @ sun_car).astype(np.float32), light)
    size = (u1 - u0, v1 - v0)
    cover = met.astype(np.float32)
    if samples > 1:
        color = np.asarray(
            cv2.resize(color * cover[..., None], size, interpolation=cv2.INTER_AREA)
        )
        cover = np.asarray(cv2.resize(cover, size, interpolation=cv2.INTER_AREA))
    else:
        color = color * cover[..., None]
    patch = canvas.color[v0:v1, u0:u1]
    patch[...] = to_bytes(patch * (1 - cover[..., None]) + color)
    # The middle sample of an odd number is the pixel's centre.
    middle = samples // 2
    depth = hits.t[middle::samples, middle::samples]
    mine = (cover >= 0.5) & np.isfinite(depth)
    canvas.depth_m[v0:v1, u0:u1][mine] = depth[mine]
    canvas.label[v0:v1, u0:u1][mine] = cone.index
    return int(mine.sum())


def _turn(yaw_rad: float) -> Array:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _sampled(
    eye: Eye, window: tuple[int, int, int, int], samples: int
) -> tuple[Floats, Floats]:
    """Return ray slopes at several points of each pixel of a window."""
    u0, v0, u1, v1 = window
    x, y = eye.slope_x[v0:v1, u0:u1], eye.slope_y[v0:v1, u0:u1]
    if samples == 1:
        return x, y
    inside = ((np.arange(samples) + 0.5) / samples - 0.5).astype(np.float32)
    x = x.repeat(samples, 0).repeat(samples, 1)
    y = y.repeat(samples, 0).repeat(samples, 1)
    x = x + np.tile(inside / np.float32(eye.camera.fx_px), u1 - u0)
    y = y + np.tile(inside / np.float32(eye.camera.fy_px), v1 - v0)[:, None]
    return x, y


def cast(
    shape: ConeShape, origin_m: Floats, rays: tuple[Floats, Floats, Floats]
) -> Hits:
    """Return where rays first meet a cone that stands at the origin.

    The body's radius is ``r(z) = a + b z``. On a ray p = o + t d it is met where
    ``px^2 + py^2 = (a + b pz)^2``, a quadratic in t; the foot is met where the ray
    is inside its three slabs at once.

    Args:
        shape: the cone.
        origin_m: (3,) where the rays begin, outside the cone and above the ground.
        rays: their directions x, y, z, each (h, w).
    """
    ox, oy, oz = (np.float32(v) for v in origin_m)
    dx, dy, dz = rays
    rise = shape.height_m - PLATE_M
    b = np.float32((shape.top_radius_m - shape.base_radius_m) / rise)
    a = np.float32(shape.base_radius_m - b * PLATE_M)
    at = a + b * oz
    quad = dx * dx + dy * dy - (b * dz) ** 2
    half = ox * dx + oy * dy - (at * b) * dz
    rest = ox * ox + oy * oy - at * at
    root = half * half - quad * rest
    real = root > 0
    near = (-half - np.sqrt(np.where(real, root, 0))) / quad
    level = oz + near * dz
    on_body = real & (level > PLATE_M) & (level < shape.height_m) & (near > 0)
    t_body = np.where(on_body, near, np.float32(np.inf))
    t_flat = np.minimum(_foot(shape, origin_m, rays), _top(shape, origin_m, rays))
    t = np.minimum(t_body, t_flat)
    body = on_body & (t_body <= t_flat)
    reach = np.where(np.isfinite(t), t, 0)
    px, py, pz = ox + reach * dx, oy + reach * dy, oz + reach * dz
    lean = np.float32(1 / np.sqrt(1 + b * b))
    scale = np.where(body, lean / np.maximum(np.sqrt(px * px + py * py), 1e-4), 0)
    up = np.where(body, -b * lean, _foot_up(pz, px, py, shape))
    return Hits(t.astype(np.float32), body, pz, (px * scale, py * scale, up))


def _foot_up(pz: Floats, px: Floats, py: Floats, shape: ConeShape) -> Floats:
    """Return how much a flat face looks up: the foot's sides look aside."""
    top = (pz > PLATE_M - 1e-3) | (pz > shape.height_m - 1e-3)
    return np.where(top, np.float32(1.0), np.float32(0.2))


def _foot(
    shape: ConeShape, origin: Floats, rays: tuple[Floats, Floats, Floats]
) -> Floats:
    """Return the depth at which rays enter the foot, infinite where they miss."""
    half = shape.side_m / 2
    bounds = ((-half, half), (-half, half), (0.0, PLATE_M))
    enter, leave = np.float32(-np.inf), np.float32(np.inf)
    for o, d, (low, high) in zip(origin, rays, bounds, strict=True):
        inverse = 1 / np.where(np.abs(d) < 1e-9, np.float32(1e-9), d)
        first, second = (
            (np.float32(low) - o) * inverse,
            (np.float32(high) - o) * inverse,
        )
        enter = np.maximum(enter, np.minimum(first, second))
        leave = np.minimum(leave, np.maximum(first, second))
    missed = np.float32(np.inf)
    return np.where((enter < leave) & (enter > 0), enter, missed)


def _top(
    shape: ConeShape, origin: Floats, rays: tuple[Floats, Floats, Floats]
) -> Floats:
    """Return the depth at which rays meet the top's disc from above."""
    dx, dy, dz = rays
    drop = np.where(np.abs(dz) < 1e-9, np.float32(1e-9), dz)
    t = (np.float32(shape.height_m) - origin[2]) / drop
    x, y = origin[0] + t * dx, origin[1] + t * dy
    met = (t > 0) & (x * x + y * y < np.float32(shape.top_radius_m) ** 2)
    return np.where(met, t, np.float32(np.inf))


def _shaded(cone: PlacedCone, hits: Hits, sun: Floats, light: Light) -> Floats:
    """Return colours (h, w, 3) of what the rays meet, as lit.

    Light on a face is the sun's share by Lambert's law and the sky's by how much it
    looks up; sunlit level ground is the unit.
    """
    color = np.broadcast_to(cone.body, (*hits.t.shape, 3)).copy()
    share = hits.height_m / np.float32(cone.shape.height_m)
    for (low, high, _), stripe in zip(cone.shape.stripes, cone.stripes, strict=True):
        color[hits.body & (share > low) & (share < high)] = stripe
    nx, ny, nz = hits.normal
    facing = np.maximum(nx * sun[0] + ny * sun[1] + nz * sun[2], 0)
    from_sky = light.sky * ((1 + _SKY_BELOW) / 2 + (1 - _SKY_BELOW) / 2 * nz)
    direct = np.float32(light.sun * cone.sunlit)
    total = (from_sky + direct * (facing + 0.12)) / np.float32(light.on_ground)
    factor = np.power(total.astype(np.float32), np.float32(1 / GAMMA))
    shown: Floats = color * factor[..., None]
    return shown
