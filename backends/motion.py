"""How the car moves between frames: random walk or integrated odometry.

The car's state is ``[x, y, psi, u, r, b]``: pose in the world, forward speed and
yaw rate (thesis section 4.1), and the bias of odometry's yaw rate. Without a
prior on the bias (thesis profile, no odometry) its variance is zero and the
state is the thesis's five.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.config import MotionConfig
from conegraph.geometry import rotation, wrap_angle
from conegraph.types import Array, VelocityObservation

NV = 6
"""Length of the car's state."""


STEP_FLOOR_M2 = 1e-7
STEP_FLOOR_RAD2 = 1e-8
"""Variances of the smallest step: exact ones break solvers. The first is added to a
position, which may hang on the heading alone; a heading has at least the second: a
good gyro's noise is no more than that, and added up it would be felt."""

LONGEST_DOUBT_S = 5.0
"""Doubt grows no further than over this: the car is then anywhere on the track, and
variances much greater than that drown the sensor's in rounding."""

BLIND_RAD = 1.0
"""A heading less sure than this is not known. The covariance of odometry that says no
more, after a gap of seconds, spans so many orders of magnitude that no solver can use
it."""

CHEAP_GYRO_RADPS = 0.01
"""Sigma of the yaw-rate bias where neither source nor configuration tells."""


def yaw_rate_bias_sigma(config: MotionConfig) -> float:
    """Return the prior's sigma on the odometry's yaw-rate bias; 0 leaves it out."""
    if not (config.use_odometry and config.odometry_as_input):
        return 0.0
    given = config.gyro_bias_sigma_radps
    return CHEAP_GYRO_RADPS if given is None else given


@dataclass(frozen=True, slots=True)
class Prediction:
    """The car's state one step later: mean (6,), Jacobian F and noise Q (6, 6)."""

    state: Array
    F: Array
    Q: Array


@dataclass(frozen=True, slots=True)
class OdometryIncrement:
    """Odometry integrated over an interval, in the car frame at its start.

    Attributes:
        dt_s: length of the interval.
        delta: (3,) pose increment with the yaw rate as measured.
        cov: (3, 3) its covariance.
        bias_jacobian: (3,) derivative of `delta` by the yaw-rate bias.
        velocity: (2,) the last sample, u and r as measured.
        velocity_cov: (2, 2) its covariance.
        bias: the yaw-rate bias and its sigma, where the car stood and the gyro showed
            nothing else; independent of the rest. None otherwise.
    """

    dt_s: float
    delta: Array
    cov: Array
    bias_jacobian: Array
    velocity: Array
    velocity_cov: Array
    bias: tuple[float, float] | None = None


def predict_midpoint(state: Array, dt_s: float, config: MotionConfig) -> Prediction:
    """Integrate the velocities at the middle of the step.

    ``x += u cos(h) dt, y += u sin(h) dt, psi += r dt`` with ``h = psi + r dt/2``.
    Noise is a forward acceleration ``a`` and a yaw acceleration ``alpha``, each
    constant over the step: ``Q = g_a g_a' s_a^2 + g_alpha g_alpha' s_alpha^2``.
    """
    _, _, psi, u, r, _ = state
    move_s = min(dt_s, config.max_step_s)
    heading = psi + 0.5 * r * move_s
    c, s = np.cos(heading), np.sin(heading)
    new, F = _moved_along(state, c, s, move_s)
    F[0, 4], F[1, 4] = 0.5 * move_s * F[0, 2], 0.5 * move_s * F[1, 2]
    doubt_s = min(dt_s, LONGEST_DOUBT_S)
    half = 0.5 * doubt_s**2
    g_a = np.array([c * half, s * half, 0.0, doubt_s, 0.0, 0.0])
    turn = u * doubt_s**3 / 6.0
    g_alpha = np.array([-s * turn, c * turn, half, 0.0, doubt_s, 0.0])
    Q = g_a[:, None] * g_a * config.accel_sigma_mps2**2
    Q += g_alpha[:, None] * g_alpha * config.yaw_accel_sigma_radps2**2
    slip = config.slip_sigma_m_per_sqrt_m**2 * abs(u) * doubt_s
    Q[:2, :2] += slip * np.array([[s * s, -s * c], [-s * c, c * c]])
    return Prediction(new, F, Q)


