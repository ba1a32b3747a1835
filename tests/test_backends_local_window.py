"""What a car that has forgotten everything makes of its first seconds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.local_window import LocalWindow, step_between, window_config
from conegraph.backends.tracker import Tracker
from conegraph.config import Config, SensorConfig
from conegraph.geometry import compose, to_child
from conegraph.types import Array, ConeObservations, SensorModel

SENSOR = SensorModel(
    np.array([0.05, 0.0, 0.0]), 0.005, max_range_m=20.0, half_fov_rad=np.pi
)
DT_S = 0.1

ROW_M = np.arange(-30.0, 130.0, 2.8)
LANE_M = np.vstack(
    [np.column_stack([ROW_M, np.full_like(ROW_M, side)]) for side in (1.75, -1.75)]
)
"""Cones 2.8 m apart, the same everywhere, but for a few beside them."""

BESIDE_M = np.array([[-11.0, 5.0], [2.5, -6.0], [9.0, 4.5], [21.0, -5.0], [33.0, 7.0]])
WORLD_M = np.vstack([LANE_M, BESIDE_M])


def look(pose: Array, stamp_s: float) -> ConeObservations:
    """Return the cones within reach of a pose, exactly where they are."""
    xy = to_child(pose, WORLD_M)
    xy = xy[np.hypot(*xy.T) < SENSOR.max_range_m]
    return ConeObservations(
        stamp_s, xy, SENSOR.covariance(xy), np.tile(np.eye(5)[0], (len(xy), 1))
    )


def window() -> LocalWindow:
    return LocalWindow(Tracker(window_config(Config()), SENSOR))


@given(speed=st.floats(0.0, 30.0), turn=st.floats(-1.5, 1.5))
@settings(max_examples=20, deadline=None)
def test_the_step_between_two_frames_is_found_at_any_speed(
    speed: float, turn: float
) -> None:
    moved = np.array([speed * DT_S, 0.0, turn * DT_S])
    step = step_between(look(np.zeros(3), 0.0), look(moved, DT_S), SENSOR)
    assert step is not None
    assert step[0] == pytest.approx(moved, abs=0.01)


def test_between_places_without_a_common_cone_there_is_no_step() -> None:
    far = look(np.array([60.0, 40.0, 1.0]), DT_S)
    few = far.subset(np.arange(min(1, len(far))))
    assert step_between(look(np.zeros(3), 0.0), few, SENSOR) is None


@pytest.mark.parametrize("speed", [3.0, 16.0, 25.0])
def test_rows_that_look_alike_do_not_hide_how_fast_the_car_is(speed: float) -> None:
    seen = window()
    for k in range(6):
        seen.add(look(np.array([speed * DT_S * k, 0.0, 0.0]), DT_S * k))
    assert seen.vehicle[:3] == pytest.approx([0.5 * speed, 0.0, 0.0], abs=0.05)
    assert seen.vehicle[3] == pytest.approx(speed, abs=0.5)


def test_a_window_that_lost_its_way_knows_only_what_it_sees() -> None:
    seen = window()
    pose = np.zeros(3)
    for k in range(6):
        seen.add(look(pose, DT_S * k))
    assert len(seen.sightings()) == len(look(pose, 0.0))
    for k in range(6, 16):
        pose = compose(pose, np.array([6.3, 0.0, 1.1]))
        newest = look(pose, DT_S * k)
        seen.add(newest)
    assert np.array_equal(seen.sightings().xy_m, newest.xy_m)


def test_a_window_s_frames_have_their_noise_already() -> None:
    config = Config(sensor=SensorConfig(noise_from="model", scale=3.0))
    own = window_config(config)
    assert (own.sensor.noise_from, own.sensor.scale) == ("source", 1.0)
    assert not own.recovery.enabled
