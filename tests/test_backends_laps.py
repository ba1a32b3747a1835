"""Laps on paths whose crossings are known exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from conegraph.backends.laps import LapCounter
from conegraph.config import StartLineConfig
from conegraph.types import Array, Lap

Any1d = NDArray[np.floating[Any]]

CONFIG = StartLineConfig(min_lap_m=30.0, half_width_m=6.0)
RADIUS_M = 10.0
LAP_M = 2 * np.pi * RADIUS_M


def drive(
    counter: LapCounter, stamps: Any1d, poses: Array, start: int = 0
) -> list[tuple[float, Lap]]:
    """Feed poses (N, 3), counting each step's length; return laps and when."""
    laps = []
    before = poses[0]
    for stamp, pose in zip(stamps[start:].tolist(), poses[start:], strict=True):
        moved = float(np.hypot(*(pose - before)[:2]))
        before = pose
        lap = counter.advance(stamp, pose, moved)
        if lap is not None:
            laps.append((stamp, lap))
    return laps


def circle(angle: Any1d) -> Array:
    """Return poses (N, 3) on a circle to the left that starts at the origin."""
    x, y = RADIUS_M * np.sin(angle), RADIUS_M * (1 - np.cos(angle))
    return np.stack([x, y, angle], axis=1)


def straight(x: Array, yaw: float = 0.0, y: float = 0.0) -> Array:
    return np.stack([x, np.full(len(x), y), np.full(len(x), yaw)], axis=1)


def test_laps_of_a_circle_are_timed_between_frames() -> None:
    # 2 rad/s, frames every 0.03 s: no frame lies on the gate at x = 1.
    stamps = np.arange(400) * 0.03
    laps = drive(LapCounter(CONFIG), stamps, circle(2.0 * stamps))
    first = np.arcsin(0.1) / 2.0
    assert [lap.number for _, lap in laps] == [1, 2, 3]
    for n, (stamp, lap) in enumerate(laps):
        # Chords of 0.6 m in place of an arc of radius 10: s^2 / 8 R is 5 mm.
        assert lap.start_s == pytest.approx(first + n * np.pi, abs=5e-4)
        assert lap.end_s == pytest.approx(first + (n + 1) * np.pi, abs=5e-4)
        assert lap.duration_s == pytest.approx(np.pi, abs=1e-3)
        assert lap.end_s <= stamp < lap.end_s + 0.03


@settings(deadline=None)
@given(st.floats(0.05, 5.0), st.floats(0.5, 20.0), st.floats(-3.0, 3.0))
def test_a_crossing_is_interpolated_exactly_on_a_straight(
    dt_s: float, speed: float, y: float
) -> None:
    counter = LapCounter(CONFIG)

    def pass_gate(start_s: float) -> Lap | None:
        # From 2.5 m before the gate at x = 1 with constant speed.
        x = -1.5 + speed * np.array([0.0, dt_s, 2 * dt_s])
        lap = None
        for n, pose in enumerate(straight(np.append(x, 30.0), y=y)):
            lap = lap or counter.advance(start_s + n * dt_s, pose, 40.0)
        return lap

    if speed * 2 * dt_s < 2.6:
        return
    assert pass_gate(0.0) is None
    lap = pass_gate(100.0)
    assert lap is not None
    assert lap.start_s == pytest.approx(2.5 / speed, rel=1e-9)
    assert lap.end_s == pytest.approx(100.0 + 2.5 / speed, rel=1e-9)


def test_a_crossing_where_the_car_never_was_starts_no_lap() -> None:
    stamps = np.arange(400) * 0.03
    poses = circle(2.0 * stamps)
    counter = LapCounter(CONFIG)
    # Thought to pass the gate after 0.05 s; found elsewhere after 1.5 s.
    assert drive(counter, stamps[:50], poses[:50]) == []
    counter.restart()
    laps = drive(counter, stamps, poses, start=50)
    assert [lap.number for _, lap in laps] == [1, 2]
    first = np.arcsin(0.1) / 2.0
    assert laps[0][1].start_s == pytest.approx(first + np.pi, abs=5e-4)


def test_driving_backwards_over_the_gate_does_not_count() -> None:
    counter = LapCounter(CONFIG)
    stamps = np.arange(200) * 0.1
    drive(counter, stamps, circle(stamps))
    # Now the other way round, facing the way it drives.
    poses = circle(-stamps)
    poses[:, 2] += np.pi
    assert drive(counter, 20.0 + stamps, poses) == []


def test_rolling_back_over_the_gate_does_not_count_either() -> None:
    counter = LapCounter(CONFIG)
    x = np.concatenate([np.arange(-50, 50.5, 1.0), np.arange(50, -50.5, -1.0)])
    laps = drive(counter, np.arange(len(x)) * 0.1, straight(x + 0.3))
    assert laps == []
    # Forward again, facing backwards all the time: still no crossing.
    assert drive(counter, 50.0 + np.arange(101) * 0.1, straight(x[:101], np.pi)) == []


