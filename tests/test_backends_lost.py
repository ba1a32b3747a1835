"""The share of cones that fit, and how fast it falls when none does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conegraph.backends.local_map import LocalMap
from conegraph.backends.lost import (
    LEAST_CONES,
    MEMORY_S,
    LostMonitor,
    agreement,
)
from conegraph.config import Config
from conegraph.geometry import to_child
from conegraph.types import Array, ConeMap, ConeObservations, SensorModel

SENSOR = SensorModel(
    np.array([0.05, 0.0, 0.0]), 0.005, max_range_m=20.0, detection_probability=0.9
)
BLIND = replace(SENSOR, detection_probability=0.0)
SIGMA_M = 0.05
DT_S = 1 / 30


def ring(n: int = 10) -> ConeMap:
    """Return n cones 8 m around the origin, 5 m apart."""
    turn = 0.1 + 2 * np.pi * np.arange(n) / n
    xy = 8.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    cov = np.tile(1e-4 * np.eye(2), (n, 1, 1))
    return ConeMap(np.arange(n), xy, cov, np.tile(np.eye(5)[0], (n, 1)), np.full(n, 9))


def on_map(known: ConeMap) -> LocalMap:
    map_ = LocalMap(Config())
    map_.start_from(known)
    return map_


def seen(xy_m: Array, stamp_s: float = 0.0, colour: int = 0) -> ConeObservations:
    n = len(xy_m)
    cov = np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1))
    return ConeObservations(stamp_s, xy_m, cov, np.tile(np.eye(5)[colour], (n, 1)))


def test_what_is_counted() -> None:
    known = ring()
    map_ = on_map(known)
    everything = seen(known.xy_m)
    assert agreement(map_, everything, SENSOR, whole_map=False) == (20, 20)
    assert agreement(map_, everything, BLIND, whole_map=False) == (10, 10)
    # Colours do not matter.
    wrong = seen(known.xy_m, colour=1)
    assert agreement(map_, wrong, SENSOR, whole_map=False) == (20, 20)
    # Two cones more where the map has none: new, unless the map is whole.
    more = seen(np.vstack([known.xy_m, [[14.0, 0.0], [0.0, 14.0]]]))
    assert agreement(map_, more, BLIND, whole_map=False) == (10, 10)
    assert agreement(map_, more, BLIND, whole_map=True) == (10, 12)
    # Half of them hidden.
    half = seen(known.xy_m[::2])
    assert agreement(map_, half, SENSOR, whole_map=False) == (10, 15)


def test_a_car_that_turned_by_half_a_gap_is_noticed_in_time() -> None:
    known = ring()
    map_, monitor = on_map(known), LostMonitor(SENSOR, 0.5)
    for n in range(30):
        monitor.frame(map_, seen(known.xy_m, n * DT_S), whole_map=True)
    assert monitor.share == 1.0
    turned = to_child(np.array([0.0, 0.0, np.pi / 10]), known.xy_m)
    # The share falls by 1 - dt / memory a frame.
    due = int(np.ceil(np.log(0.5) / np.log(1 - DT_S / MEMORY_S)))
    assert due * DT_S < 0.3
    for n in range(1, due + 1):
        assert not monitor.lost
        monitor.frame(map_, seen(turned, (29 + n) * DT_S), whole_map=True)
        assert monitor.share == pytest.approx((1 - DT_S / MEMORY_S) ** n)
    assert monitor.lost
    monitor.reset()
    assert not monitor.lost


def test_empty_frames_and_an_empty_map_say_nothing() -> None:
    monitor = LostMonitor(SENSOR, 0.5)
    empty = seen(np.zeros((0, 2)))
    for n in range(100):
        frame = replace(empty, stamp_s=0.1 * n)
        monitor.frame(on_map(ring()), frame, whole_map=True)
        monitor.frame(LocalMap(Config()), seen(ring().xy_m, 0.1 * n), whole_map=True)
    assert monitor.share == 1.0


@pytest.mark.parametrize(
    ("n_cones", "lost"), [(LEAST_CONES - 1, False), (LEAST_CONES, True)]
)
def test_a_few_cones_that_do_not_fit_are_no_proof(n_cones: int, lost: bool) -> None:
    map_, monitor = on_map(ring()), LostMonitor(BLIND, 0.5)
    turned = to_child(np.array([0.0, 0.0, np.pi / 10]), ring().xy_m[:n_cones])
    for n in range(100):
        monitor.frame(map_, seen(turned, 0.2 * n), whole_map=True)
    assert monitor.lost == lost
