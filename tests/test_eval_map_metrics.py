"""Map errors against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.eval.map_metrics import map_metrics
from conegraph.geometry import inverse, to_parent
from conegraph.types import Array, ConeClass, ConeMap, IntArray, TruthMap

B, Y, SO, BO, U = ConeClass
SIGMA_M = 0.1


def ring(n: int = 40) -> TruthMap:
    """Cones on an ellipse, no two alike, alternately blue and yellow."""
    a = np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    xy = np.stack([40 * np.cos(a) + 5 * np.cos(3 * a), 25 * np.sin(a)], axis=-1)
    return TruthMap(np.arange(100, 100 + n), xy, np.tile([B, Y], n // 2))


def cone_map(xy_m: Array, classes: IntArray) -> ConeMap:
    n = len(xy_m)
    prob = np.full((n, 5), 0.05)
    prob[np.arange(n), classes] = 0.8
    cov = np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1))
    return ConeMap(np.arange(n), xy_m, cov, prob, np.full(n, 9))


def perfect(truth: TruthMap) -> ConeMap:
    return cone_map(truth.xy_m, truth.cone_class)


def test_a_rotated_map_has_no_error_aligned_and_a_known_one_in_the_start_frame() -> (
    None
):
    """Turned by a about the start, a cone at distance r is 2 r sin(a / 2) off."""
    truth, turn = ring(), 0.01
    start = np.array([40.0, -10.0, 1.2])
    seen = to_parent(inverse(start), truth.xy_m)
    turned = to_parent(np.array([0.0, 0.0, turn]), seen)
    m = map_metrics(cone_map(turned, truth.cone_class), truth, start_pose=start)
    assert m.start_frame is not None
    chords = 2 * np.sin(turn / 2) * np.linalg.norm(seen, axis=1)
    rms = np.sqrt(np.mean(chords**2))
    assert m.start_frame.rmse_m == pytest.approx(rms)
    assert m.start_frame.nees_per_dof == pytest.approx(rms**2 / SIGMA_M**2 / 2)
    assert m.rmse_aligned_m == pytest.approx(0.0, abs=1e-9)
    assert m.max_aligned_m == pytest.approx(0.0, abs=1e-9)
    assert (m.precision, m.recall, m.matched) == (1.0, 1.0, len(truth))


def test_drift_beyond_the_gate_lowers_the_start_frames_recall_and_shows_in_full() -> (
    None
):
    truth = ring()
    shifted = cone_map(truth.xy_m + np.array([1.5, 0.0]), truth.cone_class)
    m = map_metrics(
        shifted, truth, start_pose=np.zeros(3), trajectory_pose=np.array([-1.4, 0, 0])
    )
    assert m.start_frame is not None
    assert m.start_frame.recall == 0.0
    assert m.start_frame.precision == 0.0
    assert m.start_frame.rmse_m == pytest.approx(1.5)
    assert (m.recall, m.precision) == (1.0, 1.0)
    assert m.rmse_aligned_m == pytest.approx(0.0, abs=1e-9)


def test_half_a_map_has_half_the_recall_though_the_lenient_error_is_zero() -> None:
    truth = ring()
    half = cone_map(truth.xy_m[:20], truth.cone_class[:20])
    m = map_metrics(half, truth)
    assert m.lenient_nearest_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert (m.recall, m.recall_all, m.precision, m.missed) == (0.5, 0.5, 1.0, 20)


def test_recall_asks_only_for_what_could_be_seen() -> None:
    truth = ring()
    observable = np.arange(40) < 24
    half = cone_map(truth.xy_m[:20], truth.cone_class[:20])
    m = map_metrics(half, truth, observable=observable)
    assert m.recall == pytest.approx(20 / 24)
    assert m.recall_all == 0.5
    assert (m.observable, m.true, m.missed) == (24, 40, 4)


def test_one_of_two_true_cones_on_one_spot_is_enough() -> None:
    truth = ring()
    xy = np.concatenate([truth.xy_m, truth.xy_m[:2] + 0.1])
    twins = TruthMap(np.arange(42), xy, np.append(truth.cone_class, [0, 1]))
    found = map_metrics(perfect(truth), twins)
    assert (found.recall, found.observable, found.missed) == (1.0, 40, 0)
    assert found.recall_all == pytest.approx(40 / 42)
    neither = map_metrics(cone_map(truth.xy_m[2:], truth.cone_class[2:]), twins)
    assert (neither.observable, neither.missed) == (40, 2)
    assert neither.recall == pytest.approx(38 / 40)


def test_neither_place_nor_colour_is_measured_where_the_truth_is_two_cones() -> None:
    truth = ring()
    xy = np.concatenate([truth.xy_m, truth.xy_m[:1] + np.array([0.0, 0.14])])
    twins = TruthMap(np.arange(41), xy, np.append(truth.cone_class, Y))
    between = truth.xy_m.copy()
    between[0, 1] += 0.07
    one = map_metrics(perfect(TruthMap(truth.id, between, truth.cone_class)), twins)
    assert (one.matched, one.measured, one.recall, one.precision) == (40, 39, 1.0, 1.0)
    assert one.max_aligned_m == pytest.approx(0.0, abs=5e-3)
    assert one.nees_per_dof < 1e-2
    assert one.colour is not None
    assert one.colour.checked == 39
    both = map_metrics(perfect(twins), twins)
    assert (both.matched, both.measured, both.duplicates) == (41, 39, 0)
    assert (both.recall, both.precision, both.observable) == (1.0, 1.0, 41)


def test_a_band_says_how_far_from_one_the_figure_may_be() -> None:
    """Of 40 cones with 2 degrees of freedom each: 1 ± 1.96 sqrt(2 / 80), about."""
    m = map_metrics(perfect(ring()), ring())
    assert m.nees_band.low == pytest.approx(1 - 1.96 * np.sqrt(2 / 80), abs=0.03)
    assert m.nees_band.high == pytest.approx(1 + 1.96 * np.sqrt(2 / 80), abs=0.03)
    assert not m.nees_band.inside


def test_doubled_cones_are_duplicates_and_strays_are_false() -> None:
    truth = ring()
    xy = np.concatenate([truth.xy_m, truth.xy_m[:5] + 0.4, [[0.0, 0.0], [3.0, 3.0]]])
    m = map_metrics(cone_map(xy, np.zeros(47, np.int64)), truth)
    assert (m.duplicates, m.false_cones, m.matched) == (5, 2, 40)
    assert m.precision == pytest.approx(40 / 47)
    assert m.rmse_aligned_m == pytest.approx(0.0, abs=1e-9)


def test_colour_errors_are_told_apart() -> None:
    truth = ring(10)
    wanted = np.array([B, Y, SO, BO, SO, BO, U, U, B, Y])
    got = np.array([B, B, BO, SO, SO, BO, B, U, U, SO])
    m = map_metrics(cone_map(truth.xy_m, got), TruthMap(truth.id, truth.xy_m, wanted))
    assert m.colour is not None
    assert m.colour.checked == 8
    assert m.colour.errors == 2
    assert m.colour.orange_size == 2
    assert m.colour.unknown == 1
    confusion = np.zeros((5, 5), dtype=np.int64)
    for true, seen in zip(wanted.tolist(), got.tolist(), strict=True):
        confusion[true, seen] += 1
    np.testing.assert_array_equal(m.colour.confusion, confusion)
    assert confusion[B, B] == 1
    assert confusion[Y, SO] == 1


def test_without_a_true_colour_there_is_no_colour_figure() -> None:
    truth = ring(6)
    no_class = TruthMap(truth.id, truth.xy_m, np.full(6, U))
    assert map_metrics(perfect(truth), no_class).colour is None


def test_errors_as_large_as_the_covariance_says_give_one() -> None:
    """Offsets of sigma along x and y of alternating sign survive alignment."""
    truth = ring()
    sign = np.where(np.arange(40) % 2 == 0, 1.0, -1.0)[:, None]
    m = map_metrics(cone_map(truth.xy_m + SIGMA_M * sign, truth.cone_class), truth)
    assert m.nees_per_dof == pytest.approx(1.0, rel=0.02)
    assert m.rmse_aligned_m == pytest.approx(SIGMA_M * np.sqrt(2), rel=0.02)


def test_the_covariance_turns_with_the_map() -> None:
    """Errors of 0.3 m along the run's own x axis, where sigma is 0.3 m, 0.01 m across.

    Were the covariance not turned with the map, the figure would be about 200.
    """
    truth, pose = ring(), np.array([5.0, 5.0, 0.7])
    sign = np.where(np.arange(40) % 2 == 0, 1.0, -1.0)
    xy = to_parent(inverse(pose), truth.xy_m)
    xy[:, 0] += 0.3 * sign
    plain = cone_map(xy, truth.cone_class)
    cov = np.tile(np.diag([0.3**2, 0.01**2]), (40, 1, 1))
    run = ConeMap(plain.id, xy, cov, plain.class_prob, plain.observations)
    m = map_metrics(run, truth, start_pose=pose)
    assert m.start_frame is not None
    assert m.start_frame.nees_per_dof == pytest.approx(0.5)


def test_cones_without_a_covariance_do_not_count_for_consistency() -> None:
    truth = ring()
    whole = perfect(truth)
    none = ConeMap(
        whole.id, whole.xy_m, 0 * whole.cov_m2, whole.class_prob, whole.observations
    )
    assert np.isnan(map_metrics(none, truth).nees_per_dof)


def test_a_cone_that_is_nowhere_is_a_false_one() -> None:
    truth = ring()
    xy = np.concatenate([truth.xy_m, [[np.nan, 1.0]]])
    m = map_metrics(cone_map(xy, np.zeros(41, np.int64)), truth, start_pose=np.zeros(3))
    assert (m.matched, m.false_cones, m.duplicates) == (40, 1, 0)
    assert m.lenient_nearest_rmse_m == pytest.approx(0.0, abs=1e-9)


def test_an_empty_map_and_an_empty_truth_have_figures_without_errors() -> None:
    truth = ring()
    nothing = map_metrics(ConeMap.empty(), truth, start_pose=np.zeros(3))
    assert (nothing.recall, nothing.missed) == (0.0, 40)
    assert np.isnan(nothing.rmse_aligned_m)
    assert np.isnan(nothing.precision)
    no_truth = TruthMap(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0, np.int64))
    against_nothing = map_metrics(perfect(truth), no_truth)
    assert (against_nothing.precision, against_nothing.false_cones) == (0.0, 40)
    assert np.isnan(against_nothing.recall)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_order_of_cones_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = ring()
    xy = np.concatenate(
        [truth.xy_m[rng.random(40) < 0.8], rng.uniform(-40, 40, (5, 2))]
    )
    xy += rng.normal(0.0, 0.2, xy.shape)
    classes = rng.integers(0, 5, len(xy))
    shuffled, other = rng.permutation(len(xy)), rng.permutation(40)
    before = map_metrics(cone_map(xy, classes), truth, start_pose=np.zeros(3))
    after = map_metrics(
        cone_map(xy[shuffled], classes[shuffled]),
        TruthMap(truth.id[other], truth.xy_m[other], truth.cone_class[other]),
        start_pose=np.zeros(3),
    )
    first, second = before.to_dict(), after.to_dict()
    assert first.pop("colour") == second.pop("colour")
    assert first.pop("nees_band") == second.pop("nees_band")
    start, start_after = first.pop("start_frame"), second.pop("start_frame")
    assert start == pytest.approx(start_after)
    pose, pose_after = first.pop("pose_truth_run"), second.pop("pose_truth_run")
    assert pose == pytest.approx(pose_after, abs=1e-9)
    assert first == pytest.approx(second)
