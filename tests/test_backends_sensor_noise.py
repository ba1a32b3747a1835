"""Sensor noise at the place where a cone should be, against the model's own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conegraph.backends.sensor_noise import (
    GENERIC,
    bearing_range_covariance,
    effective_sensor,
    polar_sigmas,
    transport_covariance,
    with_configured_noise,
    with_scaled_odometry,
)
from conegraph.config import MotionConfig, SensorConfig
from conegraph.geometry import rotation
from conegraph.types import (
    Array,
    ConeObservations,
    SensorModel,
    VelocityObservation,
)

MODEL = SensorModel(np.array([0.02, 0.01, 0.003]), 0.006, 0.03)
PLAIN = SensorModel(np.array([0.02, 0.01, 0.003]), 0.006)

places = st.tuples(st.floats(0.5, 40.0), st.floats(-3.1, 3.1)).map(
    lambda p: np.array([[p[0] * np.cos(p[1]), p[0] * np.sin(p[1])]])
)


def test_sigmas_along_and_across_the_ray() -> None:
    along, across = polar_sigmas(np.array([0.0, 10.0]), MODEL)
    np.testing.assert_allclose(along**2, [0.02**2 + 0.03**2, 0.42**2 + 0.03**2])
    np.testing.assert_allclose(across**2, [0.03**2, 0.06**2 + 0.03**2])


@given(places, places)
def test_the_model_s_covariance_becomes_the_model_s_at_the_new_place(
    measured: Array,
    predicted: Array,
) -> None:
    moved = transport_covariance(MODEL.covariance(measured), measured, predicted, MODEL)
    want = MODEL.covariance(predicted)
    np.testing.assert_allclose(moved, want, rtol=1e-9, atol=1e-12)


@given(places, st.integers(0, 2**32 - 1))
def test_a_covariance_that_stays_in_place_is_untouched(xy: Array, seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(2, 2))
    cov = (root @ root.T)[None]
    np.testing.assert_allclose(transport_covariance(cov, xy, xy, MODEL), cov)


@given(places, st.floats(-3, 3))
def test_a_pure_turn_turns_the_covariance(xy: Array, angle: float) -> None:
    cov = np.array([[[0.3, 0.1], [0.1, 0.2]]])
    R = rotation(angle)
    moved = transport_covariance(cov, xy, xy @ R.T, MODEL)
    np.testing.assert_allclose(moved, R @ cov @ R.T, atol=1e-12)


def test_a_detector_s_own_doubt_is_kept_in_proportion() -> None:
    measured, predicted = np.array([[10.0, 0.0]]), np.array([[20.0, 0.0]])
    # Range sigma 0.42 becomes 1.42, bearing sigma doubles with the range.
    cov = 9.0 * PLAIN.covariance(measured)
    moved = transport_covariance(cov, measured, predicted, PLAIN)
    np.testing.assert_allclose(moved[0], np.diag([9 * 1.42**2, 9 * 0.12**2]))


@given(places, st.integers(0, 2**32 - 1))
def test_bearing_and_range_covariance_is_the_first_order_one(
    xy: Array, seed: int
) -> None:
    root = np.random.default_rng(seed).normal(size=(2, 2))
    cov = root @ root.T
    columns = []
    for nudge in 1e-6 * np.eye(2):
        (x0, y0), (x1, y1) = xy[0] - nudge, xy[0] + nudge
        turned = np.angle(complex(x1, y1) / complex(x0, y0))
        columns.append([turned, np.hypot(x1, y1) - np.hypot(x0, y0)])
    jacobian = np.array(columns).T / 2e-6
    got = bearing_range_covariance(cov[None], xy)[0]
    np.testing.assert_allclose(got, jacobian @ cov @ jacobian.T, rtol=1e-5, atol=1e-7)


@given(places)
def test_bearing_and_range_of_the_model_are_independent(
    xy: Array,
) -> None:
    got = bearing_range_covariance(PLAIN.covariance(xy), xy)[0]
    r = np.hypot(*xy[0])
    range_sigma = 0.02 + 0.01 * r + 0.003 * r**2
    np.testing.assert_allclose(got, np.diag([0.006**2, range_sigma**2]), atol=1e-10)


def test_configured_keys_lie_over_the_source_s_and_those_over_the_generic() -> None:
    generic = effective_sensor(SensorConfig(), None)
    assert generic.bearing_sigma_rad == GENERIC.bearing_sigma_rad
    source = effective_sensor(SensorConfig(), MODEL)
    np.testing.assert_array_equal(source.range_sigma_m, MODEL.range_sigma_m)
    mixed = effective_sensor(
        SensorConfig(bearing_sigma_rad=0.1, floor_m=0.0, max_range_m=7.0), MODEL
    )
    assert mixed.bearing_sigma_rad == 0.1
    # Zero is a value, not an omission.
    assert mixed.floor_m == 0.0
    assert mixed.max_range_m == pytest.approx(7.0)
    np.testing.assert_array_equal(mixed.range_sigma_m, MODEL.range_sigma_m)


def test_configured_noise_is_the_source_s_or_the_model_s_times_the_scale() -> None:
    xy = np.array([[5.0, 0.0], [0.0, 8.0]])
    frame = ConeObservations(
        0.0, xy, np.tile(np.eye(2), (2, 1, 1)), np.full((2, 5), 0.2)
    )
    model = SensorModel(np.array([0.1, 0.0, 0.0]), 0.01)
    source = with_configured_noise(frame, SensorConfig(scale=2.0), model)
    np.testing.assert_array_equal(source.cov_m2, 4.0 * frame.cov_m2)
    modelled = SensorConfig(noise_from="model", scale=2.0)
    found = with_configured_noise(frame, modelled, model).cov_m2
    # 0.1 m along the ray; 0.01 rad at 5 m and at 8 m across it; twice that.
    expected = [np.diag([0.2, 0.1]) ** 2, np.diag([0.16, 0.2]) ** 2]
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_odometry_is_scaled_in_speed_and_yaw_rate_apart() -> None:
    cov = np.array([[4.0, 1.0], [1.0, 9.0]])
    sample = VelocityObservation(0.0, 1.0, 0.1, cov)
    scaled = with_scaled_odometry(sample, MotionConfig(odometry_scale=(2.0, 0.5)))
    np.testing.assert_array_equal(scaled.cov, [[16.0, 1.0], [1.0, 2.25]])
    assert with_scaled_odometry(sample, MotionConfig()) is sample
