"""Skidpad and acceleration by the rules, and their times."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.geometry import to_parent
from conegraph.track.events import Event, plan_event, segment_times
from conegraph.types import Array, Trajectory

SPEED_MPS = 5.0


@pytest.mark.parametrize("start", [np.zeros(3), np.array([100.0, -30.0, 2.0])])
def test_four_circles_of_the_skidpad_take_equal_times(start: Array) -> None:
    plan = plan_event(Event.SKIDPAD, start)
    poses = np.column_stack([plan.path_m, np.zeros(len(plan.path_m))])
    times = segment_times(plan, Trajectory(plan.s_m / SPEED_MPS, poses))
    assert [t.name for t in times] == ["right", "right timed", "left", "left timed"]
    assert [t.timed for t in times] == [False, True, False, True]
    # A circle through the middle of the lane has 9.125 m radius.
    circle_s = 2 * np.pi * 9.125 / SPEED_MPS
    assert [t.duration_s for t in times] == pytest.approx([circle_s] * 4, rel=1e-3)


def test_the_skidpad_turns_right_first() -> None:
    plan = plan_event(Event.SKIDPAD)
    quarter = np.searchsorted(plan.s_m, 15.0 + 0.5 * np.pi * 9.125)
    assert plan.path_m[quarter] == pytest.approx([15 + 9.125, -9.125], abs=0.3)
    assert plan.path_m[-1, 1] == pytest.approx(0.0, abs=1e-6)


def test_acceleration_is_timed_over_75_m() -> None:
    start = np.array([5.0, 5.0, -1.0])
    plan = plan_event(Event.ACCELERATION, start)
    poses = np.column_stack([plan.path_m, np.zeros(len(plan.path_m))])
    (time,) = segment_times(plan, Trajectory(plan.s_m / SPEED_MPS, poses))
    assert time.duration_s == pytest.approx(75.0 / SPEED_MPS, rel=1e-6)
    assert plan.stop_s_m > 75.3
    expected = to_parent(start, np.array([[75.3, 0.0]]))[0]
    assert plan.finish_pose is not None
    assert plan.finish_pose[:2] == pytest.approx(expected)


def test_who_stops_half_way_has_no_time() -> None:
    plan = plan_event(Event.ACCELERATION)
    poses = np.column_stack([plan.path_m, np.zeros(len(plan.path_m))])[:100]
    assert segment_times(plan, Trajectory(plan.s_m[:100], poses)) == ()
