"""Where a detection stands: depth and the ground ray, fused, with a true covariance.

Two things tell how far a cone is. The row at which it meets the ground, over the
plane that is known there: precise far away, as long as nothing hides the foot. And
the depth inside it: precise up close. Their errors are nearly normal in inverse
range, where they are fused; either is turned from what it sees (the near edge of the
foot, the near side of the body) into the middle of the foot, which is where a cone is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.config import LocalizationConfig
from conegraph.frontend.base import Candidates
from conegraph.frontend.camera import project, rays
from conegraph.frontend.foot import foot_rows
from conegraph.frontend.ground import GroundPlane
from conegraph.frontend.scale import BIG_FOOT_M, FOOT_M, MIN_INVERSE_DEPTH_PER_M
from conegraph.types import Array, IntArray, Mask

FOOT_EDGE_SHARE = 0.58
"""Half the depth of the foot in sides, at the mean over the angles it is turned by."""
BODY_DEPTH_M = 0.045
"""From the mean visible surface of a body to its axis."""
MIN_DEPTH_PIXELS = 3
SURE_DEPTH = 0.1
"""Share of the range up to which depth is sure where it and the ground differ."""
DOUBT_SHARE = 0.5
EVEN_PX, BENT_SHARE = 0.5, 0.5
"""How far a foot's middle may be off the axis, and the share of more that is doubt."""
BEHIND_AT_M = 15.0
"""Range that the configuration's error by cones behind speaks of."""
CROWDED_EDGE_PX, CROWDED_AXIS_M = 1.5, 0.03
"""Errors of the foot's row and of the axis where another cone touches."""
CUT_SIGMA_M = 0.06
"""Error across of a cone that the picture's edge cuts."""
NO_SIGMA = 1e6
"""Standing for "nothing is known" where a finite number is needed."""


@dataclass(frozen=True, slots=True)
class Places:
    """Where candidates stand, row by row.

    Attributes:
        xy_m: (N, 2) middle of the foot in the car frame.
        cov_m2: (N, 2, 2) its covariance.
        range_m: (N,) distance on the ground from the camera.
        range_sigma_m: (N,) its sigma.
        foot_uv: (N, 2) where the axis meets the ground in the picture.
        lift_m: (N,) how high above the ground the lowest pixel is, going by depth.
        lift_sigma_m: (N,) its sigma, large where there is no depth.
    """

    xy_m: Array
    cov_m2: Array
    range_m: Array
    range_sigma_m: Array
    foot_uv: Array
    lift_m: Array
    lift_sigma_m: Array


@dataclass(frozen=True, slots=True)
class _Reading:
    """Inverse ranges (N,) of the feet's middles, in 1/m, and their sigmas."""

    inverse: Array
    sigma: Array


def localize(
    frame: RgbdFrame,
    found: Candidates,
    ground: GroundPlane,
    config: LocalizationConfig,
) -> Places:
    """Place candidates on the ground.

    With q the inverse range of a foot's middle, two readings q_g (ground) and q_d
    (depth) with sigmas s_g and s_d are fused by their weights 1/s^2, unless they
    contradict each other. The covariance is ``(r^2 s_q)^2 e e^T + s_a^2 n n^T`` with e
    the direction, n its normal and s_a the sigma across.

    Args:
        frame: the picture, its depth and lens.
        found: what was found in it.
        ground: the plane of this frame.
        config: the sensor's errors.
    """
    mount = ground.mount(frame.mount)
    direction = _directions(frame, found, mount)
    middle = _foot_columns(frame, found, mount, ground, direction)
    foot_uv = np.column_stack([middle, foot_rows(frame.color, found, middle)])
    by_ground = _ground_reading(frame, found, foot_uv, ground, config)
    by_depth = _depth_reading(frame, found, mount, ground, config)
    fused = _fused(by_ground, by_depth, config.gate_d2)
    range_m = 1.0 / np.maximum(fused.inverse, 1e-3)
    along = range_m**2 * fused.sigma
    across = _across(frame, found, middle, range_m, config)
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    cov = along[:, None, None] ** 2 * direction[:, :, None] * direction[:, None, :]
    cov = cov + across[:, None, None] ** 2 * normal[:, :, None] * normal[:, None, :]
    depth_inverse = np.maximum(by_depth.inverse, 1e-6)
    ratio = by_ground.inverse / depth_inverse
    spread = np.hypot(by_ground.sigma, by_depth.sigma * ratio)
    return Places(
        mount.position_m[:2] + direction * range_m[:, None],
        cov,
        range_m,
        along,
        foot_uv,
        mount.height_m * (1.0 - ratio),
        mount.height_m * spread / depth_inverse,
    )


