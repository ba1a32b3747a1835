"""The factors of the cone graph, all native to gtsam: no Python in its solver.

Variables: pose ``x_k`` (Pose2) of every frame, body velocity ``v_k`` (u, v, r)
where no odometry spans the interval, cone ``l_i`` (Point2), and the yaw-rate bias
``b_j`` of the odometry in each stretch of time.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from conegraph.backends.motion import LONGEST_DOUBT_S, OdometryIncrement
from conegraph.backends.sensor_noise import bearing_range_covariance
from conegraph.config import MotionConfig
from conegraph.types import Array, IntArray

ORIGIN_SIGMAS = np.array([1e-3, 1e-3, 1e-4])
"""The first frame is the world; a weaker anchor lets the whole map sway."""

KNOWN_MAP_SIGMAS = np.array([0.5, 0.5, 0.1])
"""On a given map the car starts near its origin, but not exactly there."""

UNKNOWN_SPEED = 20.0
"""Sigma in m/s and rad/s of a speed of which nothing is said."""

LEAST_SLIP_MPS = 0.005
"""Sideways speed of a car that stands: an exact zero would be too stiff."""

SIDEWAYS_DENSITY = 0.05
"""Power spectral density of the sideways acceleration, m^2/s^3."""

SHORT_STEP = np.array([1e-8, 1e-8, 1e-9])
"""Variances (m^2, m^2, rad^2) of a step between frames that almost coincide."""

ONE_CONE_SIGMA_M = 0.003
"""How exactly two variables that are one cone coincide."""

JUMP_SIGMAS = np.array([20.0, 20.0, 2.0])
"""A car that was carried may be anywhere; this only keeps its pose determined. Doubt
4096 times as wide as what ties the cones then mapped together is too much for gtsam."""


def start_prior(sigmas: Array) -> gtsam.NonlinearFactor:
    """Hold pose ``x_0`` at the origin, sigmas (3,) in m, m, rad."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return gtsam.PriorFactorPose2(X(0), gtsam.Pose2(), noise)


def bias_prior(sigma_radps: float) -> gtsam.NonlinearFactor:
    """Hold the first yaw-rate bias near zero."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma_radps)
    return gtsam.PriorFactorVector(B(0), np.zeros(1), noise)


def bias_walk(segment: int, dt_s: float, walk: float) -> gtsam.NonlinearFactor:
    """Join the bias of a segment to that of the segment before."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, walk * np.sqrt(dt_s))
    return gtsam.BetweenFactorVector(B(segment - 1), B(segment), np.zeros(1), noise)


def known_cone_prior(cone: int, xy_m: Array, cov_m2: Array) -> gtsam.NonlinearFactor:
    """Hold a cone of a given map where the map has it."""
    noise = gtsam.noiseModel.Gaussian.Covariance(cov_m2)
    return gtsam.PriorFactorPoint2(L(cone), xy_m, noise)


def velocity_prior(k: int, velocity: Array, sigmas: Array) -> gtsam.NonlinearFactor:
    """Hold the body velocity ``v_k`` (u, 0, r) near one (2,), by sigmas (3,)."""
    mean = np.array([velocity[0], 0.0, velocity[1]])
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return gtsam.PriorFactorVector(V(k), mean, noise)


def start_velocity_prior(
    k: int, dt_s: float, velocity: Array, motion: MotionConfig
) -> gtsam.NonlinearFactor:
    """Hold ``v_k``, where free motion starts, near a speed and yaw rate (2,).

    Args:
        k: the frame.
        dt_s: length of the step that it starts.
        velocity: (2,) forward speed and yaw rate.
        motion: how the car moves.
    """
    doubt, slip = motion.start_speed_sigma_mps, _slip_mps(velocity[0], dt_s, motion)
    sigmas = np.array([max(doubt, 0.01), slip, max(0.2 * doubt, 0.01)])
    return velocity_prior(k, velocity, sigmas)


def _slip_mps(speed_mps: float, dt_s: float, motion: MotionConfig) -> float:
    """Sigma of a sideways speed that slips ``slip sqrt(|u| dt)`` in a step dt."""
    slip = motion.slip_sigma_m_per_sqrt_m * np.sqrt(abs(speed_mps) / dt_s)
    return max(float(slip), LEAST_SLIP_MPS)


def free_motion(
    k: int, before_s: float, now_s: float, speed_mps: float, motion: MotionConfig
) -> list[gtsam.NonlinearFactor]:
    """Join ``x_{k-1}, v_{k-1}`` and ``x_k, v_k`` by white noise on acceleration.

    The accelerations of the EKF's process noise, constant over a step dt, have the
    spectral densities ``sigma^2 dt``. (Barfoot, Tong and Sarkka, "Batch continuous-
    time trajectory estimation as exactly sparse Gaussian process regression", 2014.)
    The variance of a step's place is ``density dt^3 / 3``, and at least `SHORT_STEP`:
    two frames a microsecond apart would leave the solver a singular system. A step is
    taken for no longer than `LONGEST_DOUBT_S`: the doubt is then as wide as the track,
    and one of an hour leaves a singular system too. Sideways the wheels walk by the
    configured slip: in a step by ``slip sqrt(|u| dt)``, a velocity of that over dt.

    Args:
        k: the later frame.
        before_s: stamp of the earlier.
        now_s: stamp of the later.
        speed_mps: about the car's forward speed.
        motion: how the car moves.
    """
    dt = min(now_s - before_s, LONGEST_DOUBT_S)
    density = np.array(
        [
            motion.accel_sigma_mps2**2 * dt,
            SIDEWAYS_DENSITY,
            motion.yaw_accel_sigma_radps2**2 * dt,
        ]
    )
    density = np.maximum(density, 3.0 * SHORT_STEP / dt**3)
    before = gtsam.StateData(X(k - 1), V(k - 1), now_s - dt)
    now = gtsam.StateData(X(k), V(k), now_s)
    sideways = _slip_mps(speed_mps, dt, motion)
    straight = gtsam.noiseModel.Diagonal.Sigmas(
        np.array([UNKNOWN_SPEED, sideways, UNKNOWN_SPEED])
    )
    return [
        gtsam.WnoaMotionFactorPose2(before, now, density),
        gtsam.PriorFactorVector(V(k), np.zeros(3), straight),
    ]


