"""Filter and book in step: births, removals, twins, what is in view."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.backends.local_map import LocalMap
from conegraph.config import Config, EkfConfig, LandmarkConfig, MotionConfig
from conegraph.types import Array, ConeMap, ConeObservations, IntArray, SensorModel

SENSOR = SensorModel(
    np.array([0.05, 0.0, 0.0]), 0.01, max_range_m=10.0, half_fov_rad=0.75
)


def slots(*index: int) -> IntArray:
    return np.array(index, dtype=np.int64)


def frame(
    xy: Array, sigma_m: float = 0.1, truth: IntArray | None = None
) -> ConeObservations:
    n = len(xy)
    cov = np.tile(sigma_m**2 * np.eye(2), (n, 1, 1))
    return ConeObservations(0.0, xy, cov, np.tile(np.full(5, 0.2), (n, 1)), truth)


def filled(xy: Array, config: Config | None = None) -> LocalMap:
    map_ = LocalMap(config or Config())
    map_.add(frame(xy), 0.0)
    return map_


def test_the_filter_starts_with_the_configured_doubts() -> None:
    motion = MotionConfig(gyro_bias_sigma_radps=0.02, start_speed_sigma_mps=3.0)
    cov = LocalMap(Config(motion=motion)).filter.vehicle_cov
    assert cov[3, 3] == pytest.approx(9.0)
    assert cov[5, 5] == pytest.approx(0.0004)
    without = MotionConfig(use_odometry=False)
    assert LocalMap(Config(motion=without)).filter.vehicle_cov[5, 5] == 0.0


def test_new_cones_get_slots_rows_and_ids() -> None:
    map_ = LocalMap(Config(backend=EkfConfig()))
    xy = np.array([[5.0, 1.0], [7.0, -1.0]])
    np.testing.assert_array_equal(map_.add(frame(xy, truth=slots(8, 9)), 3.0), [0, 1])
    np.testing.assert_array_equal(map_.row, [0, 1])
    np.testing.assert_array_equal(map_.book.truth_id, [8, 9])
    np.testing.assert_array_equal(map_.book.last_seen_m, [3.0, 3.0])
    map_.sync()
    np.testing.assert_allclose(map_.book.xy_m, xy)
    # The car is exactly at the origin, so the cone has the sensor's noise.
    np.testing.assert_allclose(map_.book.cov_m2[0], 0.01 * np.eye(2))


def test_removal_keeps_filter_and_book_in_step() -> None:
    xy = np.array([[3.0 * i, 0.0] for i in range(1, 5)])
    map_ = filled(xy)
    map_.remove(slots(1))
    map_.remove(slots())
    np.testing.assert_array_equal(map_.row, [0, 1, 2])
    np.testing.assert_array_equal(map_.book.id, [0, 2, 3])
    map_.sync()
    np.testing.assert_allclose(map_.book.xy_m, xy[[0, 2, 3]])


def test_only_cones_that_could_be_seen_are_candidates() -> None:
    places = [
        [5.0, 0.0],  # ahead
        [12.9, 0.0],  # beyond the range, within its margin of 3 m
        [13.1, 0.0],
        [-5.0, 0.0],  # behind
        [8 * np.cos(0.89), 8 * np.sin(0.89)],  # outside, within 0.15 rad
        [8 * np.cos(1.2), 8 * np.sin(1.2)],  # 3.5 m outside
        [1.0 * np.cos(1.5), 1.0 * np.sin(1.5)],  # beside the car: 0.7 m outside
    ]
    map_ = filled(np.array(places))
    np.testing.assert_array_equal(map_.visible(SENSOR), [0, 1, 4, 6])


def test_cones_released_from_the_filter_stay_in_the_book() -> None:
    xy = np.array([[3.0, 0.0], [6.0, 1.0]])
    map_ = filled(xy)
    map_.release()
    assert map_.filter.n_landmarks == 0
    np.testing.assert_allclose(map_.book.xy_m, xy)
    state = np.concatenate([np.zeros(6), [6.1, 1.1, 9.0, 9.0]])
    map_.load(
        state,
        np.eye(10),
        slots(1, 77),
        slots(0, 1, 77),
        np.array([[3.1, 0.1], [6.1, 1.1], [9.0, 9.0]]),
    )
    # Cone 77 is not in the book any more.
    np.testing.assert_array_equal(map_.row, [1])
    np.testing.assert_allclose(map_.filter.landmarks_m, [[6.1, 1.1]])
    np.testing.assert_allclose(map_.book.xy_m, [[3.1, 0.1], [6.1, 1.1]])


def twins(gap_m: float, sigma_m: float = 0.1) -> LocalMap:
    """Return a map with two cones that were born in different frames."""
    map_ = LocalMap(Config())
    for x in (5.0, 5.0 + gap_m):
        map_.add(frame(np.array([[x, 0.0]]), sigma_m), 0.0)
    map_.add(frame(np.array([[5.0, 8.0]]), sigma_m), 0.0)
    return map_


def test_twins_become_one_cone_between_them() -> None:
    map_ = twins(0.2)
    map_.book.hit(slots(1), np.full((1, 5), 0.2), 0.0)
    # d2 = 0.04 / (2 * 0.01) = 2, well below 9.
    assert map_.merge_twins() == ((0, 1),)
    np.testing.assert_array_equal(map_.book.id, [0, 2])
    np.testing.assert_allclose(map_.filter.landmarks_m[0], [5.1, 0.0], atol=1e-3)
    assert map_.book.hits[0] == 3
    # Two measurements of variance 0.01 each.
    np.testing.assert_allclose(
        map_.filter.landmark_covs()[0], 0.005 * np.eye(2), atol=1e-5
    )
    assert map_.merge_twins() == ()


def test_twins_that_were_seen_together_are_two() -> None:
    map_ = twins(0.2)
    map_.book.note_together(slots(0, 1), np.array([[5.0, 0.0], [5.2, 0.0]]), 2.5)
    assert map_.merge_twins() == ()


def test_cones_too_far_apart_for_their_covariance_are_two() -> None:
    # d2 = gap^2 / 0.02 meets 9 at 0.424 m.
    assert twins(0.42).merge_twins() == ((0, 1),)
    assert twins(0.43).merge_twins() == ()


def test_vague_cones_are_never_merged() -> None:
    # The difference's covariance has trace 4 * 0.36 > 1.
    assert twins(0.5, sigma_m=0.6).merge_twins() == ()


def test_cones_whose_difference_is_lost_in_rounding_are_left_alone() -> None:
    map_ = twins(0.2)
    state = np.concatenate([np.zeros(6), map_.filter.landmarks_m.ravel()])
    cov = np.eye(12)
    # So far from the origin a covariance is no longer positive definite.
    cov[6:8, 8:10] = cov[8:10, 6:8] = 2.0 * np.eye(2)
    map_.filter.load(state, cov)
    assert map_.merge_twins() == ()
    np.testing.assert_array_equal(map_.book.id, [0, 1, 2])


def test_of_three_in_a_heap_none_is_merged() -> None:
    map_ = twins(0.2)
    map_.add(frame(np.array([[5.1, 0.0]])), 0.0)
    assert map_.merge_twins() == ()


def test_merging_can_be_turned_off_by_a_gate_of_nothing() -> None:
    config = Config(landmarks=LandmarkConfig(merge_d2=0.0))
    map_ = LocalMap(config)
    for x in (5.0, 5.1):
        map_.add(frame(np.array([[x, 0.0]])), 0.0)
    assert map_.merge_twins() == ()


def test_a_known_map_is_published_as_it_came() -> None:
    known = ConeMap(
        slots(3, 5),
        np.array([[5.0, 1.0], [8.0, -1.0]]),
        np.tile(0.04 * np.eye(2), (2, 1, 1)),
        np.array([[0.9, 0.025, 0.025, 0.025, 0.025]] * 2),
        slots(10, 10),
    )
    map_ = LocalMap(Config())
    map_.start_from(known)
    shown = map_.publish()
    np.testing.assert_array_equal(shown.id, known.id)
    np.testing.assert_allclose(shown.xy_m, known.xy_m)
    np.testing.assert_allclose(shown.cov_m2, known.cov_m2)
    np.testing.assert_allclose(shown.class_prob, known.class_prob)
    np.testing.assert_array_equal(shown.observations, known.observations)


def test_only_confirmed_cones_are_published() -> None:
    map_ = filled(np.array([[5.0, 1.0], [8.0, -1.0]]))
    for _ in range(5):
        map_.book.hit(slots(1), np.full((1, 5), 0.2), 0.0)
    np.testing.assert_array_equal(map_.publish().id, [1])
