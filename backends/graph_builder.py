"""From the journal's entries to factors and first values of their variables."""

from __future__ import annotations

from collections.abc import Container

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from conegraph.backends.factors import (
    KNOWN_MAP_SIGMAS,
    ORIGIN_SIGMAS,
    bias_prior,
    bias_walk,
    cone_factors,
    free_motion,
    jump,
    known_cone_prior,
    odometry_motion,
    one_cone,
    start_prior,
    velocity_prior,
)
from conegraph.backends.journal import Entry
from conegraph.backends.motion import yaw_rate_bias_sigma
from conegraph.config import Isam2Config, MotionConfig
from conegraph.types import Array, ConeMap, Mask

Factors = list[gtsam.NonlinearFactor]


class GraphBuilder:
    """Makes the factors of an entry; the same entry gives the same factors."""

    def __init__(
        self, config: Isam2Config, motion: MotionConfig, known: ConeMap | None
    ) -> None:
        """Take noise, kernels and the given map."""
        self._config, self._motion, self._known = config, motion, known
        self._bias_sigma = yaw_rate_bias_sigma(motion)

    @property
    def has_bias(self) -> bool:
        """Whether odometry's yaw-rate bias is part of the graph."""
        return self._bias_sigma > 0.0

    def start(self) -> Factors:
        """Return what is known before the first frame."""
        known = self._known
        sigmas = ORIGIN_SIGMAS if known is None else KNOWN_MAP_SIGMAS
        factors = [start_prior(sigmas)]
        if self.has_bias:
            factors.append(bias_prior(self._bias_sigma))
        if known is not None:
            cones = zip(known.id.tolist(), known.xy_m, known.cov_m2, strict=True)
            factors += [known_cone_prior(cone, xy, cov) for cone, xy, cov in cones]
        return factors

    def motion(self, entry: Entry, pose_before: Array, bias: float) -> Factors:
        """Return what joins an entry to the one before it.

        Args:
            entry: the frame.
            pose_before: (3,) where odometry with a bias is linearised.
            bias: the yaw-rate bias there.
        """
        frame, before, k = entry.frame, entry.before, entry.k
        factors: Factors = []
        if entry.walk_s > 0.0 and self.has_bias:
            walk = self._motion.gyro_bias_walk
            factors.append(bias_walk(entry.segment, entry.walk_s, walk))
        if before is None:
            return factors
        if frame.jump:
            return [*factors, jump(k, before.frame.state[:3], frame.state[:3])]
        if frame.increment is not None:
            at = (entry.segment, bias) if self.has_bias else None
            return [*factors, odometry_motion(k, frame.increment, pose_before, at)]
        if entry.starts_moving:
            doubt = self._motion.start_speed_sigma_mps
            sigmas = np.array([max(doubt, 0.01), max(0.2 * doubt, 0.01)])
            factors.append(velocity_prior(k - 1, before.frame.state[3:5], sigmas))
        step = free_motion(k, before.frame.stamp_s, frame.stamp_s, self._motion)
        return factors + step

    def cones(self, entry: Entry) -> Factors:
        """Return the kept sightings of an entry, in their order."""
        frame, kept = entry.frame, entry.kept
        return list(
            cone_factors(
                entry.k,
                entry.cones,
                frame.xy_m[kept],
                frame.cov_m2[kept],
                self._kernels(frame.vague[kept]),
            )
        )

    def merges(self, entry: Entry, present: Container[int]) -> Factors:
        """Return what an entry says of cones that are one, if both are present."""
        return [
            one_cone(kept, gone)
            for kept, gone in entry.frame.merged
            if kept in present and gone in present
        ]

    def motion_at(self, entry: Entry, values: gtsam.Values) -> Factors:
        """Return what joins an entry to the one before, linearised at the values."""
        pose, bias = np.zeros(3), 0.0
        odometry = entry.frame.increment is not None and not entry.frame.jump
        if entry.before is not None and odometry and self.has_bias:
            pose = pose_array(values.atPose2(X(entry.k - 1)))
            bias = float(values.atVector(B(entry.segment))[0])
        return self.motion(entry, pose, bias)

    def _kernels(self, vague: Mask) -> list[float | None]:
        """Return each sighting's kernel width.

        Cones found again after a drift were tested as a constellation and pull
        without a kernel: one would see the drift as an outlier and let go.
        """
        plain = self._config.robust_kernel == "none"
        width = self._config.robust_width
        return [None if plain or found else width for found in vague.tolist()]


def first_values(entry: Entry, *, has_bias: bool) -> gtsam.Values:
    """Return the tracker's own estimates of an entry's pose, velocity and bias."""
    values, state = gtsam.Values(), entry.frame.state
    values.insert(X(entry.k), gtsam.Pose2(*state[:3]))
    if has_bias and (entry.before is None or entry.walk_s > 0.0):
        bias = 0.0 if entry.before is None else float(state[5])
        values.insert(B(entry.segment), np.array([bias]))
    if entry.starts_moving and entry.before is not None:
        values.insert(V(entry.k - 1), _velocity(entry.before.frame.state))
    if entry.moving:
        values.insert(V(entry.k), _velocity(state))
    return values


def pose_array(pose: gtsam.Pose2) -> Array:
    """(3,) x_m, y_m, yaw_rad of a pose."""
    return np.array([pose.x(), pose.y(), pose.theta()])


def _velocity(state: Array) -> Array:
    return np.array([state[3], 0.0, state[4]])
