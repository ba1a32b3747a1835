"""The car's motion against closed forms, fine integration and differentiation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.motion import (
    LONGEST_DOUBT_S,
    NV,
    STEP_FLOOR_M2,
    STEP_FLOOR_RAD2,
    OdometryIncrement,
    Prediction,
    integrate_odometry,
    predict_euler,
    predict_midpoint,
    predict_with_odometry,
)
from conegraph.config import MotionConfig
from conegraph.geometry import compose, constant_twist, rotation
from conegraph.types import Array, VelocityObservation

CONFIG = MotionConfig()
NO_SLIP = MotionConfig(slip_sigma_m_per_sqrt_m=0.0)
SAMPLE_COV = np.diag([0.05**2, 0.005**2])

cars = st.tuples(
    st.floats(-100, 100),
    st.floats(-100, 100),
    st.floats(-3, 3),
    st.floats(-5, 30),
    st.floats(-2, 2),
    st.floats(-0.05, 0.05),
).map(np.array)
steps = st.floats(0.001, 0.5)


def sample(stamp_s: float, u_mps: float, r_radps: float) -> VelocityObservation:
    return VelocityObservation(stamp_s, u_mps, r_radps, SAMPLE_COV)


def samples_of(
    u: Callable[[float], float], r: Callable[[float], float], n: int, dt_s: float
) -> list[VelocityObservation]:
    return [sample(i * dt_s, u(i * dt_s), r(i * dt_s)) for i in range(n + 1)]


def differentiate(f: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Return the Jacobian of f at x by central differences."""
    columns = []
    for i in range(len(x)):
        nudge = np.zeros(len(x))
        nudge[i] = step
        columns.append((f(x + nudge) - f(x - nudge)) / (2 * step))
    return np.stack(columns, axis=1)


def increment(rng: np.random.Generator) -> OdometryIncrement:
    root = rng.normal(size=(3, 3))
    return OdometryIncrement(
        0.1,
        np.array([1.3, -0.2, 0.15]),
        root @ root.T,
        np.array([0.01, -0.06, -0.1]),
        np.array([13.0, 1.4]),
        SAMPLE_COV,
    )


def test_midpoint_step_of_a_turning_car() -> None:
    state = np.array([1.0, 2.0, np.pi / 2 - 0.05, 10.0, 1.0, 0.02])
    step = predict_midpoint(state, 0.1, CONFIG)
    # Half of the turn of 0.1 rad makes the heading exactly pi/2.
    expected = [1.0, 3.0, np.pi / 2 + 0.05, 10.0, 1.0, 0.02]
    np.testing.assert_allclose(step.state, expected, atol=1e-12)


def test_euler_step_keeps_the_first_heading() -> None:
    state = np.array([1.0, 2.0, np.pi / 2, 10.0, 1.0, 0.0])
    step = predict_euler(state, 0.1, CONFIG)
    expected = [1.0, 3.0, np.pi / 2 + 0.1, 10.0, 1.0, 0.0]
    np.testing.assert_allclose(step.state, expected, atol=1e-12)


@pytest.mark.parametrize("predict", [predict_midpoint, predict_euler])
def test_both_integrations_agree_on_a_straight(
    predict: Callable[[Array, float, MotionConfig], Prediction],
) -> None:
    state = np.array([0.0, 0.0, 0.3, 7.0, 0.0, 0.0])
    moved = predict(state, 0.2, CONFIG).state
    np.testing.assert_allclose(moved[:2], 1.4 * np.array([np.cos(0.3), np.sin(0.3)]))
    np.testing.assert_allclose(moved[2:], state[2:])


@settings(deadline=None)
@given(cars, steps)
def test_midpoint_stays_near_the_arc(state: Array, dt_s: float) -> None:
    moved = predict_midpoint(state, dt_s, CONFIG).state
    exact = compose(state[:3], constant_twist(state[3], state[4], dt_s))
    # The arc's chord is shorter by the factor sinc(r dt / 2) >= 1 - (r dt)^2 / 24.
    short = abs(state[3]) * dt_s * (state[4] * dt_s) ** 2 / 24.0
    assert np.hypot(*(moved[:2] - exact[:2])) <= short + 1e-9


