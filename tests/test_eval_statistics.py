"""Intervals and tests agree with closed forms, and intervals cover what they should."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conegraph.eval.statistics import (
    LEAST_GROUPS,
    Interval,
    Middle,
    estimate,
    holm,
    mcnemar,
    rate,
    rate_over,
    sign_test,
    signed_rank,
)
from conegraph.types import Array


def drives(
    rng: np.random.Generator, tracks: int, each: int, between: float
) -> tuple[Array, list[str], Array]:
    """Values of unit spread within tracks that differ by `between`."""
    of_track = rng.normal(0.0, between, tracks)
    values = np.repeat(of_track, each) + rng.normal(size=tracks * each)
    return values, [f"t{k}" for k in range(tracks) for _ in range(each)], of_track


def test_the_middle_is_that_of_all_values_also_of_uneven_groups() -> None:
    values = np.array([1.0, 2.0, 3.0, 10.0, 4.0])
    groups = ["a", "a", "a", "a", "b"]
    rng = np.random.default_rng(0)
    assert estimate(values, groups, "median", rng).value == 3.0
    found = estimate(values, groups, "mean", rng)
    assert found.value == 4.0
    assert (found.count, found.groups, found.general) == (5, 2, False)
    assert found.interval.low < 4.0 < found.interval.high


def test_the_same_generator_gives_the_same_interval() -> None:
    values, groups, _ = drives(np.random.default_rng(1), 10, 4, 1.0)
    one, two = (
        estimate(values, groups, "median", np.random.default_rng(5)) for _ in range(2)
    )
    assert one == two


@pytest.mark.parametrize("middle", ["median", "mean"])
def test_intervals_over_tracks_cover_the_truth_of_all_tracks(middle: Middle) -> None:
    """95 % of 150 intervals: within 5 standard deviations of the binomial."""
    rng, hits = np.random.default_rng(2), 0
    for _ in range(150):
        values, groups, _ = drives(rng, 10, 6, 1.0)
        hits += not estimate(values, groups, middle, rng).interval.excludes(0.0)
    assert 0.95 - 5 * 0.018 < hits / 150 <= 1.0


def test_drives_that_are_taken_for_independent_would_not() -> None:
    """The same drives under a name each: too narrow, so the groups matter."""
    rng, hits = np.random.default_rng(3), 0
    for _ in range(100):
        values, _, _ = drives(rng, 10, 6, 1.0)
        names = [str(k) for k in range(len(values))]
        hits += not estimate(values, names, "mean", rng).interval.excludes(0.0)
    assert hits / 100 < 0.8


def test_with_few_tracks_the_interval_is_about_these_tracks() -> None:
    rng, hits = np.random.default_rng(4), 0
    for _ in range(150):
        values, groups, of_track = drives(rng, 4, 10, 3.0)
        found = estimate(values, groups, "mean", rng)
        hits += not found.interval.excludes(float(of_track.mean()))
        assert not found.general
    assert hits / 150 > 0.95 - 5 * 0.018


def test_the_test_rejects_what_is_true_as_often_as_it_says() -> None:
    rng, false = np.random.default_rng(5), 0
    for _ in range(300):
        values, groups, _ = drives(rng, LEAST_GROUPS, 5, 1.0)
        false += signed_rank(values, groups, "median") < 0.05
    assert false / 300 < 0.05 + 4 * 0.0126


def test_one_value_says_nothing_and_lonely_ones_are_taken_together() -> None:
    rng = np.random.default_rng(6)
    alone = estimate(np.array([1.0]), ["a"], "median", rng)
    assert math.isnan(alone.interval.low)
    assert not alone.interval.excludes(0.0)
    none = estimate(np.zeros(0), [], "median", rng)
    assert math.isnan(none.value)
    lonely = estimate(np.array([1.0, 2.0, 3.0]), ["a", "b", "c"], "median", rng)
    assert 1.0 <= lonely.interval.low < lonely.interval.high <= 3.0
    uneven = estimate(np.array([1.0, 2.0, 9.0]), ["a", "a", "b"], "median", rng)
    assert uneven.interval.high == 9.0


def test_signed_ranks_by_hand() -> None:
    # All of n on one side: 2 / 2^n.
    six = signed_rank(np.arange(1.0, 7.0), ["a"] * 6, "median")
    assert six == pytest.approx(2 / 2**6)
    assert signed_rank(np.zeros(5), ["a"] * 5, "median") == 1.0
    # Ties do not make it less exact: five of one size are on one side in 2 of 2^5.
    assert signed_rank(np.ones(5), ["a"] * 5, "median") == pytest.approx(2 / 2**5)
    # Zeros do not count, and 8 tracks count as 8 however many drives each has.
    of_8 = np.repeat(np.arange(1.0, 9.0), 5)
    tracks = [str(k) for k in range(8) for _ in range(5)]
    assert signed_rank(of_8, tracks, "median") == pytest.approx(2 / 2**8)
    # A difference in one of five drives is none of the median, but one of the mean.
    seldom = np.tile([1.0, 0.0, 0.0, 0.0, 0.0], 8)
    assert signed_rank(seldom, tracks, "median") == 1.0
    assert signed_rank(seldom, tracks, "mean") == pytest.approx(2 / 2**8)


def test_failures_on_one_track_are_one_observation() -> None:
    tracks = [str(k) for k in range(LEAST_GROUPS) for _ in range(10)]
    never = np.zeros(len(tracks), dtype=np.bool_)
    one_track = np.array([track == "0" for track in tracks])
    assert mcnemar(one_track, never, tracks) == 1.0
    assert mcnemar(one_track, never, ["a"] * len(tracks)) == pytest.approx(2 / 2**10)
    spread = np.arange(len(tracks)) % 10 == 0
    assert mcnemar(spread, never, tracks) == pytest.approx(2 / 2**LEAST_GROUPS)


def test_a_rate_is_less_certain_where_failures_come_in_groups() -> None:
    tracks = [str(k) for k in range(10) for _ in range(10)]
    one_track = np.arange(100) < 10
    found, alone = rate_over(one_track, tracks), rate(10, 100)
    assert (found.count, found.of) == (10, 100)
    # The share's variance over 10 tracks is that of ten runs, less one to know it by.
    worth = 0.1 * 0.9 / (10 / 9 * (9.0**2 + 9 * 1.0**2) / 100**2)
    assert worth == pytest.approx(9.0)
    assert found == rate(10, 100, worth)
    assert found.interval.high > alone.interval.high + 0.1
    assert rate_over(np.arange(100) % 10 == 0, tracks) == alone
    assert rate_over(one_track, ["a"] * 100) == alone
    assert rate_over(np.zeros(100, dtype=np.bool_), tracks) == rate(0, 100)


def test_sign_test_is_binomial() -> None:
    assert sign_test(0, 6) == pytest.approx(2 / 2**6)
    assert sign_test(6, 0) == pytest.approx(2 / 2**6)
    assert sign_test(2, 2) == 1.0
    assert sign_test(0, 0) == 1.0


def test_a_rate_has_wilsons_interval() -> None:
    z, n, k = 1.959963985, 40, 2
    middle = (k + z**2 / 2) / (n + z**2)
    half = z * math.sqrt(k * (n - k) / n + z**2 / 4) / (n + z**2)
    found = rate(k, n)
    assert found.interval.low == pytest.approx(middle - half)
    assert found.interval.high == pytest.approx(middle + half)
    assert rate(0, 40).interval.low == 0.0
    assert rate(40, 40).interval.high == 1.0
    assert rate(0, 40).interval.high == pytest.approx(z**2 / (40 + z**2))
    assert math.isnan(rate(0, 0).interval.low)


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


def test_an_interval_excludes_what_lies_outside() -> None:
    assert Interval(0.9, 0.99).excludes(1.0)
    assert not Interval(0.9, 1.0).excludes(1.0)
    assert not Interval(math.nan, math.nan).excludes(1.0)
