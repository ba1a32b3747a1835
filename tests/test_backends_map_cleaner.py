"""What frames fail to show, against a count of sightings and misses."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.backends.laps import LapCounter
from conegraph.backends.local_map import LocalMap
from conegraph.backends.map_cleaner import TRUST, MapCleaner
from conegraph.backends.pairing import FramePairer
from conegraph.config import AssociationConfig, Config
from conegraph.types import Array, ConeObservations, IntArray, SensorModel

SENSOR = SensorModel(
    np.array([0.05, 0.0, 0.0]),
    0.01,
    min_range_m=0.5,
    max_range_m=12.0,
    half_fov_rad=1.0,
    detection_probability=0.9,
)

XY = np.array([[3.0, 1.5], [3.0, -1.5], [6.0, 1.5], [6.0, -1.5], [10.5, 0.0]])
"""Four cones well in view; the last is beyond 0.75 of 12 m, at the edge."""


def seen(xy: Array) -> ConeObservations:
    prob = np.full((len(xy), 5), 0.025)
    prob[:, 0] = 0.9
    return ConeObservations(0.0, xy, SENSOR.covariance(xy), prob)


class World:
    """A standing car that sees the cones it is told to."""

    def __init__(self, config: Config | None = None) -> None:
        self.config = config or Config()
        self.map = LocalMap(self.config)
        self.map.filter.inflate(np.diag([1e-6, 1e-6, 1e-8, 0.0, 0.0, 0.0]))
        self.pairer = FramePairer(self.config, SENSOR)
        self.cleaner = MapCleaner(self.config, SENSOR, self.pairer)
        self.laps = LapCounter(self.config.start_line)
        self.map.add(seen(XY), 0.0)

    def look(self, xy: Array) -> IntArray:
        """Show cones; return the ids of those that were missed."""
        frame = seen(xy)
        pairs = self.pairer.pair(self.map, frame, np.zeros((6, 6)))
        row = np.flatnonzero(pairs.matched)
        at = self.map.row[pairs.slot[row]]
        self.map.book.hit(at, frame.class_prob[row], 0.0)
        missed = self.cleaner.missed(self.map, frame, pairs)
        ids = self.map.book.id[self.map.row[missed]]
        self.cleaner.clean(self.map, missed, self.laps)
        return ids

    @property
    def ids(self) -> list[int]:
        """Ids of the cones that the map holds."""
        held: list[int] = self.map.book.id[self.map.row].tolist()
        return held


def test_a_cone_in_view_that_is_not_seen_is_missed() -> None:
    world = World()
    before = world.map.book.log_odds[2]
    np.testing.assert_array_equal(world.look(XY[[0, 1, 3, 4]]), [2])
    # min(0.6 assumed, 0.65 of the sensor's 0.9).
    assert world.map.book.log_odds[2] - before == pytest.approx(np.log(1 - TRUST * 0.9))


def test_a_removed_cone_is_gone_within_a_dozen_frames() -> None:
    world = World()
    for _ in range(30):
        world.look(XY)
    assert world.map.book.log_odds[2] == 8.0
    # From the cap of 8 to below -4 in steps of log(1 - 0.585) = -0.88: 14 frames.
    frames = 0
    while 2 in world.ids:
        world.look(XY[[0, 1, 3, 4]])
        frames += 1
    assert frames == np.floor(12.0 / -np.log(1 - TRUST * 0.9)) + 1
    assert world.ids == [0, 1, 3, 4]


def test_a_cone_at_the_edge_that_always_showed_is_missed_too() -> None:
    world = World()
    for _ in range(30):
        world.look(XY)
    for _ in range(60):
        world.look(XY[:4])
    assert world.ids == [0, 1, 2, 3]


def test_a_cone_at_the_edge_that_showed_now_and_then_is_kept() -> None:
    world = World()
    for n in range(400):
        world.look(XY if n % 4 == 0 else XY[:4])
    assert world.ids == [0, 1, 2, 3, 4]


def test_a_frame_in_which_nothing_fits_speaks_against_nothing() -> None:
    confused = World()
    # All displaced by half a metre under no doubt at all: the car is lost, not they.
    assert len(confused.look(XY + np.array([0.45, 0.0]))) == 0


def test_a_cone_pushed_aside_is_given_up_though_something_is_seen_near_it() -> None:
    world = World()
    for _ in range(30):
        world.look(XY)
    pushed = XY.copy()
    pushed[3] += [0.28, 0.0]
    for _ in range(20):
        world.look(pushed)
    # 0.28 m beside 0.05 m of noise, and no correction here that would drag it along.
    assert 3 not in world.ids


def test_without_a_detection_probability_to_speak_of_nothing_is_pruned() -> None:
    blind = SensorModel(np.array([0.05, 0.0, 0.0]), 0.01, detection_probability=0.0)
    world = World()
    world.cleaner = MapCleaner(world.config, blind, world.pairer)
    assert len(world.look(XY[:2])) == 0


def test_known_cones_are_never_missed() -> None:
    world = World(Config(association=AssociationConfig(method="known")))
    assert len(world.look(XY[:2])) == 0
