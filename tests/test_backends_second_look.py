"""Sightings that were left aside find their cone in a solution that knows better."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conegraph.backends.second_look import FIT_D2, LEAD_D2, second_look
from conegraph.backends.tracked_frame import Unclaimed
from conegraph.backends.tracker import Tracker
from conegraph.config import resolve_config
from conegraph.types import Array, ConeObservations, SensorModel

SIGMA_M = 0.05
ROUND = SensorModel(np.zeros(3), 0.0, floor_m=SIGMA_M)
"""A sensor whose noise is the same in all directions and everywhere."""


def seen(*xy_m: tuple[float, float]) -> Unclaimed:
    xy = np.array(xy_m).reshape(-1, 2)
    return Unclaimed(np.arange(len(xy)), xy, ROUND.covariance(xy))


def look(
    unclaimed: Unclaimed, there_m: Array, free: list[bool]
) -> tuple[list[int], list[int]]:
    given_free = np.array(free, dtype=bool)
    index, which, _ = second_look(unclaimed, there_m, given_free, ROUND)
    return index.tolist(), which.tolist()


def test_a_sighting_takes_the_cone_that_it_fits() -> None:
    cones = np.array([[5.0, 3.0], [5.0, 0.0]])
    free = np.ones(2, dtype=bool)
    index, which, d2 = second_look(seen((5.0, 2.0 * SIGMA_M)), cones, free, ROUND)
    assert (index.tolist(), which.tolist()) == ([0], [1])
    assert d2[0] == pytest.approx(4.0)


def test_one_that_fits_no_cone_stays_aside() -> None:
    cones, reach = np.array([[5.0, 0.0]]), SIGMA_M * np.sqrt(FIT_D2)
    assert look(seen((5.0, 0.99 * reach)), cones, [True]) == ([0], [0])
    assert look(seen((5.0, 1.01 * reach)), cones, [True]) == ([], [])


def test_one_that_fits_two_cones_stays_aside() -> None:
    apart = SIGMA_M * np.sqrt(LEAD_D2)
    near = np.array([[5.0, 0.0], [5.0, 0.99 * apart]])
    far = np.array([[5.0, 0.0], [5.0, 1.01 * apart]])
    assert look(seen((5.0, 0.0)), near, [True, True]) == ([], [])
    assert look(seen((5.0, 0.0)), far, [True, True]) == ([0], [0])


def test_a_cone_is_given_once_and_only_if_the_frame_did_not_show_it() -> None:
    cones = np.array([[5.0, 0.0]])
    both = seen((5.0, 2.0 * SIGMA_M), (5.0, 0.0))
    assert look(both, cones, [True]) == ([1], [0])
    assert look(both, cones, [False]) == ([], [])
    assert look(seen(), cones, [True]) == ([], [])
    assert look(both, np.zeros((0, 2)), []) == ([], [])


@given(st.integers(0, 2**32 - 1))
def test_cones_that_stand_apart_are_all_found_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cones = np.column_stack([np.arange(2.0, 12.0), rng.uniform(-3.0, 3.0, 10)])
    order = rng.permutation(10)
    off = rng.uniform(-2.0, 2.0, (10, 2)) * SIGMA_M
    sightings = seen(*map(tuple, (cones + off)[order].tolist()))
    assert look(sightings, cones, [True] * 10) == (list(range(10)), order.tolist())


def test_ids_that_are_given_leave_nothing_to_look_at_again() -> None:
    """A detection that the ids call false may stand where a cone does."""
    xy = np.array([[5.0, 1.5], [5.0, -1.5], [8.0, 1.5]])
    frames = [
        ConeObservations(
            0.1 * k, xy, ROUND.covariance(xy), np.eye(5)[[0, 1, 0]], np.array(ids)
        )
        for k, ids in enumerate([[0, 1, 2], [0, 1, -1]])
    ]
    config = resolve_config({"association": {"method": "known"}})
    tracker = Tracker(config, ROUND)
    for one in frames:
        assert tracker.observe_cones(one) is not None
    assert tracker.tracked is not None
    assert tracker.tracked.landmark_id.tolist() == [0, 1]
    assert len(tracker.tracked.unclaimed) == 0
