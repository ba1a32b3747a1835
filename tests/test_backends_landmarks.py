"""The life of a cone: colours by Bayes' rule, existence by log-odds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.landmarks import (
    CLASS_LOG_RANGE,
    LIKELIHOOD_FLOOR,
    PRIOR,
    LandmarkBook,
)
from conegraph.config import LandmarkConfig
from conegraph.types import Array, ConeClass, ConeMap, IntArray

CONFIG = LandmarkConfig()


def report(named: ConeClass, certainty: float = 0.9) -> Array:
    prob = np.full((1, 5), (1.0 - certainty) / 4)
    prob[0, named] = certainty
    return prob


def rows(*index: int) -> IntArray:
    return np.array(index, dtype=np.int64)


def book_of(*first: Array, config: LandmarkConfig = CONFIG) -> LandmarkBook:
    book = LandmarkBook(config)
    for prob in first:
        book.add(prob, 0.0, rows(-1))
    return book


def likeliest(book: LandmarkBook) -> IntArray:
    best: IntArray = book.class_prob.argmax(axis=1).astype(np.int64)
    return best


def test_ids_are_given_once() -> None:
    book = LandmarkBook(CONFIG)
    assert len(book) == 0
    np.testing.assert_array_equal(
        book.add(np.full((3, 5), 0.2), 1.0, rows(7, 8, -1)), [0, 1, 2]
    )
    book.keep(np.array([True, False, False]))
    book.add(np.full((1, 5), 0.2), 2.0, rows(-1))
    np.testing.assert_array_equal(book.id, [0, 3])
    np.testing.assert_array_equal(book.truth_id, [7, -1])
    np.testing.assert_array_equal(book.last_seen_m, [1.0, 2.0])
    np.testing.assert_array_equal(book.hits, [1, 1])


@pytest.mark.parametrize(
    "named", [ConeClass.BLUE, ConeClass.YELLOW, ConeClass.ORANGE, ConeClass.BIG_ORANGE]
)
def test_one_sure_sighting_names_the_colour(named: ConeClass) -> None:
    book = book_of(report(named))
    assert likeliest(book)[0] == named
    # Bayes: 0.175 (0.9 + 0.025/4) against 0.3 / 4 for unknown and, for the three
    # others, 0.175 times the floor, which is above 0.025 + 0.025/4.
    weight = np.full(5, 0.175 * LIKELIHOOD_FLOOR)
    weight[named], weight[4] = 0.175 * (0.9 + 0.025 / 4), 0.3 / 4
    np.testing.assert_allclose(book.class_prob[0], weight / weight.sum())


@pytest.mark.parametrize(("score", "sightings"), [(1.0, 3), (0.5, 5)])
def test_weak_detections_make_a_cone_later(score: float, sightings: int) -> None:
    """Evidence of 3 at 1.5 a sighting, times its score, after the one of its birth."""
    book = book_of(report(ConeClass.BLUE))
    seen = 1
    while not book.published[0]:
        book.hit(rows(0), report(ConeClass.BLUE), 0.0, np.array([score]))
        seen += 1
    assert seen == sightings


def test_a_detector_without_colours_leaves_every_cone_unknown() -> None:
    even = np.full((1, 5), 0.2)
    book = book_of(even)
    for _ in range(200):
        book.hit(rows(0), even, 0.0)
    # All likelihoods are the same quarter, so the prior stays.
    np.testing.assert_allclose(book.class_prob[0], PRIOR, atol=1e-9)
    assert likeliest(book)[0] == ConeClass.UNKNOWN


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_a_fifth_of_flipped_colours_does_not_matter_in_the_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flipped = np.zeros(50, dtype=bool)
    flipped[rng.permutation(40)[:10]] = True
    book = book_of(report(ConeClass.YELLOW))
    for wrong in flipped.tolist():
        named = ConeClass.YELLOW if wrong else ConeClass.BLUE
        book.hit(rows(0), report(named), 0.0)
    # The last ten are right, each worth log((0.9 + 0.025/4)/0.06), about 2.7,
    # against a range of 8 that is all the memory there is.
    assert likeliest(book)[0] == ConeClass.BLUE


def test_a_wrong_colour_can_be_revised_after_any_time() -> None:
    book = book_of(report(ConeClass.YELLOW))
    for _ in range(1000):
        book.hit(rows(0), report(ConeClass.YELLOW), 0.0)
    ratio = np.log((0.9 + 0.025 / 4) / LIKELIHOOD_FLOOR)
    needed = int(np.ceil(CLASS_LOG_RANGE / ratio))
    for _ in range(needed + 1):
        book.hit(rows(0), report(ConeClass.BLUE), 0.0)
    assert likeliest(book)[0] == ConeClass.BLUE


def test_a_class_that_is_certain_is_believed_only_so_far() -> None:
    book = book_of(np.eye(5)[:1])
    weight = 0.175 * np.array([1.0, *[LIKELIHOOD_FLOOR] * 3, 0.0])
    weight[4] = 0.3 / 4
    np.testing.assert_allclose(book.class_prob[0], weight / weight.sum())


def test_existence_is_counted_in_log_odds() -> None:
    config = LandmarkConfig(hit_log_odds=1.25, max_log_odds=4.0)
    book = book_of(report(ConeClass.BLUE), report(ConeClass.BLUE), config=config)
    book.hit(rows(1), report(ConeClass.BLUE), 3.0)
    np.testing.assert_allclose(book.log_odds, [0.0, 1.25])
    np.testing.assert_array_equal(book.last_seen_m, [0.0, 3.0])
    book.miss(rows(0, 1), 0.6)
    np.testing.assert_allclose(book.log_odds, [np.log(0.4), 1.25 + np.log(0.4)])
    for _ in range(10):
        book.hit(rows(1), report(ConeClass.BLUE), 3.0)
    assert book.log_odds[1] == 4.0
    book.miss(rows(0), 0.0)
    assert book.log_odds[0] == pytest.approx(np.log(0.4))


def test_a_cone_is_published_when_seen_often_and_believed() -> None:
    config = LandmarkConfig(
        publish_hits=3, hit_log_odds=1.0, publish_log_odds=3.0, max_log_odds=8.0
    )
    book = book_of(report(ConeClass.BLUE), config=config)
    shown = []
    for _ in range(4):
        shown.append(bool(book.published[0]))
        book.hit(rows(0), report(ConeClass.BLUE), 0.0)
    # Hits 1, 2, 3, 4 with log-odds 0, 1, 2, 3.
    assert shown == [False, False, False, True]
    few = LandmarkConfig(publish_hits=3, hit_log_odds=5.0, publish_log_odds=3.0)
    book = book_of(report(ConeClass.BLUE), config=few)
    book.hit(rows(0), report(ConeClass.BLUE), 0.0)
    assert not book.published[0]
    book.hit(rows(0), report(ConeClass.BLUE), 0.0)
    assert book.published[0]


def test_old_cones_are_given_up_later_than_young_ones() -> None:
    config = LandmarkConfig(
        publish_hits=3,
        hit_log_odds=1.0,
        delete_log_odds=-4.0,
        young_delete_log_odds=-1.5,
    )
    book = book_of(report(ConeClass.BLUE), report(ConeClass.BLUE), config=config)
    for _ in range(2):
        book.hit(rows(1), report(ConeClass.BLUE), 0.0)
    doomed = []
    for _ in range(5):
        book.miss(rows(0, 1), 1.0 - np.exp(-1.0))
        doomed.append(tuple(book.doomed().tolist()))
    # Young: -1, -2, ... against -1.5; old: 1, 0, ... -3 against -4.
    assert [d[0] for d in doomed] == [False, True, True, True, True]
    assert not any(d[1] for d in doomed)
    book.miss(rows(1), 1.0 - np.exp(-0.99))
    assert not book.doomed()[1]
    book.miss(rows(1), 1.0 - np.exp(-0.02))
    assert book.doomed()[1]


def test_known_cones_are_published_at_once_with_their_places_and_ids() -> None:
    known = ConeMap(
        rows(4, 9),
        np.array([[1.0, 2.0], [3.0, 4.0]]),
        np.tile(0.01 * np.eye(2), (2, 1, 1)),
        np.vstack([report(ConeClass.BLUE), report(ConeClass.ORANGE)]),
        rows(20, 0),
    )
    book = LandmarkBook(CONFIG)
    book.append_known(known)
    assert book.published.all()
    np.testing.assert_array_equal(book.id, known.id)
    np.testing.assert_array_equal(book.xy_m, known.xy_m)
    np.testing.assert_array_equal(book.hits, [20, CONFIG.publish_hits])
    np.testing.assert_allclose(book.class_prob, known.class_prob)
    # The odometer was never there.
    assert np.isneginf(book.last_seen_m).all()
    book.add(report(ConeClass.BLUE), 0.0, rows(-1))
    np.testing.assert_array_equal(book.id, [4, 9, 10])


def test_one_cone_takes_over_the_other_s_history() -> None:
    book = book_of(report(ConeClass.BLUE), report(ConeClass.UNKNOWN))
    for _ in range(3):
        book.hit(rows(1), report(ConeClass.BLUE), 12.0)
    book.absorb(0, 1)
    assert book.hits[0] == 5
    assert book.log_odds[0] == pytest.approx(3 * CONFIG.hit_log_odds)
    assert book.last_seen_m[0] == 12.0
    together = book_of(report(ConeClass.BLUE))
    together.hit(rows(0), report(ConeClass.UNKNOWN), 0.0)
    for _ in range(3):
        together.hit(rows(0), report(ConeClass.BLUE), 12.0)
    # The prior counts once; the range of the logs is all that may part them.
    np.testing.assert_allclose(
        book.class_prob[0], together.class_prob[0], atol=2 * np.exp(-CLASS_LOG_RANGE)
    )


def test_near_cones_in_one_frame_are_remembered_as_two() -> None:
    book = book_of(*[report(ConeClass.BLUE)] * 3)
    book.note_together(rows(0, 1, 2), np.array([[0, 0], [2, 0], [9, 0.0]]), 2.5)
    assert book.seen_together(0, 1)
    assert book.seen_together(1, 0)
    assert not book.seen_together(1, 2)
    book.keep(np.array([False, True, True]))
    # Rows have moved up, ids have not.
    assert not book.seen_together(0, 1)


def test_a_cone_that_takes_over_another_was_seen_with_its_neighbours() -> None:
    book = book_of(*[report(ConeClass.BLUE)] * 4)
    book.note_together(rows(1, 2), np.zeros((2, 2)), 2.5)
    book.absorb(0, 1)
    book.keep(np.array([True, False, True, True]))
    assert book.seen_together(0, 1)
    assert not book.seen_together(0, 2)


def test_the_colour_survives_two_wrong_names_of_five() -> None:
    # Beside "unknown", a right name is worth log(0.906 / 0.25) = 1.29 and a wrong one
    # log(0.06 / 0.25) = -1.43: 3 of 5 right still rise, by 1.01.
    book = book_of(report(ConeClass.BIG_ORANGE))
    for named in [3, 0, 3, 1, 3] * 8:
        book.hit(rows(0), report(ConeClass(named)), 0.0)
    assert likeliest(book)[0] == ConeClass.BIG_ORANGE


def test_at_the_edge_of_the_view_each_cone_is_judged_by_its_own_past() -> None:
    book = book_of(report(ConeClass.BLUE), report(ConeClass.BLUE))
    # Nobody has looked yet: (0 + 1) / (0 + 2).
    np.testing.assert_allclose(book.chance_at_edge(rows(0, 1)), 0.5)
    for n in range(20):
        book.look_at_edge(rows(0, 1), np.array([True, n % 4 == 0]))
    overall = (25 + 1) / (40 + 2)
    np.testing.assert_allclose(
        book.chance_at_edge(rows(0, 1)),
        [(20 + 5 * overall) / 25, (5 + 5 * overall) / 25],
    )


def test_a_cone_that_stands_elsewhere_is_given_up() -> None:
    book = book_of(report(ConeClass.BLUE), report(ConeClass.BLUE))
    for _ in range(50):
        book.note_fit(rows(0, 1), np.array([4.0, 10.0]))
    # Means of 4 and 10 where 2 is expected and 6 the limit.
    assert book.doomed().tolist() == [False, True]
    # From 2 towards 10 by a tenth: 10 - 8 * 0.9^n passes 6 after seven sightings.
    fresh = book_of(report(ConeClass.BLUE))
    for _ in range(6):
        fresh.note_fit(rows(0), np.array([10.0]))
    assert not fresh.doomed()[0]
    fresh.note_fit(rows(0), np.array([10.0]))
    assert fresh.doomed()[0]
