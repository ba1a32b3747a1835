"""Each factor is nothing where all agrees, and what its formula says elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, L, V, X
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from conegraph.backends import factors
from conegraph.backends.motion import OdometryIncrement
from conegraph.config import MotionConfig
from conegraph.geometry import compose, to_child, to_parent
from conegraph.types import Array

MOTION = MotionConfig()
seeds = st.integers(0, 2**32 - 1)


def at(
    poses: Mapping[int, ArrayLike] | None = None,
    cones: Mapping[int, ArrayLike] | None = None,
    velocities: Mapping[int, ArrayLike] | None = None,
    biases: Mapping[int, float] | None = None,
) -> gtsam.Values:
    values = gtsam.Values()
    for k, pose in (poses or {}).items():
        values.insert(X(k), gtsam.Pose2(*np.asarray(pose)))
    for i, xy in (cones or {}).items():
        values.insert(L(i), np.asarray(xy, dtype=float))
    for k, velocity in (velocities or {}).items():
        values.insert(V(k), np.asarray(velocity, dtype=float))
    for j, bias in (biases or {}).items():
        values.insert(B(j), np.array([bias]))
    return values


def total(parts: Sequence[gtsam.NonlinearFactor], values: gtsam.Values) -> float:
    return float(sum(part.error(values) for part in parts))


def half_d2(e: Array, cov: Array) -> float:
    return float(0.5 * e @ np.linalg.solve(cov, e))


def increment(rng: np.random.Generator, scale: float = 0.01) -> OdometryIncrement:
    root = scale * rng.normal(size=(3, 3))
    return OdometryIncrement(
        0.2,
        np.array([rng.uniform(0, 4), rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4)]),
        root @ root.T + 1e-6 * np.eye(3),
        np.array([0.02, -0.3, -0.2]),
        np.array([10.0, 1.0]),
        np.eye(2),
    )


def test_priors() -> None:
    start = factors.start_prior(np.array([0.1, 0.2, 0.05]))
    assert start.error(at({0: np.zeros(3)})) == 0.0
    # 0.1 is one sigma in x, 0.4 two in y: (1 + 4) / 2.
    assert start.error(at({0: np.array([0.1, 0.4, 0])})) == pytest.approx(2.5)
    bias = factors.bias_prior(0.01)
    assert bias.error(at(biases={0: 0.0})) == 0.0
    assert bias.error(at(biases={0: 0.03})) == pytest.approx(4.5)
    speed = factors.velocity_prior(2, np.array([8.0, 0.5]), np.array([2.0, 0.1, 0.4]))
    assert speed.error(at(velocities={2: [8.0, 0.0, 0.5]})) == 0.0
    off = at(velocities={2: [10.0, 0.0, 0.9]})
    assert speed.error(off) == pytest.approx(1.0)


def test_the_bias_walks_with_the_root_of_time() -> None:
    walk = factors.bias_walk(1, 9.0, 0.001)
    assert walk.error(at(biases={0: 0.02, 1: 0.02})) == 0.0
    # sigma = 0.001 * 3.
    assert walk.error(at(biases={0: 0.02, 1: 0.026})) == pytest.approx(2.0)


def test_known_cones_and_cones_that_are_one() -> None:
    cov = np.array([[0.04, 0.01], [0.01, 0.09]])
    prior = factors.known_cone_prior(7, np.array([3.0, 4.0]), cov)
    assert prior.error(at(cones={7: [3.0, 4.0]})) == 0.0
    e = np.array([0.2, -0.3])
    moved = at(cones={7: np.array([3.0, 4.0]) + e})
    assert prior.error(moved) == pytest.approx(half_d2(e, cov))
    same = factors.one_cone(3, 4)
    assert same.error(at(cones={3: [1.0, 2.0], 4: [1.0, 2.0]})) == 0.0
    apart = at(cones={3: [1.0, 2.0], 4: [1.003, 2.0]})
    assert same.error(apart) == pytest.approx(0.5)


@settings(deadline=None)
@given(seeds)
def test_cones_by_bearing_and_range_with_their_whole_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-9, 9, 2), rng.uniform(-3, 3)])
    polar = np.array([rng.uniform(2, 20), rng.uniform(-1.2, 1.2)])
    xy = polar[0] * np.array([[np.cos(polar[1]), np.sin(polar[1])]])
    root = 0.1 * rng.normal(size=(2, 2))
    cov = root @ root.T + 1e-3 * np.eye(2)
    (factor,) = factors.cone_factors(4, np.array([9]), xy, cov[None], [None])
    there = to_parent(pose, xy)[0]
    assert factor.error(at({4: pose}, {9: there})) == pytest.approx(0.0, abs=1e-12)
    # To first order a cone moved by e costs as much as e in the car's own axes.
    e = 1e-5 * rng.normal(size=2)
    moved = at({4: pose}, {9: to_parent(pose, xy + e)[0]})
    assert factor.error(moved) == pytest.approx(half_d2(e, cov), rel=1e-2)


def test_the_kernel_bends_the_cost_of_outliers() -> None:
    xy, cov = np.array([[10.0, 0.0]]), np.array([np.diag([0.01, 0.01])])
    plain, robust = (
        factors.cone_factors(0, np.array([1]), xy, cov, [kernel])[0]
        for kernel in (None, 3.0)
    )
    for off_m in (0.01, 0.3, 2.0):
        values = at({0: np.zeros(3)}, {1: [10.0 + off_m, 0.0]})
        e2 = (off_m / 0.1) ** 2
        assert plain.error(values) == pytest.approx(0.5 * e2)
        # Cauchy: c^2 / 2 log(1 + e^2 / c^2).
        assert robust.error(values) == pytest.approx(4.5 * np.log1p(e2 / 9.0))


@settings(deadline=None)
@given(seeds, st.booleans())
def test_odometry_costs_nothing_where_it_is_right(seed: int, with_bias: bool) -> None:
    rng = np.random.default_rng(seed)
    odometry = increment(rng)
    before = np.array([*rng.uniform(-50, 50, 2), rng.uniform(-3, 3)])
    bias = (2, 0.01) if with_bias else None
    delta = odometry.delta + (0.01 * odometry.bias_jacobian if with_bias else 0.0)
    now = compose(before, delta)
    factor = factors.odometry_motion(5, odometry, before, bias)
    values = at({4: before, 5: now}, biases={2: 0.01})
    assert factor.error(values) == pytest.approx(0.0, abs=1e-12)
    # An error of the end's place, in the axes of the start, has the increment's
    # own covariance.
    e = 1e-4 * rng.normal(size=2)
    moved = compose(before, delta + np.array([*e, 0.0]))
    want = half_d2(np.array([*e, 0.0]), odometry.cov)
    values = at({4: before, 5: moved}, biases={2: 0.01})
    assert factor.error(values) == pytest.approx(want, rel=1e-3)


@settings(deadline=None)
@given(seeds)
def test_the_bias_enters_odometry_by_its_jacobian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    odometry = increment(rng)
    before = np.array([1.0, 2.0, 0.3])
    factor = factors.odometry_motion(1, odometry, before, (0, 0.005))
    change = 1e-3
    now = compose(before, odometry.delta + 0.005 * odometry.bias_jacobian)
    # The bias alone moved: the increment's end is off by J db.
    e = odometry.bias_jacobian * change
    values = at({0: before, 1: now}, biases={0: 0.005 + change})
    assert factor.error(values) == pytest.approx(half_d2(e, odometry.cov), rel=1e-6)
    # Bias and end moved together: nothing is off but at second order, e^2 / 2.
    now = compose(before, odometry.delta + (0.005 + change) * odometry.bias_jacobian)
    values = at({0: before, 1: now}, biases={0: 0.005 + change})
    least = np.linalg.eigvalsh(odometry.cov)[0]
    assert factor.error(values) <= (e @ e) ** 2 / least


@settings(deadline=None)
@given(seeds, st.floats(-0.2, 0.2))
def test_odometry_stays_right_as_a_closure_turns_the_map(
    seed: int, turn: float
) -> None:
    rng = np.random.default_rng(seed)
    odometry = increment(rng)
    unit = OdometryIncrement(
        0.2,
        odometry.delta,
        np.eye(3),
        odometry.bias_jacobian,
        odometry.velocity,
        odometry.velocity_cov,
    )
    before = np.array([30.0, -20.0, 0.5])
    factor = factors.odometry_motion(1, unit, before, (0, 0.0))
    move = np.array([3.0, -2.0, turn])
    poses = {0: compose(move, before), 1: compose(move, compose(before, unit.delta))}
    # With a unit covariance the error is half the square of what is left, which
    # grows with the square of the turn and the length of the step.
    length = float(np.hypot(*unit.delta[:2]))
    left = 1.1 * length * turn**2 / 2
    assert factor.error(at(poses, biases={0: 0.0})) <= 0.5 * left**2 + 1e-9


@settings(deadline=None)
@given(st.floats(0.02, 0.2), st.floats(-8, 8), st.floats(-6, 6))
def test_free_motion_costs_an_acceleration_what_its_sigma_says(
    dt_s: float, a: float, alpha: float
) -> None:
    wnoa, straight = factors.free_motion(1, 3.0, 3.0 + dt_s, 8.0, MOTION)
    still = {0: np.zeros(3), 1: np.array([8.0 * dt_s, 0.0, 0.0])}
    kept = at(still, velocities={0: [8.0, 0, 0], 1: [8.0, 0, 0]})
    assert wnoa.error(kept) == pytest.approx(0.0, abs=1e-9)
    # Constant acceleration is the cheapest way to a new speed: a^2 dt / density,
    # halved, with density sigma^2 dt.
    poses = {0: np.zeros(3), 1: np.array([8.0 * dt_s + a * dt_s**2 / 2, 0, 0])}
    faster = at(poses, velocities={0: [8.0, 0, 0], 1: [8.0 + a * dt_s, 0, 0]})
    want = 0.5 * (a / MOTION.accel_sigma_mps2) ** 2
    assert wnoa.error(faster) == pytest.approx(want, abs=1e-6)
    poses = {0: np.zeros(3), 1: np.array([0, 0, alpha * dt_s**2 / 2])}
    turned = at(poses, velocities={0: [0, 0, 0], 1: [0, 0, alpha * dt_s]})
    want = 0.5 * (alpha / MOTION.yaw_accel_sigma_radps2) ** 2
    assert wnoa.error(turned) == pytest.approx(want, abs=1e-6)
    # Slip takes the car sideways by its sigma times the root of the way.
    off_m = MOTION.slip_sigma_m_per_sqrt_m * np.sqrt(8.0 * dt_s)
    slid = at(velocities={1: [0.0, off_m / dt_s, 0.0]})
    assert straight.error(slid) == pytest.approx(0.5)


def test_a_car_slips_as_much_where_free_motion_starts() -> None:
    start = factors.start_velocity_prior(0, 0.04, np.array([9.0, 0.0]), MOTION)
    off_m = MOTION.slip_sigma_m_per_sqrt_m * np.sqrt(9.0 * 0.04)
    slid = at(velocities={0: [9.0, off_m / 0.04, 0.0]})
    assert start.error(slid) == pytest.approx(0.5)


def test_a_car_that_stands_does_not_slide() -> None:
    _, straight = factors.free_motion(1, 0.0, 0.1, 0.0, MOTION)
    slid = at(velocities={1: [0.0, factors.LEAST_SLIP_MPS, 0.0]})
    assert straight.error(slid) == pytest.approx(0.5)


@pytest.mark.parametrize("dt_s", [1e-9, 1e-6, 1e-3])
def test_frames_that_almost_coincide_are_held_together_and_no_more(
    dt_s: float,
) -> None:
    wnoa, _ = factors.free_motion(1, 0.0, dt_s, 0.0, MOTION)
    at_rest = {0: np.zeros(3), 1: np.zeros(3)}
    off = np.sqrt(factors.SHORT_STEP[0])
    poses = {0: np.zeros(3), 1: np.array([off, 0, 0])}
    assert wnoa.error(at(at_rest, velocities=at_rest)) == 0.0
    # An offset without a change of speed costs four times its plain half square:
    # the inverse of [dt^3/3, dt^2/2; dt^2/2, dt] begins with 12 / dt^3.
    assert wnoa.error(at(poses, velocities=at_rest)) == pytest.approx(2.0, rel=1e-3)


def test_an_arc_at_constant_twist_is_free_motion() -> None:
    dt, u, r = 0.1, 9.0, 1.2
    chord = u / r * np.array([np.sin(r * dt), 1 - np.cos(r * dt)])
    poses = {0: np.zeros(3), 1: np.array([*chord, r * dt])}
    wnoa, _ = factors.free_motion(1, 0.0, dt, 9.0, MOTION)
    values = at(poses, velocities={0: [u, 0, r], 1: [u, 0, r]})
    assert wnoa.error(values) == pytest.approx(0.0, abs=1e-9)


def test_a_small_graph_has_its_cone_where_the_frames_put_it() -> None:
    poses = {0: np.zeros(3), 1: np.array([2.0, 0.1, 0.05])}
    cone = np.array([6.0, 1.5])
    graph = gtsam.NonlinearFactorGraph()
    parts = [factors.start_prior(factors.ORIGIN_SIGMAS)]
    for k, pose in poses.items():
        seen = to_child(pose, cone[None])
        cov = 0.01 * np.eye(2)[None]
        parts += factors.cone_factors(k, np.array([0]), seen, cov, [3.0])
    step = OdometryIncrement(
        0.2, poses[1], 1e-4 * np.eye(3), np.zeros(3), np.zeros(2), np.eye(2)
    )
    parts.append(factors.odometry_motion(1, step, poses[0], None))
    for part in parts:
        graph.add(part)
    assert total(parts, at(poses, {0: cone})) == pytest.approx(0.0, abs=1e-12)
    guess = at({0: np.zeros(3), 1: poses[1] + 0.1}, {0: cone + 0.5})
    solved = gtsam.LevenbergMarquardtOptimizer(graph, guess).optimize()
    np.testing.assert_allclose(solved.atPoint2(L(0)), cone, atol=1e-4)
