"""A sensor model fitted to the covariances that a detector reported.

A back end wants a cone's sigma at the *predicted* range, but a log only has the
covariance that was reported at the measured one. The fit turns the second into a
function of range that can be evaluated anywhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from conegraph.io.csv_table import Mask
from conegraph.types import Array, SensorModel

NEAREST_M = 1e-3
FARTHEST_M = 1e3
TAIL = 1e-3
"""Share of the cones at either end that does not set the view's limits."""

WIDEN = 0.05
WIDEN_RAD = 0.02
"""How much wider than the reported cones the view is taken to be."""

SMALLEST_SIGMA_M = 1e-9


def fit_sensor_model(xy_m: Array, cov_m2: Array) -> SensorModel | None:
    """Fit range and bearing sigmas to reported covariances.

    Each covariance is turned to the direction of its cone. Across it, the fit is
    ``v_across = (r sigma_b)^2 + floor^2``; along it, what the floor leaves is
    ``sqrt(v_along - floor^2) = c0 + c1 r + c2 r^2``. Both are linear least squares
    with coefficients that cannot be negative (Lawson and Hanson), each row divided
    by its value, so that relative errors count. Correlation between range and
    bearing is not modelled. The view is that of `model_seeing`.

    Args:
        xy_m: (N, 2) positions in the car frame.
        cov_m2: (N, 2, 2) covariances there, symmetric positive definite.

    Returns:
        The model, None where no cone is at a usable range.
    """
    xy_m, cov_m2 = np.asarray(xy_m), np.asarray(cov_m2)
    r = np.hypot(xy_m[:, 0], xy_m[:, 1])
    usable = _usable(r)
    if not usable.any():
        return None
    r, xy_m, cov_m2 = r[usable], xy_m[usable], cov_m2[usable]
    ray = xy_m / r[:, None]
    normal = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
    along = np.einsum("ni,nij,nj->n", ray, cov_m2, ray)
    across = np.einsum("ni,nij,nj->n", normal, cov_m2, normal)

    floor2, bearing2 = _fit_relative(np.stack([np.ones_like(r), r * r]), across)
    if floor2 > along.min():
        floor2 = float(along.min())
        rest = np.maximum(across - floor2, 0.0)
        bearing2 = _fit_relative((r * r)[None], rest, scale=across)[0]
    sigma = np.sqrt(np.maximum(along - floor2, 0.0))
    range_sigma = _fit_relative(
        np.stack([np.ones_like(r), r, r * r]), sigma, scale=np.sqrt(along)
    )
    model = SensorModel(
        range_sigma_m=range_sigma,
        bearing_sigma_rad=float(np.sqrt(bearing2)),
        floor_m=float(np.sqrt(floor2)),
    )
    return model_seeing(model, xy_m)


def model_seeing(model: SensorModel, xy_m: Array) -> SensorModel:
    """Return the model with the view that cones at (N, 2) were reported in.

    The limits are the 0.1 % and 99.9 % quantiles of the cones, slightly widened;
    they stay as they are where there is no cone at a usable range.
    """
    r = np.hypot(xy_m[:, 0], xy_m[:, 1])
    usable = _usable(r)
    if not usable.any():
        return model
    near, far = np.quantile(r[usable], [TAIL, 1.0 - TAIL])
    bearing = np.arctan2(xy_m[usable, 1], xy_m[usable, 0])
    side = float(np.quantile(np.abs(bearing), 1.0 - TAIL))
    return replace(
        model,
        min_range_m=float(near) * (1.0 - WIDEN),
        max_range_m=float(far) * (1.0 + WIDEN),
        half_fov_rad=min(side * (1.0 + WIDEN) + WIDEN_RAD, np.pi),
    )


def _usable(range_m: Array) -> Mask:
    return (range_m >= NEAREST_M) & (range_m <= FARTHEST_M)


def _fit_relative(basis: Array, value: Array, scale: Array | None = None) -> Array:
    """Return x >= 0 that minimises the sum of ((basis.T x - value) / scale)^2.

    Shapes: basis (K, N), value (N,), scale (N,) or None for the value itself.
    """
    from scipy.optimize import nnls

    weight = 1.0 / np.maximum(value if scale is None else scale, SMALLEST_SIGMA_M)
    system = (basis * weight).T
    size = np.linalg.norm(system, axis=0)
    size[size == 0.0] = 1.0
    # A triangular system of K rows has the same solution as the N rows.
    q, triangular = np.linalg.qr(system / size)
    solution, _ = nnls(triangular, q.T @ (value * weight))
    return np.asarray(solution / size, dtype=np.float64)
