"""The filter's algebra against dense textbook formulas, and its symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.landmark_filter import LandmarkFilter
from conegraph.backends.motion import NV, predict_midpoint
from conegraph.backends.sensor_noise import transport_covariance
from conegraph.config import MotionConfig
from conegraph.geometry import compose, rotation, wrap_angle
from conegraph.types import Array, IntArray, SensorModel

MODEL = SensorModel(np.array([0.05, 0.0, 0.0025]), 0.01, 0.02)
seeds = st.integers(0, 2**32 - 1)


def slots(*index: int) -> IntArray:
    return np.array(index, dtype=np.int64)


def covariance(rng: np.random.Generator, n: int, sigma: float) -> Array:
    root = rng.normal(size=(n, n + 3)) * sigma / np.sqrt(n + 3)
    return np.asarray(root @ root.T)


def random_filter(
    rng: np.random.Generator, n_cones: int, *, invariant: bool, sigma: float = 0.1
) -> LandmarkFilter:
    state = np.concatenate(
        [
            rng.uniform(-20, 20, 2),
            rng.uniform(-2, 2, 1),
            [rng.uniform(0, 10), rng.uniform(-1, 1), rng.uniform(-0.01, 0.01)],
            rng.uniform(-30, 30, 2 * n_cones),
        ]
    )
    filter_ = LandmarkFilter(invariant=invariant)
    filter_.load(state, covariance(rng, len(state), sigma))
    return filter_


def everything(filter_: LandmarkFilter) -> tuple[Array, Array]:
    """Return the whole state and covariance, correlations too."""
    return filter_._x.copy(), filter_._P.copy()


def observe(x: Array, slot: IntArray) -> Array:
    """Predict cones in the car frame straight from a state (n,)."""
    cones = x[NV:].reshape(-1, 2)[slot]
    seen: Array = ((cones - x[:2]) @ rotation(x[2])).ravel()
    return seen


def numeric_jacobian(x: Array, slot: IntArray) -> Array:
    columns = []
    for nudge in 1e-6 * np.eye(len(x)):
        columns.append((observe(x + nudge, slot) - observe(x - nudge, slot)) / 2e-6)
    return np.stack(columns, axis=1)


def block_diagonal(blocks: Array) -> Array:
    k = len(blocks)
    R = np.zeros((2 * k, 2 * k))
    for i, block in enumerate(blocks):
        R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
    return R


def seen_cones(rng: np.random.Generator, k: int) -> tuple[Array, Array]:
    cov = np.stack([covariance(rng, 2, 0.2) + 0.01 * np.eye(2) for _ in range(k)])
    return rng.uniform(-10, 10, (k, 2)), cov


def world_turn(x: Array) -> Array:
    """Return (n,) how the state moves when the whole world turns by one radian."""
    n = np.zeros(len(x))
    n[0], n[1], n[2] = -x[1], x[0], 1.0
    n[NV::2], n[NV + 1 :: 2] = -x[NV + 1 :: 2], x[NV::2]
    return n


def heading_information(filter_: LandmarkFilter) -> float:
    """Return what the filter claims to know of the heading of the whole world."""
    x, P = everything(filter_)
    n = world_turn(x)
    return float(n @ np.linalg.solve(P, n))


def test_starts_at_the_origin_with_the_doubts_asked_for() -> None:
    filter_ = LandmarkFilter(0.01, 2.0)
    assert not filter_.vehicle.any()
    want = np.diag([0, 0, 0, 4.0, 0.4**2, 0.01**2])
    np.testing.assert_allclose(filter_.vehicle_cov, want)
    assert filter_.n_landmarks == 0
    assert filter_.cones_in_car_frame().shape == (0, 2)


def test_one_cone_straight_ahead_by_hand() -> None:
    filter_ = LandmarkFilter()
    filter_.place_car(np.zeros(3), np.diag([1.0, 0.5, 0.0]))
    filter_.place_cones(np.array([[10.0, 0.0]]), np.array([np.diag([1.0, 0.5])]))
    R = np.array([np.diag([2.0, 1.0])])
    filter_.update_cones(slots(0), np.array([[11.0, 0.4]]), R, None)
    # x: Z = 1 + 1 + 2 = 4, so the residual of 1 moves cone and car by a quarter
    # each; y: Z = 0.5 + 0.5 + 1 = 2, so the residual of 0.4 moves each by 0.1.
    np.testing.assert_allclose(filter_.landmarks_m, [[10.25, 0.1]])
    np.testing.assert_allclose(filter_.vehicle[:3], [-0.25, -0.1, 0.0], atol=1e-15)
    # P - P H' Z^-1 H P: 1 - 1/4 and 0.5 - 0.25/2.
    np.testing.assert_allclose(filter_.landmark_covs()[0], np.diag([0.75, 0.375]))
    np.testing.assert_allclose(
        filter_.vehicle_cov[:2, :2], np.diag([0.75, 0.375]), atol=1e-15
    )


def test_a_bearing_turns_the_car() -> None:
    filter_ = LandmarkFilter(invariant=False)
    filter_.place_car(np.zeros(3), np.diag([0.0, 0.0, 0.01]))
    filter_.place_cones(np.array([[10.0, 0.0]]), np.zeros((1, 2, 2)))
    cov = np.array([np.eye(2)])
    filter_.update_cones(slots(0), np.array([[10.0, 0.2]]), cov, None)
    # A cone seen to the left of a known one means that the car points right of
    # where it was taken to: gain 0.01 * 10 / (0.01 * 100 + 1) = 0.05.
    assert filter_.vehicle[2] == pytest.approx(-0.05 * 0.2)
    assert filter_.vehicle_cov[2, 2] == pytest.approx(0.005)


@settings(deadline=None)
@given(seeds, st.integers(1, 5), st.integers(0, 3))
def test_joint_update_equals_the_dense_textbook_formula(
    seed: int, k: int, others: int
) -> None:
    rng = np.random.default_rng(seed)
    filter_ = random_filter(rng, k + others, invariant=False)
    slot = rng.permutation(k + others)[:k].astype(np.int64)
    xy, cov = seen_cones(rng, k)
    x, P = everything(filter_)
    H, h = numeric_jacobian(x, slot), observe(x, slot)
    Z = H @ P @ H.T + block_diagonal(cov)
    K = P @ H.T @ np.linalg.inv(Z)
    want = x + K @ (xy.ravel() - h)
    predicted = filter_.predict_cones(slot)
    np.testing.assert_allclose(predicted.xy_m.ravel(), h, atol=1e-12)
    np.testing.assert_allclose(predicted.cov_m2, H @ P @ H.T, atol=1e-6)
    innovation = filter_.innovation(slot, xy, cov, None)
    residual = xy.ravel() - h
    assert innovation.dof == 2 * k
    assert innovation.nis == pytest.approx(
        residual @ np.linalg.solve(Z, residual), rel=1e-5
    )
    filter_.update_cones(slot, xy, cov, None)
    got_x, got_cov = everything(filter_)
    want[2] = wrap_angle(want[2])
    np.testing.assert_allclose(got_x, want, atol=1e-4)
    np.testing.assert_allclose(got_cov, P - K @ Z @ K.T, atol=1e-5)


@settings(deadline=None)
@given(seeds, st.booleans())
def test_with_a_model_the_noise_is_that_of_the_predicted_place(
    seed: int, invariant: bool
) -> None:
    rng = np.random.default_rng(seed)
    one = random_filter(rng, 3, invariant=invariant)
    other = LandmarkFilter(invariant=invariant)
    other.load(*everything(one))
    slot = slots(2, 0)
    xy, cov = seen_cones(rng, 2)
    there = transport_covariance(cov, xy, one.cones_in_car_frame()[slot], MODEL)
    seen = one.innovation(slot, xy, cov, MODEL)
    assert seen.nis == pytest.approx(other.innovation(slot, xy, there, None).nis)
    one.update_cones(slot, xy, cov, MODEL)
    other.update_cones(slot, xy, there, None)
    np.testing.assert_allclose(everything(one)[0], everything(other)[0], atol=1e-12)
    np.testing.assert_allclose(everything(one)[1], everything(other)[1], atol=1e-12)


@settings(deadline=None)
@given(seeds)
def test_velocity_update_equals_the_dense_textbook_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    filter_ = random_filter(rng, 2, invariant=False)
    x, P = everything(filter_)
    H = np.zeros((2, len(x)))
    H[0, 3] = H[1, 4] = H[1, 5] = 1.0
    cov = covariance(rng, 2, 0.3) + 0.01 * np.eye(2)
    Z = H @ P @ H.T + cov
    K = P @ H.T @ np.linalg.inv(Z)
    want = x + K @ (np.array([7.0, 0.3]) - H @ x)
    want[2] = wrap_angle(want[2])
    filter_.update_velocity(7.0, 0.3, cov)
    np.testing.assert_allclose(everything(filter_)[0], want, atol=1e-10)
    np.testing.assert_allclose(everything(filter_)[1], P - K @ Z @ K.T, atol=1e-10)


@settings(deadline=None)
@given(seeds, st.booleans())
def test_new_cones_are_correlated_as_their_jacobians_say(
    seed: int, invariant: bool
) -> None:
    rng = np.random.default_rng(seed)
    filter_ = random_filter(rng, 2, invariant=invariant)
    x, P = everything(filter_)
    xy, cov = seen_cones(rng, 3)
    new = filter_.add_cones(xy, cov)
    np.testing.assert_array_equal(new, [2, 3, 4])
    # l = R y + p: its Jacobians by the pose (2, 3) and by the measurement, R.
    R = rotation(x[2])
    by_pose = np.zeros((6, len(x)))
    for i, (sx, sy) in enumerate(xy @ R.T):
        by_pose[2 * i : 2 * i + 2, :3] = [[1.0, 0.0, -sy], [0.0, 1.0, sx]]
    want = np.block(
        [
            [P, P @ by_pose.T],
            [by_pose @ P, by_pose @ P @ by_pose.T + block_diagonal(R @ cov @ R.T)],
        ]
    )
    got_x, got_cov = everything(filter_)
    np.testing.assert_allclose(got_x[NV + 4 :], (x[:2] + xy @ R.T).ravel())
    np.testing.assert_allclose(got_cov, want, atol=1e-12)


@settings(deadline=None)
@given(seeds)
def test_a_cone_just_added_is_predicted_with_its_own_noise_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    filter_ = random_filter(rng, 1, invariant=True)
    xy, cov = seen_cones(rng, 2)
    predicted = filter_.predict_cones(filter_.add_cones(xy, cov))
    np.testing.assert_allclose(predicted.xy_m, xy, atol=1e-9)
    np.testing.assert_allclose(predicted.cov_m2, block_diagonal(cov), atol=1e-9)


@settings(deadline=None)
@given(seeds, st.booleans())
def test_covariance_stays_symmetric_and_positive(seed: int, invariant: bool) -> None:
    rng = np.random.default_rng(seed)
    filter_ = LandmarkFilter(0.01, 2.0, invariant=invariant)
    config = MotionConfig()
    for _ in range(8):
        filter_.predict(predict_midpoint(filter_.vehicle, 0.05, config))
        if filter_.n_landmarks:
            slot = np.arange(filter_.n_landmarks, dtype=np.int64)
            seen = filter_.cones_in_car_frame()
            xy = seen + 0.1 * rng.normal(size=seen.shape)
            filter_.update_cones(slot, xy, MODEL.covariance(xy), MODEL)
        if filter_.n_landmarks < 6:
            xy = rng.uniform([2, -5], [12, 5], (2, 2))
            filter_.add_cones(xy, MODEL.covariance(xy))
        filter_.update_velocity(5.0, 0.2, np.diag([0.01, 0.001]))
    P = everything(filter_)[1]
    np.testing.assert_allclose(P, P.T, atol=1e-10)
    assert np.linalg.eigvalsh(0.5 * (P + P.T))[0] > -1e-9


def test_prediction_moves_the_car_and_leaves_the_cones() -> None:
    rng = np.random.default_rng(3)
    filter_ = random_filter(rng, 3, invariant=True)
    x, P = everything(filter_)
    step = predict_midpoint(filter_.vehicle, 0.1, MotionConfig())
    filter_.predict(step)
    got_x, got_cov = everything(filter_)
    np.testing.assert_array_equal(got_x[:NV], step.state)
    np.testing.assert_array_equal(got_x[NV:], x[NV:])
    np.testing.assert_array_equal(got_cov[NV:, NV:], P[NV:, NV:])
    np.testing.assert_allclose(got_cov[:NV, NV:], step.F @ P[:NV, NV:])
    np.testing.assert_array_equal(got_cov[NV:, :NV], got_cov[:NV, NV:].T)
    np.testing.assert_allclose(
        got_cov[:NV, :NV], step.F @ P[:NV, :NV] @ step.F.T + step.Q
    )


def test_placing_the_car_forgets_its_correlations_and_inflating_adds() -> None:
    filter_ = random_filter(np.random.default_rng(3), 2, invariant=True)
    x, P = everything(filter_)
    cov = np.diag([1.0, 2.0, 0.1])
    filter_.place_car(np.array([1.0, 2.0, 0.5]), cov)
    filter_.inflate(np.diag([0.0, 0.0, 0.0, 3.0, 0.0, 0.0]))
    got_x, got_cov = everything(filter_)
    np.testing.assert_array_equal(got_x, [1.0, 2.0, 0.5, *x[3:]])
    want = P.copy()
    want[:3], want[:, :3] = 0.0, 0.0
    want[:3, :3] = cov
    want[3, 3] += 3.0
    np.testing.assert_array_equal(got_cov, want)


def test_known_cones_are_independent_of_all_and_of_each_other() -> None:
    filter_ = random_filter(np.random.default_rng(4), 1, invariant=True)
    _, P = everything(filter_)
    filter_.place_cones(
        np.array([[1.0, 2.0], [3.0, 4.0]]),
        np.array([np.diag([1.0, 2.0]), np.diag([3.0, 4.0])]),
    )
    got = everything(filter_)[1]
    np.testing.assert_array_equal(got[:8, :8], P)
    np.testing.assert_array_equal(got[8:, 8:], np.diag([1.0, 2.0, 3.0, 4.0]))
    assert not got[:8, 8:].any()


def test_keep_drops_rows_and_columns() -> None:
    filter_ = random_filter(np.random.default_rng(5), 3, invariant=True)
    x, P = everything(filter_)
    filter_.keep(np.array([True, False, True]))
    rows = [*range(8), 10, 11]
    np.testing.assert_array_equal(everything(filter_)[0], x[rows])
    np.testing.assert_array_equal(everything(filter_)[1], P[np.ix_(rows, rows)])


def test_separation_of_cones() -> None:
    filter_ = random_filter(np.random.default_rng(6), 4, invariant=True)
    x, P = everything(filter_)
    gap, cov = filter_.separation(slots(0, 3), slots(2, 1))
    for n, (a, b) in enumerate([(6, 10), (12, 8)]):
        pick = np.zeros((2, len(x)))
        pick[:, a : a + 2], pick[:, b : b + 2] = np.eye(2), -np.eye(2)
        np.testing.assert_allclose(gap[n], pick @ x)
        np.testing.assert_allclose(cov[n], pick @ P @ pick.T, atol=1e-12)


def test_two_cones_made_one_meet_where_their_weights_say() -> None:
    filter_ = LandmarkFilter()
    filter_.place_cones(
        np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([np.eye(2), 3.0 * np.eye(2)])
    )
    filter_.equate(0, 1, 1e-6)
    # Weights 1 and 1/3: a quarter of the way from the surer one.
    np.testing.assert_allclose(filter_.landmarks_m, [[0.25, 0.0]] * 2, atol=1e-9)
    np.testing.assert_allclose(filter_.landmark_covs()[0], 0.75 * np.eye(2), atol=1e-9)


@settings(deadline=None)
@given(seeds, st.booleans())
def test_a_problem_moved_as_a_whole_has_the_solution_moved_as_a_whole(
    seed: int, invariant: bool
) -> None:
    rng = np.random.default_rng(seed)
    one = random_filter(rng, 4, invariant=invariant)
    x, P = everything(one)
    move = np.array([*rng.uniform(-50, 50, 2), rng.uniform(-3, 3)])

    def moved(state: Array) -> Array:
        new = state.copy()
        new[:3] = compose(move, state[:3])
        new[NV:] = (state[NV:].reshape(-1, 2) @ rotation(move[2]).T + move[:2]).ravel()
        return new

    turn = np.eye(len(x))
    for first in [0, *range(NV, len(x), 2)]:
        turn[first : first + 2, first : first + 2] = rotation(move[2])
    other = LandmarkFilter(invariant=invariant)
    other.load(moved(x), turn @ P @ turn.T)
    measured = [seen_cones(rng, 2) for _ in range(3)]
    for filter_ in (one, other):
        for n, (xy, cov) in enumerate(measured):
            step = predict_midpoint(filter_.vehicle, 0.1, MotionConfig())
            filter_.predict(step)
            seen = filter_.cones_in_car_frame()[[n, n + 1]]
            filter_.update_cones(slots(n, n + 1), seen + 0.01 * xy, cov, MODEL)
        filter_.update_velocity(4.0, 0.1, np.diag([0.1, 0.01]))
        filter_.add_cones(measured[0][0], measured[0][1])
    turn = np.eye(len(x) + 4)
    for first in [0, *range(NV, len(x) + 4, 2)]:
        turn[first : first + 2, first : first + 2] = rotation(move[2])
    got, want = everything(other), everything(one)
    gap = got[0] - moved(want[0])
    gap[2] = wrap_angle(gap[2])
    np.testing.assert_allclose(gap, 0.0, atol=1e-8)
    np.testing.assert_allclose(got[1], turn @ want[1] @ turn.T, atol=1e-8)


def drift(invariant: bool) -> tuple[float, float]:
    """Update many times with noisy cones; return the heading information gained."""
    rng = np.random.default_rng(11)
    filter_ = random_filter(rng, 5, invariant=invariant)
    x, P = everything(filter_)
    turn = world_turn(x)
    filter_.load(x, P + 0.01 * np.eye(len(x)) + np.outer(turn, turn))
    before = heading_information(filter_)
    for _ in range(30):
        seen = filter_.cones_in_car_frame()
        xy = seen + 0.3 * rng.normal(size=seen.shape)
        cov = np.tile(0.09 * np.eye(2), (len(xy), 1, 1))
        filter_.update_cones(np.arange(5, dtype=np.int64), xy, cov, None)
    return before, heading_information(filter_)


def test_cones_tell_nothing_of_the_heading_of_the_whole_world() -> None:
    # H n = 0 for the turn n of the world, so no update may add to n' P^-1 n; that
    # it does where each update linearises at another estimate is what `invariant`
    # mends.
    before, after = drift(invariant=True)
    assert after == pytest.approx(before, rel=1e-6)
    before, after = drift(invariant=False)
    assert after > 100.0 * before


def test_driving_and_mapping_tell_nothing_of_it_either() -> None:
    rng = np.random.default_rng(12)
    filter_ = random_filter(rng, 3, invariant=True, sigma=0.3)
    x, P = everything(filter_)
    filter_.load(x, P + 0.01 * np.eye(len(x)))
    known = [heading_information(filter_)]
    for _ in range(20):
        filter_.predict(predict_midpoint(filter_.vehicle, 0.05, MotionConfig()))
        seen = filter_.cones_in_car_frame()
        xy = seen + 0.1 * rng.normal(size=seen.shape)
        cov = np.tile(0.01 * np.eye(2), (len(xy), 1, 1))
        filter_.update_cones(np.arange(len(xy), dtype=np.int64), xy, cov, None)
        filter_.update_velocity(5.0, 0.3, np.diag([0.01, 0.001]))
        if filter_.n_landmarks < 8:
            filter_.add_cones(rng.uniform(2, 8, (1, 2)), 0.01 * np.eye(2)[None])
        known.append(heading_information(filter_))
    assert (np.diff(known) <= 1e-6 * known[0]).all()
