"""Start cones taken for start cones: the one pose that all cones agree on."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.start_line import GateMatch, match_gate, sides
from conegraph.geometry import to_child, wrap_angle
from conegraph.types import Array

# A gate and a stretch of cones that nothing else on the map repeats.
START = np.array([[6.0, 2.0], [6.3, -2.0]])
LANE = np.array(
    [[9.0, 2.2], [12.0, 3.5], [16.0, 3.0], [10.0, -1.4], [13.5, -2.0], [17.0, -0.5]]
)
MAP = np.vstack([START, LANE, LANE[::-1] * 1.3 + (40.0, 25.0)])
N_START = np.arange(2)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_pose_is_found_wherever_the_car_was_taken_to_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-3, 3, 2), rng.uniform(-0.4, 0.4)])
    seen = to_child(pose, MAP[:8])
    seen = seen + 0.02 * rng.normal(size=seen.shape)
    order = rng.permutation(8)
    start = np.flatnonzero(order < 2)
    found = match_gate(seen[order], start, MAP, N_START)
    assert isinstance(found, GateMatch)
    assert found.agreement == 1.0
    # Two cones 4 m apart, each off by 2 cm a coordinate: a turn of the order of
    # 7 mrad, and that at up to 10 m from the gate.
    assert np.hypot(*(found.pose - pose)[:2]) < 0.3
    assert abs(float(wrap_angle(found.pose[2] - pose[2]))) < 0.03
    np.testing.assert_array_equal(order[found.row], found.slot)


def test_a_lane_of_start_cones_is_found_in_the_time_of_a_frame() -> None:
    rng = np.random.default_rng(4)
    x = np.arange(0.0, 15.0, 1.25)
    lane = np.vstack([np.stack([x, np.full(12, y)], axis=1) for y in (1.5, -1.5)])
    mapped = np.vstack([lane, rng.uniform(-10.0, 25.0, (12, 2)), LANE + 60.0])
    pose = np.array([1.0, 0.5, 0.1])
    seen = to_child(pose, mapped[:36])
    began = time.process_time()
    found = match_gate(seen, np.arange(24), mapped, np.arange(24))
    # One pair after the other it took half a minute.
    assert time.process_time() - began < 1.0
    assert isinstance(found, GateMatch)
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    np.testing.assert_array_equal(found.slot, np.arange(24))


def test_start_cones_as_far_apart_as_none_of_the_map_tell_nothing() -> None:
    seen = np.array([[6.0, 4.0], [6.0, -4.0], [9.0, 2.0]])
    found = match_gate(seen, np.arange(2), MAP, N_START)
    assert found == "no two start cones as far apart as the map's"


def test_two_poses_that_explain_as_much_tell_nothing() -> None:
    # Two cones alone fit either way round.
    found = match_gate(START, N_START, START, N_START)
    assert found == "2 cones agree, but 2 with another pose"


def test_cones_that_contradict_lower_the_agreement() -> None:
    wrong = np.array([[3.0, -9.0], [20.0, -15.0]])
    seen = np.vstack([START, LANE, wrong])
    found = match_gate(seen, N_START, MAP, N_START)
    assert isinstance(found, GateMatch)
    assert found.agreement == pytest.approx(8 / 10)


def test_two_gates_alike_are_not_told_apart() -> None:
    far = np.array([100.0, 50.0])
    twin = np.vstack([START, LANE, START + far, LANE + far])
    start = np.array([0, 1, 8, 9])
    found = match_gate(np.vstack([START, LANE]), N_START, twin, start)
    assert isinstance(found, str)
    assert found == "8 cones agree, but 8 with another pose"


def test_sides_are_sorted_by_distance() -> None:
    xy: Array = np.array([[9.0, 1.0], [5.0, 2.0], [4.0, -1.0], [3.0, -2.0], [8.0, 0.0]])
    left, right = sides(xy)
    np.testing.assert_array_equal(left, [1, 0])
    np.testing.assert_array_equal(right, [3, 2, 4])
