"""The laws of planar motion, and arcs against a fine numerical integration."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conegraph.geometry import (
    Array,
    between,
    compose,
    constant_twist,
    inverse,
    rotation,
    to_child,
    to_parent,
    wrap_angle,
)

coordinates = st.floats(-1e3, 1e3)
angles = st.floats(-50.0, 50.0)
poses = st.tuples(coordinates, coordinates, angles).map(np.array)
points = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=5).map(
    np.array
)


def assert_same_pose(actual: Array, expected: Array) -> None:
    np.testing.assert_allclose(actual[..., :2], expected[..., :2], atol=1e-8)
    turn = wrap_angle(actual[..., 2] - expected[..., 2])
    np.testing.assert_allclose(turn, 0.0, atol=1e-9)


@given(st.floats(-1e6, 1e6))
def test_wrapped_angle_is_the_same_direction_in_half_open_range(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    turns = (angle - wrapped) / (2 * np.pi)
    assert abs(turns - round(turns)) < 1e-9


def test_floats_next_to_odd_half_turns_stay_in_range() -> None:
    half_turns = (2 * np.arange(-200, 200) + 1) * np.pi
    near = [np.nextafter(half_turns, side) for side in (-np.inf, np.inf)]
    wrapped = wrap_angle(np.concatenate([half_turns, *near]))
    assert np.all((wrapped > -np.pi) & (wrapped <= np.pi))


def test_half_a_turn_either_way_is_plus_pi() -> None:
    np.testing.assert_array_equal(wrap_angle(np.array([np.pi, -np.pi])), [np.pi] * 2)
    assert wrap_angle(0.0) == 0.0


@given(poses, poses, poses)
def test_compose_is_associative(a: Array, b: Array, c: Array) -> None:
    assert_same_pose(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(poses)
def test_identity_and_inverse(a: Array) -> None:
    zero = np.zeros(3)
    assert_same_pose(compose(a, zero), a)
    assert_same_pose(compose(zero, a), a)
    assert_same_pose(compose(a, inverse(a)), zero)
    assert_same_pose(compose(inverse(a), a), zero)
    assert_same_pose(inverse(inverse(a)), a)


@given(poses, poses)
def test_between_undoes_compose(a: Array, b: Array) -> None:
    assert_same_pose(between(a, compose(a, b)), b)
    assert_same_pose(compose(a, between(a, b)), b)


@given(poses, poses)
def test_results_are_wrapped(a: Array, b: Array) -> None:
    for pose in (compose(a, b), inverse(a), between(a, b)):
        assert -np.pi < pose[2] <= np.pi


@given(st.lists(st.tuples(poses, poses), min_size=1, max_size=4))
def test_leading_axes_broadcast(pairs: list[tuple[Array, Array]]) -> None:
    a, b = (np.stack(side) for side in zip(*pairs, strict=True))
    rowwise = np.stack([compose(x, y) for x, y in pairs])
    np.testing.assert_array_equal(compose(a, b), rowwise)
    first = np.stack([compose(a[0], y) for y in b])
    np.testing.assert_array_equal(compose(a[0], b), first)


@given(angles)
def test_rotation_is_orthonormal_and_counter_clockwise(yaw: float) -> None:
    R = rotation(yaw)
    np.testing.assert_allclose(R @ R.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(R @ [1.0, 0.0], [np.cos(yaw), np.sin(yaw)], atol=1e-12)
    assert np.isclose(np.linalg.det(R), 1.0)


def test_rotation_by_a_quarter_turn_sends_forward_to_left() -> None:
    np.testing.assert_allclose(rotation(np.pi / 2) @ [1.0, 0.0], [0.0, 1.0], atol=1e-15)
    assert rotation(np.zeros((4, 3))).shape == (4, 3, 2, 2)


@given(poses, points)
def test_points_return_from_the_other_frame(pose: Array, xy: Array) -> None:
    np.testing.assert_allclose(to_child(pose, to_parent(pose, xy)), xy, atol=1e-8)


@given(poses, poses, points)
def test_points_follow_composed_poses(a: Array, b: Array, xy: Array) -> None:
    direct = to_parent(compose(a, b), xy)
    np.testing.assert_allclose(to_parent(a, to_parent(b, xy)), direct, atol=1e-8)


def test_a_cone_ahead_of_a_car_facing_left() -> None:
    car = np.array([1.0, 2.0, np.pi / 2])
    cone = to_parent(car, np.array([[3.0, 1.0]]))
    np.testing.assert_allclose(cone, [[0.0, 5.0]], atol=1e-12)


@given(st.floats(-30, 30), st.floats(-4, 4), st.floats(0.0, 0.5))
def test_constant_twist_is_the_limit_of_euler_steps(
    u: float, r: float, dt: float
) -> None:
    n = 20_000
    yaw = r * dt * (np.arange(n) + 0.5) / n
    fine = np.array([np.cos(yaw).sum(), np.sin(yaw).sum()]) * u * dt / n
    step = constant_twist(u, r, dt)
    np.testing.assert_allclose(step[:2], fine, atol=1e-6)
    assert np.isclose(step[2], r * dt)


@given(st.floats(-30, 30), st.floats(-4, 4), st.floats(0, 0.5), st.floats(0, 0.5))
def test_twists_held_one_after_the_other_add_up(
    u: float, r: float, dt_1: float, dt_2: float
) -> None:
    both = compose(constant_twist(u, r, dt_1), constant_twist(u, r, dt_2))
    assert_same_pose(both, constant_twist(u, r, dt_1 + dt_2))


def test_half_a_circle_ends_beside_the_start() -> None:
    np.testing.assert_allclose(
        constant_twist(np.pi, np.pi / 5.0, 5.0), [0.0, 10.0, np.pi], atol=1e-12
    )
