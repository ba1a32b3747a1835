"""Velocity from cones against motions that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from conegraph.backends.velocity import cone_velocity, rigid_fit
from conegraph.geometry import compose, inverse, to_child, to_parent
from conegraph.types import Array

seeds = st.integers(0, 2**32 - 1)
CONES = np.array([[4.0, 2.0], [6.0, -2.0], [9.0, 2.0], [11.0, -1.0]])
COV = np.tile(0.0025 * np.eye(2), (4, 1, 1))


@settings(deadline=None)
@given(seeds, st.integers(2, 8))
def test_rigid_fit_recovers_a_motion(seed: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-10, 10, (k, 2))
    assume(np.linalg.norm(points - points.mean(axis=0), axis=1).max() > 0.1)
    pose = np.array([*rng.uniform(-20, 20, 2), rng.uniform(-3.1, 3.1)])
    got = rigid_fit(points, to_parent(pose, points))
    np.testing.assert_allclose(got, pose, atol=1e-9)


@settings(deadline=None)
@given(seeds)
def test_no_other_motion_fits_noisy_points_better(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.uniform(-10, 10, (5, 2))
    b = to_parent(np.array([1.0, -2.0, 0.4]), a) + 0.3 * rng.normal(size=(5, 2))
    best = rigid_fit(a, b)

    def cost(pose: Array) -> float:
        return float(((to_parent(pose, a) - b) ** 2).sum())

    for _ in range(20):
        other = compose(best, 0.05 * rng.normal(size=3))
        assert cost(other) >= cost(best) - 1e-9


@pytest.mark.parametrize("u", [-3.0, 0.0, 8.0])
@pytest.mark.parametrize("r", [-0.8, 0.0, 0.5])
def test_cones_that_come_nearer_mean_driving_forward(u: float, r: float) -> None:
    dt = 0.1
    moved = np.array([u * dt, 0.0, r * dt])
    got = cone_velocity(CONES, COV, to_child(moved, CONES), COV, dt, 3.0)
    assert got is not None
    assert got.stamp_s == 3.0
    assert got.u_mps == pytest.approx(u)
    assert got.r_radps == pytest.approx(r)


def test_covariance_follows_from_the_cones_own() -> None:
    dt = 0.1
    got = cone_velocity(CONES, COV, CONES, 3.0 * COV, dt, 0.0)
    assert got is not None
    # Per axis 0.0025 + 0.0075 of a difference; the yaw over the moment about the
    # centroid; the translation of the mean and the yaw at the centroid's lever.
    centred = CONES - CONES.mean(axis=0)
    yaw = 0.01 / (centred**2).sum()
    shift = 0.01 / 4 + (CONES.mean(axis=0) ** 2).sum() * yaw
    np.testing.assert_allclose(got.cov, np.diag([shift, yaw]) / dt**2)


def test_too_few_or_collinear_cones_and_no_time_tell_nothing() -> None:
    assert cone_velocity(CONES[:2], COV[:2], CONES[:2], COV[:2], 0.1, 0.0) is None
    line = np.array([[4.0, 1.0], [6.0, 1.01], [9.0, 1.0], [12.0, 1.0]])
    assert cone_velocity(line, COV, line, COV, 0.1, 0.0) is None
    assert cone_velocity(CONES, COV, CONES, COV, 0.0, 0.0) is None
    same = np.ones((4, 2))
    assert cone_velocity(same, COV, same, COV, 0.1, 0.0) is None


def test_the_fit_and_its_inverse_undo_each_other() -> None:
    pose = np.array([1.0, 2.0, 0.3])
    there = to_parent(pose, CONES)
    np.testing.assert_allclose(rigid_fit(there, CONES), inverse(pose), atol=1e-12)
