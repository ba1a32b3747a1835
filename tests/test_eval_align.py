"""The alignment that errors are measured after."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conegraph.eval.align import align_first_pose, align_se2
from conegraph.geometry import compose, to_parent
from conegraph.types import Array

LARGE = st.floats(-1e3, 1e3)


def points(seed: int, n: int = 20) -> Array:
    return np.random.default_rng(seed).normal(0.0, 10.0, (n, 2))


@given(x=LARGE, y=LARGE, yaw=st.floats(-3.14, 3.14), seed=st.integers(0, 99))
def test_a_known_motion_is_found_exactly(
    x: float, y: float, yaw: float, seed: int
) -> None:
    motion, source = np.array([x, y, yaw]), points(seed)
    found = align_se2(source, to_parent(motion, source))
    np.testing.assert_allclose(found.pose, motion, atol=1e-9)
    assert found.rmse_m == pytest.approx(0.0, abs=1e-9)


def test_what_is_left_is_what_no_motion_can_remove() -> None:
    """A 4 m x 2 m rectangle onto one of 4.4 m x 2 m: every corner is 0.2 m off."""
    source = np.array([[2.0, 1.0], [2.0, -1.0], [-2.0, -1.0], [-2.0, 1.0]])
    found = align_se2(source, source * [1.1, 1.0])
    np.testing.assert_allclose(found.pose, 0.0, atol=1e-15)
    assert found.rmse_m == pytest.approx(0.2)


def test_agrees_with_gtsam_on_noisy_points() -> None:
    rng = np.random.default_rng(7)
    source = points(1, 50)
    target = to_parent(np.array([3.0, -8.0, 2.5]), source)
    target = target + rng.normal(0.0, 0.5, target.shape)
    expected = gtsam.Pose2.Align(target.T, source.T)
    assert expected is not None
    pose = np.array([expected.x(), expected.y(), expected.theta()])
    np.testing.assert_allclose(align_se2(source, target).pose, pose, atol=1e-6)


def test_no_other_motion_leaves_less() -> None:
    rng = np.random.default_rng(3)
    source = points(2)
    target = to_parent(np.array([1.0, 2.0, 0.5]), source)
    target = target + rng.normal(0.0, 0.3, target.shape)
    best = align_se2(source, target)
    for nudge in rng.normal(0.0, 1e-3, (50, 3)):
        error = to_parent(best.pose + nudge, source) - target
        assert np.sqrt(np.mean(np.sum(error**2, axis=1))) >= best.rmse_m


def test_one_point_fixes_no_yaw_and_none_fixes_nothing() -> None:
    one = align_se2(np.array([[1.0, 2.0]]), np.array([[4.0, -1.0]]))
    np.testing.assert_allclose(one.pose, [3.0, -3.0, 0.0])
    none = align_se2(np.zeros((0, 2)), np.zeros((0, 2)))
    np.testing.assert_array_equal(none.pose, 0.0)
    assert np.isnan(none.rmse_m)


def test_sets_that_do_not_pair_up_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(3, 2\), \(2, 2\)"):
        align_se2(np.zeros((3, 2)), np.zeros((2, 2)))


def test_first_poses_coincide_afterwards() -> None:
    source, target = np.array([1.0, 2.0, 3.0]), np.array([-5.0, 0.5, -2.0])
    np.testing.assert_allclose(
        compose(align_first_pose(source, target), source), target, atol=1e-12
    )