def predict_euler(state: Array, dt_s: float, config: MotionConfig) -> Prediction:
    """Integrate with the heading at the start of the step (thesis section 4.3).

    ``x += u cos(psi) dt, y += u sin(psi) dt, psi += r dt``; u and r are random
    walks. The thesis leaves the diagonal Q open; here it is what the configured
    accelerations do to each state over the step.
    """
    move_s = min(dt_s, config.max_step_s)
    new, F = _moved_along(state, np.cos(state[2]), np.sin(state[2]), move_s)
    a, alpha = config.accel_sigma_mps2, config.yaw_accel_sigma_radps2
    doubt_s = min(dt_s, LONGEST_DOUBT_S)
    half = 0.5 * doubt_s**2
    sigma = np.array([a * half, a * half, alpha * half, a, alpha, 0.0])
    sigma[3:5] *= doubt_s
    return Prediction(new, F, np.diag(sigma**2))


def _moved_along(state: Array, c: float, s: float, dt_s: float) -> tuple[Array, Array]:
    """Move a state along a heading (cosine, sine) taken as given.

    Returns the state (6,) and its Jacobian (6, 6), in which the heading depends on
    psi but not on r.
    """
    _, _, psi, u, r, _ = state
    new = state.copy()
    new[0] += u * c * dt_s
    new[1] += u * s * dt_s
    new[2] = wrap_angle(psi + r * dt_s)
    F = np.eye(NV)
    F[0, 2], F[1, 2] = -u * s * dt_s, u * c * dt_s
    F[0, 3], F[1, 3] = c * dt_s, s * dt_s
    F[2, 4] = dt_s
    return new, F


def predict_with_odometry(
    state: Array, increment: OdometryIncrement, config: MotionConfig
) -> Prediction:
    """Move the pose by integrated odometry and take over its last velocity.

    With ``d(b) = delta + J b`` (``b`` the yaw-rate bias):
    ``p = p (+) d(b), u = u_odo, r = r_odo - b``.
    """
    psi, bias = state[2], state[5]
    delta = increment.delta + increment.bias_jacobian * bias
    R = rotation(psi)
    new = state.copy()
    new[:2] += R @ delta[:2]
    new[2] = wrap_angle(psi + delta[2])
    new[3] = increment.velocity[0]
    new[4] = increment.velocity[1] - bias
    F = np.eye(NV)
    F[3:5] = 0.0
    moved = R @ delta[:2]
    F[0, 2], F[1, 2] = -moved[1], moved[0]
    F[:2, 5] = R @ increment.bias_jacobian[:2]
    F[2, 5] = increment.bias_jacobian[2]
    F[4, 5] = -1.0
    turn = np.eye(3)
    turn[:2, :2] = R
    Q = np.zeros((NV, NV))
    Q[:3, :3] = turn @ increment.cov @ turn.T
    Q[3:5, 3:5] = increment.velocity_cov
    if yaw_rate_bias_sigma(config) > 0.0:
        Q[5, 5] = config.gyro_bias_walk**2 * increment.dt_s
    return Prediction(new, F, Q)