@settings(deadline=None)
@given(cars, steps, st.sampled_from([predict_midpoint, predict_euler]))
def test_jacobian_of_the_free_step(
    state: Array,
    dt_s: float,
    predict: Callable[[Array, float, MotionConfig], Prediction],
) -> None:
    def moved(x: Array) -> Array:
        new = predict(x, dt_s, CONFIG).state
        # The wrap of the yaw is no part of the derivative.
        new[2] = x[2] + x[4] * dt_s
        return new

    F = predict(state, dt_s, CONFIG).F
    np.testing.assert_allclose(F, differentiate(moved, state), atol=2e-6)


@settings(deadline=None)
@given(cars, st.integers(0, 2**32 - 1))
def test_jacobian_of_the_odometry_step(state: Array, seed: int) -> None:
    odometry = increment(np.random.default_rng(seed))

    def moved(x: Array) -> Array:
        new = predict_with_odometry(x, odometry, CONFIG).state
        new[2] = x[2] + odometry.delta[2] + odometry.bias_jacobian[2] * x[5]
        return new

    F = predict_with_odometry(state, odometry, CONFIG).F
    np.testing.assert_allclose(F, differentiate(moved, state), atol=2e-6)


def test_odometry_step_composes_and_takes_the_bias_off() -> None:
    odometry = increment(np.random.default_rng(1))
    state = np.array([5.0, -3.0, 2.0, 1.0, 0.0, 0.02])
    step = predict_with_odometry(state, odometry, CONFIG)
    delta = odometry.delta + 0.02 * odometry.bias_jacobian
    np.testing.assert_allclose(step.state[:3], compose(state[:3], delta))
    np.testing.assert_allclose(step.state[3:], [13.0, 1.4 - 0.02, 0.02])
    turn = np.eye(3)
    turn[:2, :2] = rotation(2.0)
    np.testing.assert_allclose(step.Q[:3, :3], turn @ odometry.cov @ turn.T)
    np.testing.assert_allclose(step.Q[3:5, 3:5], SAMPLE_COV)
    assert step.Q[5, 5] == pytest.approx(CONFIG.gyro_bias_walk**2 * 0.1)


def test_without_a_bias_the_bias_does_not_walk() -> None:
    config = MotionConfig(gyro_bias_sigma_radps=0.0)
    odometry = increment(np.random.default_rng(1))
    step = predict_with_odometry(np.zeros(NV), odometry, config)
    assert not step.Q[5].any()


def test_noise_of_a_midpoint_step_along_x() -> None:
    u, dt = 8.0, 0.1
    config = MotionConfig(
        accel_sigma_mps2=2.0, yaw_accel_sigma_radps2=3.0, slip_sigma_m_per_sqrt_m=0.1
    )
    Q = predict_midpoint(np.array([0, 0, 0, u, 0, 0.0]), dt, config).Q
    # Acceleration a: (a dt^2/2, a dt); yaw acceleration: (u alpha dt^3/6, alpha
    # dt^2/2, alpha dt); slip across: s^2 u dt.
    expected = np.zeros((6, 6))
    g_a = np.array([dt**2 / 2, 0, 0, dt, 0, 0])
    g_alpha = np.array([0, u * dt**3 / 6, dt**2 / 2, 0, dt, 0])
    expected += 4.0 * np.outer(g_a, g_a) + 9.0 * np.outer(g_alpha, g_alpha)
    expected[1, 1] += 0.01 * u * dt
    np.testing.assert_allclose(Q, expected, atol=1e-15)


def test_noise_of_an_euler_step_is_diagonal() -> None:
    config = MotionConfig(accel_sigma_mps2=2.0, yaw_accel_sigma_radps2=3.0)
    Q = predict_euler(np.array([0, 0, 1.0, 8.0, 0.4, 0.0]), 0.1, config).Q
    sigma = [0.01, 0.01, 0.015, 0.2, 0.3, 0.0]
    np.testing.assert_allclose(Q, np.diag(np.square(sigma)), atol=1e-15)


