"""Planar rigid motion: poses are arrays ``(x_m, y_m, yaw_rad)``, last axis 3.

Everything broadcasts over leading axes. Yaw is counter-clockwise in (-pi, pi].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ABOVE_MINUS_PI = np.nextafter(-np.pi, 0.0)


def wrap_angle(angle_rad: Array | float) -> Array:
    """Return the angle(s) in (-pi, pi], same shape as given."""
    turned = np.mod(np.pi - np.asarray(angle_rad, dtype=np.float64), 2 * np.pi)
    # The remainder rounds up to a whole turn for the float just above pi.
    return np.maximum(np.pi - turned, _ABOVE_MINUS_PI)


def rotation(yaw_rad: Array | float) -> Array:
    """Return R with ``p_parent = R p_child``; shape (..., 2, 2)."""
    yaw = np.asarray(yaw_rad, dtype=np.float64)
    turn = np.empty((*yaw.shape, 2, 2))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(yaw)
    turn[..., 1, 0] = np.sin(yaw)
    turn[..., 0, 1] = -turn[..., 1, 0]
    return turn


def compose(pose_a_b: Array, pose_b_c: Array) -> Array:
    """Return ``pose_a_c``; shapes (..., 3) broadcast."""
    a, b = np.asarray(pose_a_b), np.asarray(pose_b_c)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + c * b[..., 0] - s * b[..., 1],
            a[..., 1] + s * b[..., 0] + c * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ],
        -1,
    )


def inverse(pose_a_b: Array) -> Array:
    """Return ``pose_b_a``; shape (..., 3)."""
    a = np.asarray(pose_a_b)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = -c * a[..., 0] - s * a[..., 1]
    y = s * a[..., 0] - c * a[..., 1]
    return np.stack([x, y, wrap_angle(-a[..., 2])], -1)


def between(pose_w_a: Array, pose_w_b: Array) -> Array:
    """Return ``pose_a_b``, the second pose seen from the first; shape (..., 3)."""
    return compose(inverse(pose_w_a), pose_w_b)


def to_parent(pose_a_b: Array, xy_b_m: Array) -> Array:
    """Move points from frame b to frame a: pose (3,), points (N, 2) -> (N, 2)."""
    return xy_b_m @ rotation(pose_a_b[2]).T + pose_a_b[:2]


def to_child(pose_a_b: Array, xy_a_m: Array) -> Array:
    """Move points from frame a to frame b: pose (3,), points (N, 2) -> (N, 2)."""
    return (xy_a_m - pose_a_b[:2]) @ rotation(pose_a_b[2])


def distances(from_m: Array, to_m: Array) -> Array:
    """Return the distance (N, K) of each of the points (N, 2) to each of (K, 2)."""
    gap: Array = np.hypot(
        from_m[:, None, 0] - to_m[:, 0], from_m[:, None, 1] - to_m[:, 1]
    )
    return gap


def constant_twist(u_mps: float, r_radps: float, dt_s: float) -> Array:
    """Return the pose increment of a car holding u and r for dt; shape (3,).

    The chord of the arc: length ``u dt sinc(r dt / 2)`` at half the turn.
    """
    half = 0.5 * r_radps * dt_s
    chord = u_mps * dt_s * np.sinc(half / np.pi)
    return np.array([chord * np.cos(half), chord * np.sin(half), 2.0 * half])