def jump(k: int, before: Array, now: Array) -> gtsam.NonlinearFactor:
    """Join ``x_{k-1}`` and ``x_k``, poses (3,), by next to nothing."""
    moved = gtsam.Pose2(*before).between(gtsam.Pose2(*now))
    noise = gtsam.noiseModel.Diagonal.Sigmas(JUMP_SIGMAS)
    return gtsam.BetweenFactorPose2(X(k - 1), X(k), moved, noise)


def odometry_motion(
    k: int,
    increment: OdometryIncrement,
    before: Array,
    bias: tuple[int, float] | None,
) -> gtsam.NonlinearFactor:
    """Join ``x_{k-1}`` and ``x_k`` by integrated odometry, and the bias to both.

    Without a bias a plain `BetweenFactorPose2`. With one, the residual
    ``Log(d(b)^-1 x_{k-1}^-1 x_k)``, ``d(b) = delta + J b``, is linearised where the
    tracker was, at ``before`` (3,) and the given bias (its segment and value). Its
    Jacobians ``-Ad(d^-1), I, -R(d)' J`` do not depend on where in the world the
    poses are: a closure that turns the map by t leaves an error ``|d| t^2 / 2``.
    A bias that the increment shows by itself is one row more.
    """
    cov = increment.cov
    if bias is None:
        noise = gtsam.noiseModel.Gaussian.Covariance(_body_cov(increment.delta, cov))
        return gtsam.BetweenFactorPose2(
            X(k - 1), X(k), gtsam.Pose2(*increment.delta), noise
        )
    segment, value = bias
    moved = increment.delta + increment.bias_jacobian * value
    step = gtsam.Pose2(*moved)
    turn = np.eye(3)
    turn[:2, :2] = step.rotation().matrix().T
    whiten = np.linalg.inv(np.linalg.cholesky(_body_cov(moved, cov)))
    by_bias = whiten @ -(turn @ increment.bias_jacobian)[:, None]
    by_before, by_now = -whiten @ step.inverse().AdjointMap(), whiten
    target = np.zeros(3)
    if increment.bias is not None:
        seen, sigma = increment.bias
        by_before = np.vstack([by_before, np.zeros(3)])
        by_now = np.vstack([by_now, np.zeros(3)])
        by_bias = np.vstack([by_bias, [[1.0 / sigma]]])
        target = np.array([0.0, 0.0, 0.0, (seen - value) / sigma])
    linear = gtsam.JacobianFactor(
        X(k - 1),
        by_before,
        X(k),
        by_now,
        B(segment),
        by_bias,
        target,
        gtsam.noiseModel.Unit.Create(len(target)),
    )
    at = gtsam.Values()
    at.insert(X(k - 1), gtsam.Pose2(*before))
    at.insert(X(k), gtsam.Pose2(*before).compose(step))
    at.insert(B(segment), np.array([value]))
    return gtsam.LinearContainerFactor(linear, at)


def _body_cov(delta: Array, cov: Array) -> Array:
    """Turn the covariance (3, 3) of an increment into its end's body frame."""
    c, s = np.cos(delta[2]), np.sin(delta[2])
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    rotated: Array = turn @ cov @ turn.T
    return rotated


def cone_factors(
    k: int, cone: IntArray, xy_m: Array, cov_m2: Array, kernels: Sequence[float | None]
) -> Sequence[gtsam.NonlinearFactor]:
    """Join ``x_k`` to cones by bearing and range with their full 2x2 covariance.

    Args:
        k: the frame.
        cone: (n,) ids.
        xy_m: (n, 2) where they were seen, car frame.
        cov_m2: (n, 2, 2) their covariances there.
        kernels: (n,) width of a Cauchy kernel ``w = 1 / (1 + (e/c)^2)``, or None.
    """
    bearing = np.arctan2(xy_m[:, 1], xy_m[:, 0])
    range_m = np.hypot(xy_m[:, 0], xy_m[:, 1])
    cov = bearing_range_covariance(cov_m2, xy_m)
    return [
        gtsam.BearingRangeFactor2D(
            X(k),
            L(int(cone[i])),
            gtsam.Rot2(bearing[i]),
            range_m[i],
            _cone_noise(cov[i], kernels[i]),
        )
        for i in range(len(cone))
    ]


def _cone_noise(cov: Array, kernel: float | None) -> gtsam.noiseModel.Base:
    noise = gtsam.noiseModel.Gaussian.Covariance(cov)
    if kernel is None:
        return noise
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(kernel)
    return gtsam.noiseModel.Robust.Create(cauchy, noise)


def one_cone(kept: int, gone: int) -> gtsam.NonlinearFactor:
    """Say that two variables are the same cone."""
    noise = gtsam.noiseModel.Isotropic.Sigma(2, ONE_CONE_SIGMA_M)
    return gtsam.BetweenFactorPoint2(L(kept), L(gone), np.zeros(2), noise)
