"""Putting one frame onto another before errors are measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.geometry import compose, inverse, to_parent
from conegraph.types import Array


@dataclass(frozen=True, slots=True)
class Alignment:
    """The rigid motion that was found, and what it left.

    Attributes:
        pose: (3,) x_m, y_m, yaw_rad of the source's frame in the target's frame.
        rmse_m: root mean square distance of the pairs after it, NaN without pairs.
    """

    pose: Array
    rmse_m: float


def align_se2(source_xy_m: Array, target_xy_m: Array) -> Alignment:
    """Return the rotation and translation that bring paired points closest.

    Minimises sum_i |R s_i + t - g_i|^2 without scale. With both sets centred,
    yaw = atan2(sum s x g, sum s . g) and t = mean(g) - R mean(s). Fewer than two
    distinct points fix no yaw: it is then 0, and without points the motion is
    the identity.

    Args:
        source_xy_m: (N, 2) points to move.
        target_xy_m: (N, 2) where each of them should come to lie.

    Source: S. Umeyama, "Least-squares estimation of transformation parameters
    between two point patterns", IEEE PAMI 13(4), 1991; in the plane the singular
    value decomposition becomes one atan2.
    """
    source = np.asarray(source_xy_m, dtype=np.float64)
    target = np.asarray(target_xy_m, dtype=np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 2:
        raise ValueError(f"need two (N, 2) sets, got {source.shape}, {target.shape}")
    if len(source) == 0:
        return Alignment(np.zeros(3), float("nan"))
    s, g = source - source.mean(axis=0), target - target.mean(axis=0)
    cross = np.sum(s[:, 0] * g[:, 1] - s[:, 1] * g[:, 0])
    yaw = float(np.arctan2(cross, np.sum(s * g)))
    turned_mean = to_parent(np.array([0.0, 0.0, yaw]), source.mean(axis=0))
    pose = np.append(target.mean(axis=0) - turned_mean, yaw)
    return Alignment(pose, rms(distance(to_parent(pose, source), target)))


def align_first_pose(source_pose: Array, target_pose: Array) -> Array:
    """Return the source frame's pose (3,) that makes the two poses (3,) coincide."""
    return compose(target_pose, inverse(source_pose))


def distance(a_xy_m: Array, b_xy_m: Array) -> Array:
    """Return the distances (N,) between paired points (N, 2)."""
    return np.hypot(a_xy_m[..., 0] - b_xy_m[..., 0], a_xy_m[..., 1] - b_xy_m[..., 1])


def rms(values: Array) -> float:
    """Return the root mean square, NaN for no values."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
