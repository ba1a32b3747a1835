"""The covariance of a cone's position as a function of where it is.

A detector reports the covariance at the range that it *measured*. Taken as is,
a cone measured too near gets too much weight and the map shrinks; evaluated at
the *predicted* range it does not (the larger of two modelling fixes).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from conegraph.config import MotionConfig, SensorConfig
from conegraph.types import (
    Array,
    ConeObservations,
    SensorModel,
    VelocityObservation,
)


def polar_sigmas(range_m: Array, model: SensorModel) -> tuple[Array, Array]:
    """Return the sigmas along and across the ray, in m, at the ranges (any shape).

    ``s_along^2 = (c0 + c1 r + c2 r^2)^2 + floor^2``,
    ``s_across^2 = (r s_bearing)^2 + floor^2``.
    """
    c0, c1, c2 = model.range_sigma_m
    floor2 = model.floor_m**2
    along = np.sqrt((c0 + c1 * range_m + c2 * range_m**2) ** 2 + floor2)
    across = np.sqrt((range_m * model.bearing_sigma_rad) ** 2 + floor2)
    return along, across


def transport_covariance(
    cov_m2: Array, measured_m: Array, predicted_m: Array, model: SensorModel
) -> Array:
    """Move reported covariances from the measured to the predicted position.

    Along and across the ray the sigmas are scaled by the model's ratio between
    the two ranges, so that a covariance equal to the model's at the measured
    position becomes the model's at the predicted one, while a detector's own
    judgement of a single cone is kept. Shapes (N, 2, 2), (N, 2), (N, 2).
    """
    xy_m = np.array([measured_m, predicted_m])
    range_m = np.hypot(xy_m[..., 0], xy_m[..., 1])
    old, new = _axes(xy_m, range_m)
    range_m[1] = np.maximum(range_m[1], model.min_range_m)
    along, across = polar_sigmas(range_m, model)
    new[:, :, 0] *= (along[1] / along[0])[:, None]
    new[:, :, 1] *= (across[1] / across[0])[:, None]
    move = new @ old.transpose(0, 2, 1)
    moved: Array = move @ cov_m2 @ move.transpose(0, 2, 1)
    return moved


def squared_mahalanobis(error_m: Array, cov_m2: Array) -> Array:
    """Return ``e' C^-1 e`` of errors (..., 2) with covariances (..., 2, 2)."""
    white = np.linalg.solve(cov_m2, error_m[..., None])[..., 0]
    d2: Array = (error_m * white).sum(axis=-1)
    return d2


def bearing_range_covariance(cov_m2: Array, xy_m: Array) -> Array:
    """Return covariances (N, 2, 2) in (bearing_rad, range_m) at positions (N, 2)."""
    x, y = xy_m[:, 0], xy_m[:, 1]
    r2 = np.maximum(x * x + y * y, 1e-12)
    r = np.sqrt(r2)
    jac = np.stack([np.stack([-y / r2, x / r2], -1), np.stack([x / r, y / r], -1)], -2)
    cov: Array = jac @ cov_m2 @ jac.transpose(0, 2, 1)
    return cov


def _axes(xy_m: Array, range_m: Array) -> Array:
    """Return (..., 2, 2) with the unit vectors along and across the ray as columns."""
    axes = np.empty((*range_m.shape, 2, 2))
    axes[..., 0] = xy_m / np.maximum(range_m, 1e-9)[..., None]
    axes[..., 0, 1], axes[..., 1, 1] = -axes[..., 1, 0], axes[..., 0, 0]
    return axes


GENERIC = SensorModel(np.array([0.05, 0.0, 0.0025]), 0.01)
"""A stereo camera of usual quality, for sources that say nothing of their sensor."""


def effective_sensor(config: SensorConfig, source: SensorModel | None) -> SensorModel:
    """Lay the configured keys over what the source knows, else over `GENERIC`."""
    base = source or GENERIC
    given = {
        key: getattr(config, key)
        for key in (
            "range_sigma_m",
            "bearing_sigma_rad",
            "floor_m",
            "max_range_m",
            "half_fov_rad",
            "detection_probability",
        )
        if getattr(config, key) is not None
    }
    return replace(base, **given)


def with_configured_noise(
    frame: ConeObservations, config: SensorConfig, model: SensorModel
) -> ConeObservations:
    """Return a frame with the covariances that the configuration asks for.

    Args:
        frame: the frame as the source reports it.
        config: whose covariances count, and the factor on their sigmas.
        model: the sensor of `effective_sensor`.
    """
    cov = frame.cov_m2
    if config.noise_from == "model":
        cov = model.covariance(frame.xy_m)
    elif config.scale == 1.0:
        return frame
    return replace(frame, cov_m2=cov * config.scale**2)


def with_scaled_odometry(
    sample: VelocityObservation, config: MotionConfig
) -> VelocityObservation:
    """Return a velocity with its sigmas scaled as configured."""
    if config.odometry_scale == (1.0, 1.0):
        return sample
    u, r = config.odometry_scale
    scale = np.array([[u * u, u * r], [u * r, r * r]])
    return replace(sample, cov=sample.cov * scale)
