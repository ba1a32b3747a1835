"""The sensor model behind reported covariances is found again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.io.sensor_fit import fit_sensor_model
from conegraph.types import Array, SensorModel


def cones(count: int = 400, far: float = 45.0, half_fov: float = 1.0) -> Array:
    rng = np.random.default_rng(3)
    r, b = rng.uniform(1.0, far, count), rng.uniform(-half_fov, half_fov, count)
    return np.column_stack([r * np.cos(b), r * np.sin(b)])


sigmas = st.floats(0.0, 0.1)


@settings(deadline=None)
@given(st.floats(0.01, 0.2), sigmas, st.floats(0, 0.01), st.floats(1e-3, 0.05), sigmas)
def test_a_known_model_is_recovered(
    c0: float, c1: float, c2: float, bearing: float, floor: float
) -> None:
    model = SensorModel(np.array([c0, c1, c2]), bearing, floor_m=floor)
    xy = cones()
    fitted = fit_sensor_model(xy, model.covariance(xy))
    assert fitted is not None
    assert fitted.range_sigma_m == pytest.approx([c0, c1, c2], abs=1e-6)
    assert fitted.bearing_sigma_rad == pytest.approx(bearing, abs=1e-6)
    assert fitted.floor_m == pytest.approx(floor, abs=1e-6)


def test_pacsim_lidar() -> None:
    """Its range sigma is a hyperbola, of which the parabola misses 2e-6 m."""
    xy = cones()
    r = np.hypot(*xy.T)
    ray = xy / r[:, None]
    normal = np.column_stack([-ray[:, 1], ray[:, 0]])
    along = 0.02**2 + (1e-4 * r) ** 2
    across = (1e-3 * r) ** 2
    cov = (
        along[:, None, None] * ray[:, :, None] * ray[:, None, :]
        + across[:, None, None] * normal[:, :, None] * normal[:, None, :]
        + 0.01**2 * np.eye(2)
    )
    fitted = fit_sensor_model(xy, cov)
    assert fitted is not None
    assert fitted.bearing_sigma_rad == pytest.approx(1e-3, abs=1e-6)
    assert fitted.floor_m == pytest.approx(0.01, abs=1e-6)
    c0, c1, c2 = fitted.range_sigma_m
    assert c0 + c1 * r + c2 * r * r == pytest.approx(np.sqrt(along), abs=2e-6)
    assert fitted.covariance(xy) == pytest.approx(cov, abs=2e-7)


def test_an_isotropic_constant_covariance_is_a_floor() -> None:
    xy = cones()
    fitted = fit_sensor_model(xy, np.broadcast_to(0.4 * np.eye(2), (len(xy), 2, 2)))
    assert fitted is not None
    assert fitted.floor_m == pytest.approx(np.sqrt(0.4), abs=1e-6)
    assert fitted.covariance(xy) == pytest.approx(
        np.broadcast_to(0.4 * np.eye(2), (len(xy), 2, 2)), rel=1e-5, abs=1e-6
    )


def test_the_floor_never_exceeds_what_was_reported_along_the_ray() -> None:
    xy = np.column_stack([np.linspace(2.0, 20.0, 50), np.zeros(50)])
    cov = np.zeros((50, 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = 0.02**2, 0.3**2
    fitted = fit_sensor_model(xy, cov)
    assert fitted is not None
    assert fitted.covariance(xy)[:, 0, 0] == pytest.approx(0.02**2, rel=1e-6)


def test_view_limits_hold_the_cones() -> None:
    xy = cones(far=15.0, half_fov=0.6)
    fitted = fit_sensor_model(xy, np.broadcast_to(np.eye(2), (len(xy), 2, 2)))
    assert fitted is not None
    assert 0.9 < fitted.min_range_m < np.hypot(*xy.T).min()
    assert np.hypot(*xy.T).max() < fitted.max_range_m < 16.0
    assert 0.6 < fitted.half_fov_rad < 0.7
    assert fitted.detection_probability is None


def test_without_cones_there_is_no_model() -> None:
    assert fit_sensor_model(np.zeros((0, 2)), np.zeros((0, 2, 2))) is None
    assert fit_sensor_model(np.zeros((1, 2)), np.eye(2)[None]) is None


def test_covariance_along_and_across_the_ray() -> None:
    model = SensorModel(np.array([0.1, 0.2, 0.3]), 0.5, floor_m=0.6)
    cov = model.covariance(np.array([[2.0, 0.0], [0.0, 2.0], [0.0, 0.0]]))
    along, across = (0.1 + 0.4 + 1.2) ** 2 + 0.36, 1.0 + 0.36
    assert cov[0] == pytest.approx(np.diag([along, across]))
    assert cov[1] == pytest.approx(np.diag([across, along]))
    assert cov[2] == pytest.approx(np.diag([0.01 + 0.36, 0.36]))
