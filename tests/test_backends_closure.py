"""When a loop closes: by visits to the gate, and by start cones that fit together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conegraph.backends.closure import ClosureResult, ClosureWatch
from conegraph.backends.laps import Gate
from conegraph.backends.local_map import LocalMap
from conegraph.backends.pairing import FramePairer
from conegraph.backends.start_line import GateMatch, match_gate
from conegraph.config import Config
from conegraph.geometry import to_child
from conegraph.types import Array, ConeClass, ConeObservations, SensorModel

SENSOR = SensorModel(np.array([0.05, 0.0, 0.0]), 0.005, max_range_m=45.0)

GATE = Gate(np.array([6.0, 0.0]), np.array([1.0, 0.0]))

START = np.array([[6.0, 2.0], [6.3, -2.0]])
LANE = np.array([[9.0, 2.2], [12.0, 3.5], [10.0, -1.4], [13.5, -2.0], [17.0, -0.5]])
WORLD = np.vstack([START, LANE])


def report(xy: Array) -> ConeObservations:
    prob = np.full((len(xy), 5), 0.025)
    prob[:, ConeClass.BLUE] = 0.9
    prob[:2] = 0.025
    prob[:2, ConeClass.BIG_ORANGE] = 0.9
    return ConeObservations(0.0, xy, SENSOR.covariance(xy), prob)


class Drive:
    """A map round the gate, and a car that is put where a test wants it."""

    def __init__(self, *, pose_sigma_m: float = 0.01) -> None:
        self.config = Config()
        self.map = LocalMap(self.config)
        self.map.add(report(WORLD), 0.0)
        self.sigma_m = pose_sigma_m
        everything = np.arange(len(WORLD))
        for _ in range(4):
            prob = report(WORLD).class_prob
            self.map.book.hit(everything, prob, 0.0)
        self.pairer = FramePairer(self.config, SENSOR)
        self.watch = ClosureWatch(self.config.start_line, self.pairer, SENSOR)

    def look(
        self,
        driven_m: float,
        believed: Array,
        true: Array | None = None,
        shown: slice = slice(None),
    ) -> ClosureResult:
        """Look from a true pose while the filter believes another."""
        cov = np.diag([self.sigma_m**2, self.sigma_m**2, 1e-4])
        self.map.filter.place_car(believed, cov)
        frame = report(to_child(believed if true is None else true, WORLD)[shown])
        pairs = self.pairer.pair(self.map, frame, np.zeros((6, 6)))
        return self.watch.check(self.map, frame, pairs, GATE, driven_m)


AT_GATE = np.array([0.0, 0.0, 0.0])
ELSEWHERE = np.array([-30.0, 20.0, 0.0])


def test_the_loop_closes_when_the_car_is_back_at_the_gate() -> None:
    drive = Drive()
    assert drive.look(0.0, AT_GATE).events == ()
    result = drive.look(100.0, AT_GATE)
    assert result.accepted
    assert result.match is None
    assert result.events[0].distance_m == 100.0
    # Once a visit: the next frames see nothing that comes back.
    assert drive.look(101.0, AT_GATE).events == ()
    # And a closure needs the distance that is asked for.
    assert drive.look(100.0 + drive.config.start_line.min_closure_m - 1, AT_GATE) == (
        ClosureResult()
    )


def test_a_start_that_was_never_out_of_sight_closes_the_loop_all_the_same() -> None:
    drive = Drive()
    drive.look(0.0, AT_GATE)
    everything = np.arange(len(WORLD))
    for driven_m in range(10, 100, 10):
        assert drive.look(float(driven_m), ELSEWHERE).events == ()
        drive.map.book.hit(everything, report(WORLD).class_prob, float(driven_m))
    assert drive.look(100.0, AT_GATE).accepted


def test_cones_first_seen_on_this_visit_close_nothing() -> None:
    drive = Drive()
    drive.look(0.0, ELSEWHERE)
    assert drive.look(100.0, AT_GATE).events == ()


def test_two_cones_are_too_few() -> None:
    drive = Drive()
    drive.look(0.0, AT_GATE)
    assert drive.look(100.0, AT_GATE, shown=slice(2, 4)).events == ()
    # The third, a little later, makes three.
    assert drive.look(101.0, AT_GATE, shown=slice(2, 5)).accepted


@pytest.mark.parametrize("yaw", [np.pi, 0.5 * np.pi])
def test_passing_the_gate_another_way_closes_nothing(yaw: float) -> None:
    drive = Drive()
    drive.look(0.0, AT_GATE)
    assert drive.look(100.0, np.array([6.0, 0.0, yaw])).events == ()


def test_after_a_long_drift_the_start_cones_give_the_pose() -> None:
    # 4.5 sigmas: d2 = 20 each, beyond the gate of 13.8 for a cone alone, but for two
    # with one displacement far below the 25 a cone of a closure.
    drive = Drive(pose_sigma_m=0.6)
    drive.look(0.0, AT_GATE)
    result = drive.look(120.0, np.array([-2.7, 0.0, 0.0]), AT_GATE)
    assert result.accepted
    assert result.match is not None
    np.testing.assert_array_equal(result.match.slot, [0, 1])
    np.testing.assert_allclose(result.match.pose, AT_GATE, atol=1e-6)
    assert result.match.agreement == 1.0


def test_a_drift_that_the_filter_rules_out_is_refused() -> None:
    drive = Drive(pose_sigma_m=0.01)
    drive.look(0.0, AT_GATE)
    result = drive.look(120.0, np.array([-3.0, 2.4, 0.0]), AT_GATE)
    assert not result.accepted
    assert "impossible for this drift" in result.events[0].reason
    # It is said again only after two metres.
    again = drive.look(121.0, np.array([-3.0, 2.4, 0.0]), AT_GATE)
    assert again.events == ()


def test_a_gate_beside_a_place_that_fits_better_is_refused() -> None:
    """Two cones are taken for the start 8 m before the place where the car is."""
    here = np.array([[6.0, 2.0], [6.3, -2.0], *LANE])
    beside = here[[0, 1, 2, 4]] - [8.0, 0.0]
    seen = report(here)
    shown = np.vstack([beside, LANE])
    drive = Drive(pose_sigma_m=4.0)
    assert isinstance(match_gate(here, np.arange(2), shown, np.arange(2)), GateMatch)
    drive.map = LocalMap(drive.config)
    drive.map.add(report(shown), 0.0)
    for _ in range(4):
        drive.map.book.hit(np.arange(len(shown)), report(shown).class_prob, 0.0)
    drive.map.filter.place_car(np.array([-4.0, 1.0, 0.0]), np.diag([16.0, 16.0, 1e-4]))
    pairs = drive.pairer.pair(drive.map, seen, np.zeros((6, 6)))
    nobody = replace(pairs, slot=np.full(len(seen), -1))
    result = drive.watch.check(drive.map, seen, nobody, GATE, 120.0)
    assert not result.accepted
    assert "does not find this place" in result.events[0].reason
