"""Velocity from cones that two successive frames share (thesis section 4.4.2)."""

from __future__ import annotations

import numpy as np

from conegraph.geometry import inverse, to_parent
from conegraph.types import Array, VelocityObservation


def rigid_fit(from_m: Array, to_m: Array) -> Array:
    """Return the pose (3,) that moves points (k, 2) onto others, in least squares.

    The rotation maximises ``sum to_i . R from_i`` about the centroids (Arun, Huang
    and Blostein 1987, the thesis's reference [1]); in the plane it is one arctan.
    """
    a, b = from_m - from_m.mean(axis=0), to_m - to_m.mean(axis=0)
    cross = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    pose = np.array([0.0, 0.0, np.arctan2(cross, (a * b).sum())])
    pose[:2] = to_m.mean(axis=0) - to_parent(pose, from_m).mean(axis=0)
    return pose


def cone_velocity(
    before_m: Array,
    before_cov_m2: Array,
    now_m: Array,
    now_cov_m2: Array,
    dt_s: float,
    stamp_s: float,
) -> VelocityObservation | None:
    """Measure u and r from at least three cones, not in line, in two frames.

    The cones move against the car: with ``T = rigid_fit(now, before)`` the car
    moved by T, so ``u = t_x / dt`` and ``r = yaw / dt``. The covariance follows
    from the cones' own: that of their mean for the translation, and for the yaw
    their variance over the sum of squared distances from the centroid.

    Args:
        before_m: (k, 2) cones in the car frame of the earlier frame.
        before_cov_m2: (k, 2, 2) their covariances.
        now_m: (k, 2) the same cones now.
        now_cov_m2: (k, 2, 2) their covariances.
        dt_s: time between the frames.
        stamp_s: stamp of the later frame.

    Returns:
        The observation, or None with fewer than three cones or with cones in line.
    """
    k = len(now_m)
    if k < 3 or dt_s <= 0.0:
        return None
    centred = now_m - now_m.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    if spread[1] < 0.1 * max(spread[0], 1e-9):
        return None
    motion = inverse(rigid_fit(before_m, now_m))
    variance = 0.5 * np.einsum("kii->k", before_cov_m2 + now_cov_m2)
    yaw_variance = variance.mean() / float((centred**2).sum())
    lever = float((now_m.mean(axis=0) ** 2).sum())
    shift_variance = variance.mean() / k + lever * yaw_variance
    cov = np.diag([shift_variance, yaw_variance]) / dt_s**2
    return VelocityObservation(
        stamp_s, float(motion[0] / dt_s), float(motion[2] / dt_s), cov
    )