@pytest.mark.parametrize("predict", [predict_midpoint, predict_euler])
def test_a_step_beyond_the_longest_stops_the_car_but_not_the_doubt(
    predict: Callable[[Array, float, MotionConfig], Prediction],
) -> None:
    state = np.array([0.0, 0.0, 0.0, 10.0, 0.1, 0.0])
    at_limit = predict(state, CONFIG.max_step_s, CONFIG)
    beyond = predict(state, 4.0 * CONFIG.max_step_s, CONFIG)
    np.testing.assert_array_equal(beyond.state, at_limit.state)
    # Velocity variance grows with the whole dt squared.
    assert beyond.Q[3, 3] == pytest.approx(16.0 * at_limit.Q[3, 3])


@pytest.mark.parametrize("predict", [predict_midpoint, predict_euler])
def test_doubt_stops_growing(
    predict: Callable[[Array, float, MotionConfig], Prediction],
) -> None:
    state = np.array([0.0, 0.0, 0.0, 10.0, 0.1, 0.0])
    for dt_s in (LONGEST_DOUBT_S, 1e3, 1e9):
        Q = predict(state, dt_s, CONFIG).Q
        assert Q[3, 3] == pytest.approx((6.0 * LONGEST_DOUBT_S) ** 2)
    one = sample(0.0, 10.0, 0.1)
    long, longer = (
        integrate_odometry(one, [], 0.0, t, NO_SLIP).cov[2, 2] for t in (1e3, 1e6)
    )
    # The error of one sample is held no longer, beside free accelerations.
    limit = LONGEST_DOUBT_S
    assert long == longer == pytest.approx((0.005**2 + (4.0 * limit) ** 2) * limit**2)


@settings(deadline=None)
@given(st.floats(-5, 30), st.floats(-3, 3), st.integers(1, 40), st.floats(0, 0.02))
def test_constant_velocities_make_an_arc(
    u: float, r: float, n: int, offset: float
) -> None:
    values = samples_of(lambda t: u, lambda t: r, n, 0.02)
    start, end = offset, 0.02 * n + offset
    got = integrate_odometry(values[0], values[1:], start, end, CONFIG)
    exact = constant_twist(u, r, end - start)
    assert got.dt_s == pytest.approx(end - start)
    np.testing.assert_allclose(got.delta, exact, atol=1e-9)
    np.testing.assert_array_equal(got.velocity, [u, r])


def fine(
    u: Callable[[float], float], r: Callable[[float], float], end_s: float
) -> Array:
    """Integrate velocities in 200 000 midpoint steps."""
    n = 200_000
    dt = end_s / n
    t = (np.arange(n) + 0.5) * dt
    rate = np.array([r(0.0) + (r(1.0) - r(0.0)) * t]).ravel()
    speed = np.array([u(0.0) + (u(1.0) - u(0.0)) * t]).ravel()
    heading = np.cumsum(rate * dt) - 0.5 * rate * dt
    x = (speed * np.cos(heading) * dt).sum()
    y = (speed * np.sin(heading) * dt).sum()
    return np.array([x, y, (rate * dt).sum()])


