"""Whether the car stands, told by its wheels and its gyro."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from conegraph.backends.motion import STEP_FLOOR_M2, STEP_FLOOR_RAD2, OdometryIncrement
from conegraph.types import VelocityObservation

WINDOW_S = 0.5
"""Time over which odometry must say that the car stands."""

STILL_MPS = 0.02
STILL_RADPS = 0.03
"""Largest mean speed and yaw rate of a car that stands; the latter leaves room for a
cheap gyro's bias."""

SIGMAS = 4.0
"""No single sample may be farther from standing than so many of its sigmas."""

CREEP_M_PER_SQRT_S = 0.001
CREEP_RAD_PER_SQRT_S = 1e-4
"""Random walk of a car that stands: springs, wind, and people who lean on it."""


class StandstillWatch:
    """Keeps the odometry of the last moments.

    A zero-velocity update, as in inertial navigation (and OpenVINS, Geneva et al.,
    2020): while wheels and gyro say that the car stands, it is predicted to stay where
    it is, and their noise is not added up to a walk.
    """

    def __init__(self) -> None:
        """Start without any sample."""
        self._samples: deque[VelocityObservation] = deque()

    def add(self, sample: VelocityObservation) -> None:
        """Take the next sample; stamps never decrease."""
        self._samples.append(sample)
        while self._samples[0].stamp_s < sample.stamp_s - WINDOW_S:
            self._samples.popleft()

    def stands(self, stamp_s: float) -> bool:
        """Say whether the car has stood for the whole window up to a stamp.

        Slow samples are told from noise by their mean: of n white ones it has the
        sigma of one over the square root of n.
        """
        if len(self._samples) < 3:
            return False
        first, last = self._samples[0].stamp_s, self._samples[-1].stamp_s
        spacing_s = (last - first) / (len(self._samples) - 1)
        if last - first < 0.8 * WINDOW_S or stamp_s - last > 2.0 * spacing_s:
            return False
        value = np.array([[v.u_mps, v.r_radps] for v in self._samples])
        cov = np.array([v.cov for v in self._samples])
        sigma = np.sqrt(cov[:, [0, 1], [0, 1]])
        still = np.array([STILL_MPS, STILL_RADPS])
        noise = sigma.mean(axis=0) / np.sqrt(len(value))
        if (3.0 * noise > 2.0 * still).any():
            return False
        slow = np.abs(value.mean(axis=0)) < np.maximum(still, 3.0 * noise)
        usual = np.abs(value) < still + SIGMAS * sigma
        return bool(slow.all() and usual.all())


def standing(increment: OdometryIncrement) -> OdometryIncrement:
    """Return the increment of a car that stood, in place of the measured one.

    The path is none; what the gyro reports is its bias, with the noise of the turn
    that was measured.
    """
    walk = np.array([CREEP_M_PER_SQRT_S, CREEP_M_PER_SQRT_S, CREEP_RAD_PER_SQRT_S])
    smallest = (STEP_FLOOR_M2, STEP_FLOOR_M2, STEP_FLOOR_RAD2)
    dt_s, turn = increment.dt_s, float(increment.delta[2])
    sigma = float(np.sqrt(increment.cov[2, 2])) / dt_s
    return replace(
        increment,
        delta=np.zeros(3),
        cov=np.diag(np.maximum(walk**2 * dt_s, smallest)),
        bias_jacobian=np.zeros(3),
        bias=(turn / dt_s, sigma),
    )
