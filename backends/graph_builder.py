"""From the journal's entries to factors and first values of their variables."""

from __future__ import annotations

from collections.abc import Container

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

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
    start_velocity_prior,
)
from conegraph.backends.journal import Entry
from conegraph.backends.motion import BLIND_RAD, yaw_rate_bias_sigma
from conegraph.backends.sensor_noise import squared_mahalanobis, transport_covariance
from conegraph.config import Isam2Config, MotionConfig
from conegraph.geometry import to_child
from conegraph.types import Array, ConeMap, Mask, SensorModel

Factors = list[gtsam.NonlinearFactor]

PLAIN_D2 = 13.8
"""Nearer sightings than this need no kernel; 0.999 of chi² at 2."""


class GraphBuilder:
    """Makes the factors of an entry; the same entry gives the same factors."""

    def __init__(
        self,
        config: Isam2Config,
        motion: MotionConfig,
        known: ConeMap | None,
        sensor: SensorModel | None,
    ) -> None:
        """Take noise, kernels and the given map; a sensor, if noise follows range."""
        self._config, self._motion, self._known = config, motion, known
        self._sensor = sensor
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
        step = frame.increment
        if frame.jump or (step is not None and step.cov[2, 2] > BLIND_RAD**2):
            return [*factors, jump(k, before.frame.state[:3], frame.state[:3])]
        if step is not None:
            at = (entry.segment, bias) if self.has_bias else None
            return [*factors, odometry_motion(k, step, pose_before, at)]
        if entry.starts_moving:
            dt_s = frame.stamp_s - before.frame.stamp_s
            speed = before.frame.state[3:5]
            factors.append(start_velocity_prior(k - 1, dt_s, speed, self._motion))
        speed_mps = float(frame.state[3])
        return factors + free_motion(
            k, before.frame.stamp_s, frame.stamp_s, speed_mps, self._motion
        )

    def cones(self, entry: Entry) -> Factors:
        """Return the kept sightings of an entry, in their order.

        Cones found again after a drift were tested as a constellation and pull
        without a kernel: one would see the drift as an outlier and let go.
        """
        kept = entry.kept
        return self._sightings(entry, entry.frame.cov_m2[kept], entry.frame.vague[kept])

    def cones_at(self, entry: Entry, values: gtsam.Values) -> Factors:
        """Return the kept sightings with the noise that the values' ranges give.

        When a frame comes, a new cone's range is known from that very measurement:
        one that fell short looks surer than it is and would draw the map together.
        Sightings that fit the values pull without a kernel, which would cost a
        fiftieth of the accuracy.
        """
        if self._sensor is None or not entry.kept.any():
            return self.cones(entry)
        pose = pose_array(values.atPose2(X(entry.k)))
        cones = np.array([values.atPoint2(L(c)) for c in entry.cones.tolist()])
        xy_m, there_m = entry.frame.xy_m[entry.kept], to_child(pose, cones)
        reported = entry.frame.reported_m2[entry.kept]
        cov = transport_covariance(reported, xy_m, there_m, self._sensor)
        fits = squared_mahalanobis(xy_m - there_m, cov) <= PLAIN_D2
        return self._sightings(entry, cov, fits)

    def _sightings(self, entry: Entry, cov_m2: Array, plain: Mask) -> Factors:
        xy_m = entry.frame.xy_m[entry.kept]
        none = self._config.robust_kernel == "none"
        width = self._config.robust_width
        kernels = [None if none or fits else width for fits in plain.tolist()]
        return list(cone_factors(entry.k, entry.cones, xy_m, cov_m2, kernels))

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
