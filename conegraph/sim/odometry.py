"""Wheel speed and gyro of a car whose true motion is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.types import Array, VelocityObservation


@dataclass(frozen=True, slots=True)
class OdometrySensor:
    """Wheel speed and gyro, read together.

    Attributes:
        rate_hz: samples per second.
        speed_sigma_mps: white noise of a speed sample.
        yaw_rate_sigma_radps: white noise of a yaw-rate sample.
        gyro_bias_sigma_radps: the gyro's bias is drawn with this sigma, once a drive.
        yaw_rate_bias_radps: a bias of the gyro on top of the drawn one.
        wheel_scale: relative error of the wheel radius: u is read (1 + scale) times.
        delay_s: time between a sample's stamp and its arrival.
    """

    rate_hz: float = 100.0
    speed_sigma_mps: float = 0.05
    yaw_rate_sigma_radps: float = 0.005
    gyro_bias_sigma_radps: float = 0.003
    yaw_rate_bias_radps: float = 0.0
    wheel_scale: float = 0.0
    delay_s: float = 0.0


def read_odometry(
    sensor: OdometrySensor, stamp_s: Array, velocity: Array, rng: np.random.Generator
) -> list[VelocityObservation]:
    """Return noisy samples of true velocities (N, 2) of u and r at stamps (N,).

    The covariance reported is that of a sample's white noise; bias and scale are
    for the estimator to find, as they are on a car.
    """
    sigma = np.array([sensor.speed_sigma_mps, sensor.yaw_rate_sigma_radps])
    drawn = sensor.gyro_bias_sigma_radps * rng.standard_normal()
    bias = np.array([0.0, sensor.yaw_rate_bias_radps + drawn])
    scale = np.array([1.0 + sensor.wheel_scale, 1.0])
    read = velocity * scale + bias + sigma * rng.standard_normal(velocity.shape)
    cov = np.diag(sigma**2)
    return [
        VelocityObservation(stamp, u, r, cov)
        for stamp, (u, r) in zip(stamp_s.tolist(), read.tolist(), strict=True)
    ]
