"""Wheels and gyro: the noise that is reported is the noise that is there."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.sim.odometry import OdometrySensor, read_odometry
from conegraph.types import Array

N = 20_000


def read(sensor: OdometrySensor, seed: int = 0, count: int = N) -> Array:
    """Return readings (count, 2) of u = 10 m/s and r = 0.5 rad/s."""
    stamps = np.arange(count) / sensor.rate_hz
    truth = np.tile([10.0, 0.5], (count, 1))
    samples = read_odometry(sensor, stamps, truth, np.random.default_rng(seed))
    assert [v.stamp_s for v in samples] == stamps.tolist()
    return np.array([[v.u_mps, v.r_radps] for v in samples])


def test_white_noise_is_that_of_the_covariance() -> None:
    sensor = OdometrySensor()
    (sample,) = read_odometry(
        sensor, np.zeros(1), np.zeros((1, 2)), np.random.default_rng(0)
    )
    np.testing.assert_allclose(sample.cov, np.diag([0.05**2, 0.005**2]))
    spread = np.cov(read(sensor).T)
    np.testing.assert_allclose(
        np.diag(spread) / np.diag(sample.cov), 1.0, atol=5 * (2 / N) ** 0.5
    )
    correlation = spread[0, 1] / np.sqrt(spread[0, 0] * spread[1, 1])
    assert abs(correlation) < 5 / np.sqrt(N)


def test_successive_samples_are_independent() -> None:
    error = read(OdometrySensor())[:, 1]
    error = error - error.mean()
    lagged = (error[1:] * error[:-1]).mean() / error.var()
    assert abs(lagged) < 5 / np.sqrt(N)


def test_the_gyro_bias_is_constant_and_drawn_with_its_sigma() -> None:
    sensor = OdometrySensor(yaw_rate_sigma_radps=0.0, gyro_bias_sigma_radps=0.003)
    drives = np.array([read(sensor, seed, 2)[:, 1] for seed in range(200)]) - 0.5
    np.testing.assert_allclose(drives[:, 0], drives[:, 1], atol=1e-15)
    assert drives[:, 0].std() == pytest.approx(0.003, rel=5 / np.sqrt(400))


def test_the_wheel_scale_stretches_speed_alone() -> None:
    sensor = OdometrySensor(
        speed_sigma_mps=0.0,
        yaw_rate_sigma_radps=0.0,
        gyro_bias_sigma_radps=0.0,
        wheel_scale=0.02,
    )
    np.testing.assert_allclose(read(sensor), np.tile([10.2, 0.5], (N, 1)), rtol=1e-12)


def test_a_bias_that_is_asked_for_comes_on_top_of_the_drawn_one() -> None:
    more = read(OdometrySensor(yaw_rate_bias_radps=0.1)) - read(OdometrySensor())
    np.testing.assert_allclose(more[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(more[:, 1], 0.1, atol=1e-12)