@pytest.mark.parametrize(
    ("a", "alpha"), [(0.0, 0.0), (6.0, 0.0), (0.0, 2.0), (-4.0, -1.5), (3.0, 1.0)]
)
def test_linearly_changing_velocities_converge_with_the_square_of_the_step(
    a: float, alpha: float
) -> None:
    def u(t: float) -> float:
        return 10.0 + a * t

    def r(t: float) -> float:
        return 0.5 + alpha * t

    exact = fine(u, r, 1.0)
    errors = []
    for n in (10, 20, 40):
        values = samples_of(u, r, n, 1.0 / n)
        got = integrate_odometry(values[0], values[1:], 0.0, 1.0, CONFIG).delta
        # The mean of two samples is the exact integral of a line.
        assert got[2] == pytest.approx(exact[2], abs=1e-9)
        errors.append(float(np.hypot(*(got - exact)[:2])))
    # In a segment D the heading departs from the chord's arc by at most
    # alpha D^2 / 8 and the speed from its mean by a D / 2, over a turn of r D.
    bound = (abs(alpha) * 16.0 + abs(a) * 3.0) / 8.0 * 0.1**2
    assert errors[0] <= bound + 1e-8
    assert errors[1] <= errors[0] / 3.0 + 1e-8
    assert errors[2] <= errors[1] / 3.0 + 1e-8


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 18))
def test_two_parts_split_at_a_sample_compose_to_the_whole(seed: int, cut: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.concatenate([[0.0], np.cumsum(rng.uniform(0.03, 0.3, 19))])
    values = [
        sample(t, rng.uniform(0, 20), rng.uniform(-2, 2)) for t in stamps.tolist()
    ]
    middle, end = values[cut].stamp_s, values[-1].stamp_s
    whole = integrate_odometry(values[0], values[1:], 0.0, end, CONFIG)
    first = integrate_odometry(values[0], values[1 : cut + 1], 0.0, middle, CONFIG)
    last = integrate_odometry(values[cut], values[cut + 1 :], middle, end, CONFIG)
    both = compose(first.delta, last.delta)
    turns = (whole.delta - both)[2] / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)
    np.testing.assert_allclose(both[:2], whole.delta[:2], atol=1e-9)
    by_first, by_last = np.eye(3), np.eye(3)
    by_last[:2, :2] = rotation(first.delta[2])
    moved = by_last[:2, :2] @ last.delta[:2]
    by_first[:2, 2] = -moved[1], moved[0]
    floor = np.diag([STEP_FLOOR_M2, STEP_FLOOR_M2, 0.0])
    cov = by_first @ (first.cov - floor) @ by_first.T
    cov += by_last @ (last.cov - floor) @ by_last.T + floor
    np.testing.assert_allclose(cov, whole.cov, atol=1e-12)
    by_bias = by_first @ first.bias_jacobian + by_last @ last.bias_jacobian
    np.testing.assert_allclose(by_bias, whole.bias_jacobian, atol=1e-9)