def _directions(frame: RgbdFrame, found: Candidates, mount: CameraMount) -> Array:
    """Return unit vectors (N, 2) on the ground: any point of an upright axis has it."""
    flat = rays(frame.camera, found.axis_uv) @ mount.rotation_car_optical[:2].T
    unit: Array = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    return unit


def _foot_columns(
    frame: RgbdFrame,
    found: Candidates,
    mount: CameraMount,
    ground: GroundPlane,
    direction: Array,
) -> Array:
    """Return the columns (N,) at which axes meet the ground, near the boxes' bottoms.

    Away from the picture's middle a camera that looks down sees axes lean.
    """
    bottom = np.column_stack([found.box_px[:, [0, 2]].mean(axis=1), found.box_px[:, 3]])
    ray = rays(frame.camera, bottom)
    inverse_depth = np.maximum(ground.inverse_depth(ray), MIN_INVERSE_DEPTH_PER_M)
    flat = ray @ mount.rotation_car_optical[:2].T / inverse_depth[:, None]
    range_m = np.linalg.norm(flat, axis=1, keepdims=True)
    down = np.full((len(found), 1), -mount.height_m)
    foot = np.hstack([direction * range_m, down]) @ mount.rotation_car_optical
    columns: Array = project(frame.camera, foot)[:, 0]
    return columns


def _looks_big(found: Candidates) -> Mask:
    """Say which are orange and clearly higher than wide: big cones are slimmer."""
    width, height = (found.box_px[:, 2:] - found.box_px[:, :2]).T
    orange = found.class_prob[:, 2] + found.class_prob[:, 3] > 0.5
    slim: Mask = orange & (height > 1.6 * width)
    return slim


def _ground_reading(
    frame: RgbdFrame,
    found: Candidates,
    foot_uv: Array,
    ground: GroundPlane,
    config: LocalizationConfig,
) -> _Reading:
    """Read the range from the row of the foot's near edge.

    With ``1/Z = p . ray`` and d the range of the edge, its relative error is that of
    1/Z: from the row ``p_y s_v / f`` and from the plane's covariance. A foot below
    the picture's lower edge tells nothing.
    """
    ray = rays(frame.camera, foot_uv)
    side_m = np.where(_looks_big(found), BIG_FOOT_M, FOOT_M)
    mount = ground.mount(frame.mount)
    inverse_depth = ground.inverse_depth(ray)
    cut = found.box_px[:, 3] >= frame.camera.height_px - 1.5
    seen = (inverse_depth > MIN_INVERSE_DEPTH_PER_M) & ~cut
    inverse_depth = np.maximum(inverse_depth, MIN_INVERSE_DEPTH_PER_M)
    flat = ray @ mount.rotation_car_optical[:2].T
    edge_m = np.hypot(flat[:, 0], flat[:, 1]) / inverse_depth
    edge_px = np.where(found.crowded, CROWDED_EDGE_PX, config.edge_sigma_px)
    row = ground.plane[1] * edge_px / frame.camera.fy_px
    relative = np.sqrt(row**2 + ground.variance(ray)) / inverse_depth
    range_m = edge_m + FOOT_EDGE_SHARE * side_m
    sigma_m = np.hypot(edge_m * relative, config.foot_sigma_m)
    sigma = np.where(seen, sigma_m / range_m**2, NO_SIGMA)
    return _Reading(1.0 / range_m, sigma)