def test_jitter_while_standing_on_the_gate_counts_nothing() -> None:
    rng = np.random.default_rng(0)
    counter = LapCounter(CONFIG)
    stamps = np.arange(5000) * 0.05
    x = 1.0 + 0.02 * rng.normal(size=5000)
    # The odometer counts every tremble: a lap's length three times over.
    assert np.abs(np.diff(x)).sum() > 3 * CONFIG.min_lap_m
    assert drive(counter, stamps, straight(x)) == []
    # Driving off from there, a lap ends one turn later and not before.
    poses = circle(np.linspace(0.1, 2 * np.pi + 0.2, 200))
    (first,) = drive(counter, 250.0 + 0.05 * np.arange(200), poses)
    assert first[1].number == 1
    # Standing there again ends no other.
    assert drive(counter, 300.0 + stamps, straight(x)) == []


def test_nothing_shorter_than_the_shortest_lap_is_one() -> None:
    long_laps = StartLineConfig(min_lap_m=LAP_M + 1.0)
    stamps = np.arange(1000) * 0.01
    angle = 4.08 * np.pi / 10.0 * stamps
    assert len(drive(LapCounter(CONFIG), stamps, circle(angle))) == 2
    assert drive(LapCounter(long_laps), stamps, circle(angle)) == []


def test_passing_beside_the_gate_does_not_count() -> None:
    for y, crossed in ((5.9, True), (6.1, False)):
        counter = LapCounter(CONFIG)
        x = np.arange(-20.5, 20.5, 1.0)
        drive(counter, 0.1 * np.arange(len(x)), straight(x, y=y))
        laps = drive(counter, 60.0 + 0.1 * np.arange(len(x)), straight(x, y=y))
        assert len(laps) == crossed


def test_crossing_at_more_than_sixty_degrees_does_not_count() -> None:
    for degrees, counts in ((59.0, 1), (61.0, 0)):
        counter = LapCounter(CONFIG)
        x = np.arange(-20.5, 20.5, 1.0)
        poses = straight(x, np.radians(degrees))
        drive(counter, 0.1 * np.arange(len(x)), poses)
        assert len(drive(counter, 60.0 + 0.1 * np.arange(len(x)), poses)) == counts


def test_the_gate_stands_between_the_start_cones() -> None:
    counter = LapCounter(CONFIG)
    counter.locate_gate(np.array([[6.0, 1.5], [6.4, 1.5], [6.0, -2.5], [6.4, -2.5]]))
    np.testing.assert_allclose(counter.gate.middle_m, [6.2, -0.5])
    np.testing.assert_allclose(counter.gate.forward, [1.0, 0.0], atol=1e-12)
    counter.locate_gate(np.array([[6.0, 1.0], [8.0, -1.0]]))
    np.testing.assert_allclose(counter.gate.middle_m, [7.0, 0.0])
    np.testing.assert_allclose(counter.gate.forward, np.array([1.0, 1.0]) / 2**0.5)


@pytest.mark.parametrize(
    "cones",
    [
        [[6.0, 1.5]],
        [[6.0, 1.5], [6.4, 2.5]],  # one side only
        [[6.0, 0.3], [6.0, -0.3]],  # too narrow for a car
        [[6.0, 7.0], [6.0, -7.0]],  # wider than any gate
        [[40.0, 1.5], [40.0, -1.5]],  # not where the car started
    ],
)
def test_cones_that_make_no_gate_leave_it_where_it_was(
    cones: list[list[float]],
) -> None:
    counter = LapCounter(CONFIG)
    counter.locate_gate(np.array(cones))
    np.testing.assert_array_equal(counter.gate.middle_m, [1.0, 0.0])


def test_a_gate_that_is_found_after_the_first_crossing_times_from_itself() -> None:
    counter = LapCounter(CONFIG)
    stamps = np.arange(400) * 0.02
    poses = circle(2 * np.pi / 5.0 * stamps)
    drive(counter, stamps[:11], poses[:11])
    assert poses[10, 0] > 1.0
    # At 5 m ahead, across the circle there: crossed again within 30 m of the first.
    counter.locate_gate(np.array([[5.0, 4.0], [5.0, -1.0]]))
    laps = drive(counter, stamps, poses, start=11)
    assert len(laps) == 1
    start = np.arcsin(0.5) / (2 * np.pi / 5.0)
    assert laps[0][1].start_s == pytest.approx(start, abs=1e-3)
    assert laps[0][1].duration_s == pytest.approx(5.0, abs=1e-3)
    # From the first timed lap on the gate stays.
    counter.locate_gate(np.array([[9.0, 4.0], [9.0, -1.0]]))
    np.testing.assert_allclose(counter.gate.middle_m, [5.0, 1.5])