@settings(deadline=None)
@given(st.floats(0, 20), st.floats(-2, 2), st.floats(0.03, 0.97))
def test_a_constant_velocity_may_be_split_anywhere(
    u: float, r: float, cut: float
) -> None:
    values = samples_of(lambda t: u, lambda t: r, 10, 0.1)
    before = [v for v in values if v.stamp_s <= cut]
    after = [v for v in values if v.stamp_s > cut]
    first = integrate_odometry(before[0], before[1:], 0.0, cut, CONFIG)
    last = integrate_odometry(before[-1], after, cut, 1.0, CONFIG)
    both = compose(first.delta, last.delta)
    np.testing.assert_allclose(both, constant_twist(u, r, 1.0), atol=1e-9)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_bias_jacobian_is_the_derivative_by_a_constant_error_of_the_yaw_rate(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.arange(21) * 0.01
    u, r = rng.uniform(0, 20, 21), rng.uniform(-2, 2, 21)

    def delta(bias: Array) -> Array:
        values = [
            sample(*row) for row in zip(stamps.tolist(), u, r - bias[0], strict=True)
        ]
        return integrate_odometry(values[0], values[1:], 0.0, 0.2, CONFIG).delta

    values = [sample(*row) for row in zip(stamps.tolist(), u, r, strict=True)]
    got = integrate_odometry(values[0], values[1:], 0.0, 0.2, CONFIG).bias_jacobian
    want = differentiate(delta, np.zeros(1))[:, 0]
    # What is left out is how a turn shortens its own chord: u D * D |r D| / 12.
    left_out = 20.0 * 0.2 * 0.01 * 0.02 / 12.0
    np.testing.assert_allclose(got, want, atol=left_out)
    assert got[2] == pytest.approx(-0.2)


def test_white_errors_of_many_samples_add_up_to_c_d_t() -> None:
    spacing, n = 0.01, 100
    values = samples_of(lambda t: 10.0, lambda t: 0.0, n, spacing)
    got = integrate_odometry(values[0], values[1:], 0.0, 1.0, NO_SLIP)
    assert got.cov[0, 0] == pytest.approx(0.05**2 * spacing * 1.0 + STEP_FLOOR_M2)
    assert got.cov[2, 2] == pytest.approx(0.005**2 * spacing * 1.0)
    # Each yaw error turns the path behind it: sum c D^2 (u (T - t_i))^2 -> u^2 T^3/3.
    across = 0.005**2 * spacing * 10.0**2 / 3.0
    assert got.cov[1, 1] == pytest.approx(across + STEP_FLOOR_M2, rel=1e-3)
    assert got.cov[1, 2] == pytest.approx(0.005**2 * spacing * 10.0 / 2.0, rel=1e-6)


def test_an_interval_inside_one_sampling_interval_has_its_share_of_the_noise() -> None:
    values = samples_of(lambda t: 10.0, lambda t: 0.0, 1, 0.2)
    got = integrate_odometry(values[0], values[1:], 0.15, 0.2, NO_SLIP)
    want = 0.05**2 * 0.2 * 0.05
    assert got.cov[0, 0] == pytest.approx(want + STEP_FLOOR_M2)


def test_a_turn_is_never_exact() -> None:
    exact = np.zeros((2, 2))
    values = [VelocityObservation(0.1 * i, 10.0, 0.0, exact) for i in range(11)]
    got = integrate_odometry(values[0], values[1:], 0.0, 1.0, NO_SLIP).cov
    smallest = [STEP_FLOOR_M2, STEP_FLOOR_M2, STEP_FLOOR_RAD2]
    np.testing.assert_allclose(got, np.diag(smallest), atol=1e-15)


def test_slip_is_a_random_walk_across_the_path() -> None:
    slip = MotionConfig(slip_sigma_m_per_sqrt_m=0.1)
    values = samples_of(lambda t: 10.0, lambda t: 0.0, 10, 0.1)
    with_slip = integrate_odometry(values[0], values[1:], 0.0, 1.0, slip).cov
    without = integrate_odometry(values[0], values[1:], 0.0, 1.0, NO_SLIP).cov
    np.testing.assert_allclose(with_slip - without, np.diag([0, 0.1, 0]), atol=1e-12)


def test_a_velocity_held_for_too_long_gains_the_noise_of_free_accelerations() -> None:
    hold = CONFIG.odometry_hold_s
    one = sample(0.0, 10.0, 0.0)

    def cov(dt_s: float) -> Array:
        return integrate_odometry(one, [], 0.0, dt_s, NO_SLIP).cov

    # Within the hold the error of the one sample is held: (c dt) dt.
    assert cov(hold)[0, 0] == pytest.approx(0.05**2 * hold**2 + STEP_FLOOR_M2)
    late = hold + 0.5
    u_var = 0.05**2 + (CONFIG.accel_sigma_mps2 * 0.5) ** 2
    r_var = 0.005**2 + (CONFIG.yaw_accel_sigma_radps2 * 0.5) ** 2
    assert cov(late)[0, 0] == pytest.approx(u_var * late**2 + STEP_FLOOR_M2)
    assert cov(late)[2, 2] == pytest.approx(r_var * late**2)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_covariances_are_positive_definite(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 30))
    stamps = np.concatenate([[0.0], np.cumsum(rng.uniform(0.0, 0.3, n))])
    values = [
        sample(t, rng.uniform(-5, 30), rng.uniform(-5, 5)) for t in stamps.tolist()
    ]
    end = float(stamps[-1] + rng.uniform(0.001, 2.0))
    got = integrate_odometry(values[0], values[1:], 0.0, end, CONFIG)
    assert np.linalg.eigvalsh(got.cov)[0] > 0.0
    assert got.dt_s == pytest.approx(end)