def _depth_reading(
    frame: RgbdFrame,
    found: Candidates,
    mount: CameraMount,
    ground: GroundPlane,
    config: LocalizationConfig,
) -> _Reading:
    """Read the range from the median inverse depth of the cone's pixels.

    Neighbouring pixels err together: n pixels are worth ``n / correlation_px^2``.
    """
    n = len(found)
    u, v = found.pixel_uv.T
    depth = frame.depth_m[v, u].astype(np.float64)
    has = depth > 0
    owner, value = found.owner[has], 1.0 / depth[has]
    median, count = _medians(value, owner, n)
    uv = np.column_stack(
        [
            np.bincount(owner, weights=axis[has], minlength=n) / np.maximum(count, 1)
            for axis in (u, v)
        ]
    )
    flat = rays(frame.camera, uv) @ mount.rotation_car_optical[:2].T
    known = (count >= MIN_DEPTH_PIXELS) & (median > 0)
    inverse_depth = np.where(known, median, 1.0)
    range_m = np.hypot(flat[:, 0], flat[:, 1]) / inverse_depth + BODY_DEPTH_M
    worth = np.maximum(count / config.depth_correlation_px**2, 1.0)
    sigma = ground.noise_per_m / np.sqrt(worth) * _slope(flat, inverse_depth, range_m)
    sigma = np.hypot(sigma, config.foot_sigma_m / range_m**2)
    return _Reading(1.0 / range_m, np.where(known, sigma, NO_SIGMA))


def _slope(flat: Array, inverse_depth: Array, range_m: Array) -> Array:
    """Return how much the inverse range changes with the inverse depth."""
    length = np.hypot(flat[:, 0], flat[:, 1])
    slope: Array = length / (inverse_depth * range_m) ** 2
    return slope


def _medians(value: Array, owner: IntArray, n: int) -> tuple[Array, IntArray]:
    """Return the median (n,) of every owner's values, 0 without any, and the counts."""
    count = np.bincount(owner, minlength=n)
    if not len(value):
        return np.zeros(n), count
    order = np.lexsort((value, owner))
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    last = len(value) - 1
    low = np.minimum(start + np.maximum(count - 1, 0) // 2, last)
    high = np.minimum(start + count // 2, last)
    ranked = value[order]
    middle = 0.5 * (ranked[low] + ranked[high])
    return np.where(count > 0, middle, 0.0), count


def _fused(ground: _Reading, depth: _Reading, gate_d2: float) -> _Reading:
    """Fuse the readings; of two that contradict each other, take the better founded.

    That is depth, because a foot is often hidden or another cone's, unless depth says
    little; some of the gap between them stays as doubt.
    """
    gap = np.abs(ground.inverse - depth.inverse)
    apart = ~(gap**2 <= gate_d2 * (ground.sigma**2 + depth.sigma**2))
    take_depth = depth.sigma <= SURE_DEPTH * depth.inverse
    ground_sigma = np.where(apart & take_depth, NO_SIGMA, ground.sigma)
    depth_sigma = np.where(apart & ~take_depth, NO_SIGMA, depth.sigma)
    weight_ground, weight_depth = ground_sigma**-2, depth_sigma**-2
    total = weight_ground + weight_depth
    inverse = (weight_ground * ground.inverse + weight_depth * depth.inverse) / total
    doubt = np.where(apart, DOUBT_SHARE * gap, 0.0)
    return _Reading(inverse, np.hypot(total**-0.5, doubt))


def _across(
    frame: RgbdFrame,
    found: Candidates,
    middle: Array,
    range_m: Array,
    config: LocalizationConfig,
) -> Array:
    """Return the sigmas (N,) across the direction.

    An axis that the picture's edge cuts away is guessed; one that is not in the middle
    of the foot may be bent by something of the same colour that touches the cone.
    """
    pixel_m = range_m / frame.camera.fx_px
    left, right = found.box_px[:, 0], found.box_px[:, 2]
    cut = (left <= 0.5) | (right >= frame.camera.width_px - 1.5)
    clear = np.hypot(pixel_m * config.center_sigma_px, config.axis_sigma_m)
    clear = np.hypot(clear, config.behind_sigma_m * (range_m / BEHIND_AT_M) ** 2)
    clear = np.hypot(clear, np.where(found.crowded, CROWDED_AXIS_M, 0.0))
    lopsided_px = np.maximum(np.abs(0.5 * (left + right) - middle) - EVEN_PX, 0.0)
    return np.where(
        cut, CUT_SIGMA_M, np.hypot(clear, BENT_SHARE * lopsided_px * pixel_m)
    )
