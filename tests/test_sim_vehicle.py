"""The car against closed forms: how long, how fast, and yaw rates that add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.sim.driving_line import driving_line
from conegraph.sim.polyline import nearest
from conegraph.sim.track_shapes import built_in_track
from conegraph.sim.vehicle import Motion, VehicleModel, drive_line
from conegraph.types import Array

STEADY = VehicleModel(wander_m=0.0)


def straight(length_m: float) -> Array:
    x = np.linspace(0.0, length_m, round(length_m / 0.25) + 1)
    return np.column_stack([x, np.zeros_like(x)])


def circle(radius_m: float) -> Array:
    turn = np.linspace(0, 2 * np.pi, round(8 * np.pi * radius_m), endpoint=False)
    return radius_m * np.column_stack([np.sin(turn), 1 - np.cos(turn)])


def drive(
    line: Array, closed: bool, model: VehicleModel = STEADY, laps: int = 1
) -> Motion:
    return drive_line(line, closed, np.random.default_rng(0), laps=laps, model=model)


@pytest.mark.parametrize("length_m", [100.0, 300.0])
def test_a_straight_takes_as_long_as_the_accelerations_say(length_m: float) -> None:
    """Ramps of v / a and v / b up to 15 m/s, the rest of the way at 15 m/s."""
    motion = drive(straight(length_m), closed=False)
    ramps = 15.0**2 / (2 * 5.0) + 15.0**2 / (2 * 7.0)
    moving = 15.0 / 5.0 + 15.0 / 7.0 + (length_m - ramps) / 15.0
    assert motion.duration_s == pytest.approx(moving + 2 * STEADY.stand_s, abs=0.02)
    last = motion.pose(np.array([motion.duration_s]))[0]
    np.testing.assert_allclose(last, [length_m, 0.0, 0.0], atol=1e-6)


def test_a_short_straight_never_reaches_top_speed() -> None:
    """Speeding up meets braking at v^2 = 2 L a b / (a + b)."""
    motion = drive(straight(20.0), closed=False)
    u = motion.velocity(np.arange(0, motion.duration_s, 0.001))[:, 0]
    assert u.max() == pytest.approx(np.sqrt(2 * 20 * 5 * 7 / 12), rel=0.01)


def test_on_a_circle_it_holds_the_speed_that_its_tyres_allow() -> None:
    motion = drive(circle(10.0), closed=True, laps=4)
    u, r = motion.velocity(np.arange(8.0, 12.0, 0.01)).T
    np.testing.assert_allclose(u, np.sqrt(8.0 * 10.0), rtol=1e-3)
    np.testing.assert_allclose(r, u / 10.0, rtol=1e-3)


def test_it_stands_first_and_stops_at_the_end_of_an_open_line() -> None:
    motion = drive(straight(100.0), closed=False)
    rest = np.array([0.0, 0.5, 1.0, motion.duration_s - 1.0, motion.duration_s])
    np.testing.assert_allclose(motion.velocity(rest), 0.0, atol=1e-6)
    np.testing.assert_allclose(motion.pose(rest[:3]), 0.0, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.3))
def test_speed_and_yaw_rate_integrate_to_the_pose(seed: int, wander_m: float) -> None:
    line = driving_line(built_in_track("random", seed % 50))
    motion = drive_line(
        line,
        True,
        np.random.default_rng(seed),
        laps=1,
        model=replace(STEADY, wander_m=wander_m),
    )
    dt = 1e-3
    t = np.arange(0, motion.duration_s, dt)
    u, r = motion.velocity(t + dt / 2).T
    yaw = np.unwrap(motion.pose(t)[:, 2])
    np.testing.assert_allclose(np.cumsum(r[:-1]) * dt, yaw[1:] - yaw[0], atol=1e-3)
    heading = motion.pose(t + dt / 2)[:, 2]
    step = dt * u[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    reached = motion.pose(t)[0, :2] + np.cumsum(step[:-1], axis=0)
    np.testing.assert_allclose(reached, motion.pose(t)[1:, :2], atol=2e-3)


@pytest.mark.parametrize("name", ["autocross", "oval", "skidpad", "random"])
def test_tyres_engine_and_brakes_are_never_asked_for_more(name: str) -> None:
    layout = built_in_track(name, 4)
    motion = drive_line(
        driving_line(layout), layout.closed, np.random.default_rng(1), laps=2
    )
    t = np.arange(0, motion.duration_s, 0.005)
    u, r = motion.velocity(t).T
    rate = np.diff(u) / 0.005
    assert u.min() >= 0.0
    assert u.max() <= 15.0 * 1.001
    assert np.abs(u * r).max() < 8.0 * 1.02
    assert rate.max() < 5.0 * 1.02
    assert rate.min() > -7.0 * 1.02
    assert np.abs(np.diff(r)).max() / 0.005 < 12.0


def test_laps_are_crossings_of_the_start_line() -> None:
    line = circle(15.0)
    motion = drive_line(
        line, True, np.random.default_rng(0), laps=3, start_line_m=6.0, model=STEADY
    )
    assert len(motion.laps_s) == 4
    at = motion.pose(motion.laps_s)[:, :2]
    np.testing.assert_allclose(at, np.repeat(at[:1], 4, axis=0), atol=0.02)
    np.testing.assert_allclose(
        at[0], [15 * np.sin(0.4), 15 * (1 - np.cos(0.4))], atol=0.05
    )
    assert motion.duration_s == pytest.approx(motion.laps_s[-1] + 2.0)


def test_wander_has_its_sigma_and_differs_from_lap_to_lap() -> None:
    line = circle(50.0)
    motion = drive(line, True, VehicleModel(wander_m=0.2), laps=40)
    t = np.arange(10.0, motion.duration_s, 0.05)
    offset = 50.0 - np.hypot(*(motion.pose(t)[:, :2] - (0.0, 50.0)).T)
    # 12 km of way with a correlation length of about 12 sqrt(2 pi) m: 400 samples,
    # so that the sigma is known to 1 / sqrt(800).
    assert offset.std() == pytest.approx(0.2, rel=5 / np.sqrt(800))
    laps = motion.pose(motion.laps_s[1:])[:, :2]
    assert np.ptp(laps, axis=0).max() > 0.2


def test_wander_begins_at_nothing() -> None:
    line = circle(20.0)
    motion = drive(line, True, VehicleModel(wander_m=0.5))
    np.testing.assert_allclose(motion.pose(np.zeros(1))[0], 0.0, atol=0.01)
    assert nearest(motion.pose(np.arange(0, 12, 0.1))[:, :2], line)[0].max() > 0.1
