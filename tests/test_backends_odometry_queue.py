"""Velocities kept for the frame that asks for them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.motion import integrate_odometry
from conegraph.backends.odometry_queue import OdometryQueue
from conegraph.config import MotionConfig
from conegraph.geometry import Array, compose, constant_twist
from conegraph.types import VelocityObservation

CONFIG = MotionConfig(odometry_hold_s=0.5)
COV = np.diag([0.01, 0.0001])


def sample(stamp_s: float, u: float = 10.0, r: float = 0.2) -> VelocityObservation:
    return VelocityObservation(stamp_s, u, r, COV)


def filled(*stamps: float) -> OdometryQueue:
    queue = OdometryQueue(CONFIG)
    for stamp in stamps:
        queue.push(sample(stamp))
    return queue


def test_an_empty_queue_has_nothing_to_say() -> None:
    queue = OdometryQueue(CONFIG)
    assert queue.newest_s == float("-inf")
    assert queue.take(0.0, 0.1) is None
    assert queue.peek(0.0, 0.1) is None
    assert queue.samples(1.0) == []


def test_samples_come_out_once_and_in_order() -> None:
    queue = filled(0.0, 0.1, 0.1, 0.2)
    assert [v.stamp_s for v in queue.samples(0.1)] == [0.0, 0.1, 0.1]
    assert queue.samples(0.1) == []
    assert queue.newest_s == 0.2
    assert [v.stamp_s for v in queue.samples(9.0)] == [0.2]
    # What was taken out is still the newest that is known.
    assert queue.newest_s == 0.2


def test_an_interval_is_integrated_and_its_samples_forgotten() -> None:
    queue = filled(0.0, 0.1, 0.2, 0.3)
    queue.samples(0.0)
    got = queue.take(0.0, 0.2)
    assert got is not None
    np.testing.assert_allclose(got.delta, constant_twist(10.0, 0.2, 0.2), atol=1e-12)
    assert [v.stamp_s for v in queue.samples(9.0)] == [0.3]


def test_peeking_changes_nothing() -> None:
    queue = filled(0.0, 0.1, 0.2)
    queue.samples(0.0)
    first, again = queue.peek(0.0, 0.2), queue.peek(0.0, 0.2)
    taken = queue.take(0.0, 0.2)
    assert first is not None
    assert again is not None
    assert taken is not None
    np.testing.assert_array_equal(first.delta, taken.delta)
    np.testing.assert_array_equal(again.cov, taken.cov)


def test_no_interval_no_increment() -> None:
    queue = filled(0.0, 0.1)
    assert queue.peek(0.1, 0.1) is None
    assert queue.peek(0.2, 0.1) is None


def test_the_last_sample_speaks_only_for_so_long() -> None:
    queue = filled(0.0, 0.1)
    queue.samples(0.1)
    held = queue.peek(0.5, 0.6)
    assert held is not None
    np.testing.assert_allclose(held.delta, constant_twist(10.0, 0.2, 0.1), atol=1e-12)
    assert queue.peek(0.61, 0.7) is None


def test_samples_before_the_interval_only_tell_where_it_starts() -> None:
    queue = OdometryQueue(CONFIG)
    for stamp, u in ((0.0, 0.0), (0.1, 10.0), (0.2, 20.0)):
        queue.push(sample(stamp, u, 0.0))
    got = queue.take(0.15, 0.2)
    assert got is not None
    # From 15 to 20 m/s over 0.05 s.
    np.testing.assert_allclose(got.delta, [17.5 * 0.05, 0.0, 0.0], atol=1e-12)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_intervals_that_meet_at_samples_compose_to_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.arange(31) * 0.02
    values = [
        sample(t, u, r)
        for t, u, r in zip(
            stamps.tolist(), rng.uniform(0, 20, 31), rng.uniform(-2, 2, 31), strict=True
        )
    ]
    queue = OdometryQueue(CONFIG)
    for value in values:
        queue.push(value)
    queue.samples(0.0)
    cuts = [0, *sorted(rng.permutation(np.arange(1, 30))[:4].tolist()), 30]
    pose: Array = np.zeros(3)
    for a, b in pairwise(cuts):
        part = queue.take(values[a].stamp_s, values[b].stamp_s)
        assert part is not None
        pose = compose(pose, part.delta)
    whole = integrate_odometry(values[0], values[1:], 0.0, values[-1].stamp_s, CONFIG)
    np.testing.assert_allclose(pose, whole.delta, atol=1e-9)


def test_late_samples_are_applied_at_their_own_stamp() -> None:
    # The queue is filled ahead; the frame of 0.1 comes after the sample of 0.2.
    queue = filled(0.0, 0.1, 0.2)
    queue.samples(0.0)
    got = queue.take(0.0, 0.1)
    assert got is not None
    assert got.dt_s == pytest.approx(0.1)
    assert queue.newest_s == 0.2


def test_odometry_that_stops_speaks_no_more_and_a_slow_one_still_does() -> None:
    for spacing_s, later_s, speaks in ((0.01, 0.06, False), (0.2, 0.4, True)):
        queue = OdometryQueue(CONFIG)
        stamps = [spacing_s * k for k in range(40)]
        for stamp in stamps:
            queue.push(VelocityObservation(stamp, 5.0, 0.1, 0.01 * np.eye(2)))
        assert queue.take(0.0, stamps[-1]) is not None
        start_s = stamps[-1] + later_s
        assert (queue.peek(start_s, start_s + 0.03) is not None) == speaks