def integrate_odometry(
    previous: VelocityObservation,
    samples: Sequence[VelocityObservation],
    start_s: float,
    end_s: float,
    config: MotionConfig,
    spacing_s: float = 0.0,
) -> OdometryIncrement:
    """Integrate velocity samples over ``[start_s, end_s]``.

    Velocity changes linearly between samples and is held after the last. With
    segment lengths ``dt_i``, mean velocities ``u_i, r_i`` and headings ``h_i`` at
    the segments' middles: ``x = sum u_i dt_i cos h_i``, likewise y, and
    ``psi = sum r_i dt_i``. A sample's error is white, so a segment inside a
    sampling interval ``D`` contributes ``cov D dt``. The path also walks sideways
    by the configured slip. Where no sample has come since the last, that one stands
    for ``spacing_s``, the interval between the last two; an interval longer than
    ``odometry_hold_s`` adds what the car's accelerations can do beyond it.
    """
    stamps = np.array([previous.stamp_s, *(v.stamp_s for v in samples)])
    values = np.array([[v.u_mps, v.r_radps] for v in (previous, *samples)])
    covs = np.array([v.cov for v in (previous, *samples)])
    last_gap = stamps[-1] - stamps[-2] if len(stamps) > 1 else 0.0
    last_gap = max(last_gap, spacing_s)
    first = values[0]
    if len(stamps) > 1 and stamps[1] > stamps[0]:
        passed = np.clip((start_s - stamps[0]) / (stamps[1] - stamps[0]), 0.0, 1.0)
        first = values[0] + passed * (values[1] - values[0])
    knots = np.concatenate([[start_s], stamps[1:], [end_s]])
    held = np.vstack([first, values[1:], values[-1:]])
    dt = np.diff(knots)
    mean = 0.5 * (held[:-1] + held[1:])
    spacing = np.concatenate([np.diff(stamps), [max(last_gap, dt[-1])]])
    spacing = np.maximum(spacing, dt)
    sample_cov = np.concatenate([covs[1:], covs[-1:]])
    excess = np.clip(dt - config.odometry_hold_s, 0.0, LONGEST_DOUBT_S)
    sample_cov = sample_cov.copy()
    sample_cov[:, 0, 0] += (config.accel_sigma_mps2 * excess) ** 2
    sample_cov[:, 1, 1] += (config.yaw_accel_sigma_radps2 * excess) ** 2
    return _sum_segments(dt, mean, sample_cov, spacing, values[-1], covs[-1], config)


def _sum_segments(
    dt: Array,
    velocity: Array,
    sample_cov: Array,
    spacing: Array,
    last: Array,
    last_cov: Array,
    config: MotionConfig,
) -> OdometryIncrement:
    turn = velocity[:, 1] * dt
    heading = np.cumsum(turn) - 0.5 * turn
    c, s = np.cos(heading), np.sin(heading)
    step = velocity[:, 0] * dt * np.sinc(0.5 * turn / np.pi)
    ends = np.cumsum(np.stack([step * c, step * s], axis=1), axis=0)
    delta = np.array([ends[-1, 0], ends[-1, 1], turn.sum()])
    # An error of the yaw rate turns half of its own segment and all that follow.
    middle = ends - 0.5 * np.stack([step * c, step * s], axis=1)
    lever = ends[-1] - middle
    jac = np.zeros((len(dt), 3, 2))
    jac[:, 0, 0], jac[:, 1, 0] = c, s
    jac[:, 0, 1], jac[:, 1, 1], jac[:, 2, 1] = -lever[:, 1], lever[:, 0], 1.0
    span = np.minimum(spacing, LONGEST_DOUBT_S) * np.minimum(dt, LONGEST_DOUBT_S)
    weighted = sample_cov * span[:, None, None]
    cov = np.einsum("nij,njk,nlk->il", jac, weighted, jac)
    slip = config.slip_sigma_m_per_sqrt_m**2 * np.abs(step)
    sideways = np.stack([-s, c], axis=1)
    cov[:2, :2] += np.einsum("n,ni,nj->ij", slip, sideways, sideways)
    cov[[0, 1], [0, 1]] += STEP_FLOOR_M2
    cov[2, 2] = max(cov[2, 2], STEP_FLOOR_RAD2)
    bias_jacobian = -np.einsum("nij,nj->i", jac[:, :, 1:], dt[:, None])
    return OdometryIncrement(
        float(dt.sum()), delta, cov, bias_jacobian, last, np.array(last_cov)
    )
