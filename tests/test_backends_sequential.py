"""Pairing one after the other, where nearest neighbours fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.association import associate
from conegraph.backends.landmark_filter import PredictedCones
from conegraph.backends.pairing_problem import Pairing, Problem
from conegraph.config import AssociationConfig
from conegraph.geometry import rotation
from conegraph.types import Array

CONFIG = AssociationConfig()
SIGMA_M = 0.05


def predicted(mapped: Array, pose_cov: Array, own_sigma_m: float) -> PredictedCones:
    """Return cones in the car frame whose error is that of the car's pose.

    ``h = R' (l - p)`` moves by ``-dp - J h dpsi`` (J the quarter turn).
    """
    k = len(mapped)
    H = np.zeros((2 * k, 3))
    H[0::2, 0] = H[1::2, 1] = -1.0
    H[0::2, 2], H[1::2, 2] = mapped[:, 1], -mapped[:, 0]
    cov = H @ pose_cov @ H.T + own_sigma_m**2 * np.eye(2 * k)
    return PredictedCones(np.arange(k), mapped, cov)


def problem(
    seen: Array,
    mapped: Array,
    pose_cov: Array,
    *,
    own_sigma_m: float = SIGMA_M,
    loose_m: float = 10.0,
) -> Problem:
    m, k = len(seen), len(mapped)
    return Problem(
        seen,
        np.tile(SIGMA_M**2 * np.eye(2), (m, 1, 1)),
        predicted(mapped, pose_cov, own_sigma_m),
        np.zeros((m, k)),
        np.ones((m, k), dtype=bool),
        np.full(k, loose_m),
        # Beside a density of 0.02 new cones per square metre.
        float(-2 * np.log(2 * np.pi * 0.02)),
        np.full(k, CONFIG.new_margin),
    )


def pair(asked: Problem, config: AssociationConfig = CONFIG) -> Pairing:
    return associate(config, asked)


ROW = np.array([[3.0 * i, 1.8 * (-1) ** i] for i in range(1, 7)])


def displaced(xy: Array, by_m: tuple[float, float], turn_rad: float = 0.0) -> Array:
    moved: Array = xy @ rotation(turn_rad).T + np.array(by_m)
    return moved


def test_a_frame_displaced_as_a_whole_is_paired_where_the_nearest_cone_is_wrong() -> (
    None
):
    # Cones 1.2 m apart in a row, seen 0.9 m farther on: the nearest cone is the
    # next. One cone apart from the row, sure alone, tells how far all moved.
    mapped = np.array([[4.0, 2.0], [5.2, 2.0], [6.4, 2.0], [7.6, 2.0], [6.0, -9.0]])
    pose_cov = np.diag([1.0**2, 0.01**2, 1e-8])
    asked = problem(displaced(mapped, (0.9, 0.0)), mapped, pose_cov)
    np.testing.assert_array_equal(pair(asked).column, range(5))
    nearest = pair(asked, AssociationConfig(method="nearest"))
    assert (nearest.column[:3] == [1, 2, 3]).all()


def test_once_paired_the_rest_is_judged_by_what_the_pairs_tell() -> None:
    # All six moved by 0.8 m under a sigma of 0.5 m: d2 alone is 2.5, but given the
    # first pairs what is left is only the cones' own error, and nothing moved.
    asked = problem(displaced(ROW, (0.8, 0.0)), ROW, np.diag([0.25, 0.25, 1e-8]))
    pairing = pair(asked)
    np.testing.assert_array_equal(pairing.column, range(6))
    alone = 0.64 / (0.25 + 2 * SIGMA_M**2)
    assert pairing.d2.max() <= alone + 1e-9
    # Given n pairs with residuals e, the next has e^2 / (S_n) with what remains of
    # 0.8 m after averaging: well below a tenth.
    assert np.sort(pairing.d2)[2] < 0.1


def test_a_pair_that_contradicts_the_others_is_not_made() -> None:
    # One cone moved against all others: alone it passes the gate (d2 about 5).
    seen = displaced(ROW, (0.6, 0.0))
    seen[5] = ROW[5] + (-0.6, 0.0)
    asked = problem(seen, ROW, np.diag([0.27**2, 0.27**2, 1e-8]))
    alone = 0.6**2 / (0.27**2 + 2 * SIGMA_M**2)
    assert alone < CONFIG.gate_d2
    np.testing.assert_array_equal(pair(asked).column, [0, 1, 2, 3, 4, -1])


def test_between_two_cones_nothing_is_chosen() -> None:
    mapped = np.array([[5.0, 0.5], [5.0, -0.5]])
    asked = problem(np.array([[5.0, 0.02]]), mapped, np.diag([0.25, 0.25, 1e-6]))
    pairing = pair(asked)
    np.testing.assert_array_equal(pairing.column, [-1])
    # It is known to lie near a cone: d2 = 0.48^2 / S.
    assert pairing.d2[0] < 1.0


def test_of_two_observations_of_one_cone_one_has_it_in_doubt_and_one_is_beside() -> (
    None
):
    seen = np.array([[5.0, 0.1], [5.0, -0.1]])
    asked = problem(seen, np.array([[5.0, 0.0]]), np.diag([0.04, 0.04, 1e-6]))
    pairing = pair(asked)
    assert pairing.cluster is not None
    np.testing.assert_array_equal(np.sort(pairing.column), [-1, 0])
    one = pairing.column == 0
    np.testing.assert_array_equal(pairing.cluster.soft, one)
    np.testing.assert_array_equal(pairing.cluster.beside, ~one)
    # Either is as likely: half of the squared 0.2 m between them, across.
    np.testing.assert_allclose(
        pairing.cluster.spread_m2[one][0], np.diag([0.0, 0.02]), atol=1e-3
    )


def test_colour_decides_where_place_does_not() -> None:
    mapped = np.array([[5.0, 0.5], [5.0, -0.5]])
    asked = problem(np.array([[5.0, 0.0]]), mapped, np.diag([0.25, 0.25, 1e-6]))
    assert pair(asked).column[0] == -1
    cost = np.array([[CONFIG.ambiguity_d2 + 0.01, 0.0]])
    assert pair(replace(asked, cost=cost)).column[0] == 1


def test_what_is_as_likely_a_new_cone_is_not_matched() -> None:
    mapped, seen = np.array([[5.0, 0.0]]), np.array([[5.1, 0.0]])
    asked = problem(seen, mapped, np.zeros((3, 3)))
    S = 2 * SIGMA_M**2
    d2, logdet = 0.01 / S, 2 * np.log(S)
    just = d2 + logdet + CONFIG.new_margin
    assert pair(replace(asked, new_cost=just + 1e-6)).column[0] == 0
    assert pair(replace(asked, new_cost=just - 1e-6)).column[0] == -1


def test_a_new_cone_beside_a_loosely_known_one_is_not_taken_for_it() -> None:
    # Five cones are known well; one far ahead within 2 m; a cone stands 1.5 m off
    # it. One cone alone cannot speak for a displacement.
    loose = np.array([[22.0, 1.0]])
    beside = np.array([[23.5, 1.0]])
    mapped = np.vstack([ROW[:5], loose])
    asked = problem(np.vstack([ROW[:5], beside]), mapped, 1e-8 * np.eye(3))
    cov = asked.predicted.cov_m2.copy()
    cov[10:, 10:] += 4.0 * np.eye(2)
    vague = replace(asked, predicted=PredictedCones(np.arange(6), mapped, cov))
    vague = replace(vague, loose_m=np.full(6, 0.7), new_cost=3.0)
    pairing = pair(vague)
    np.testing.assert_array_equal(pairing.column, [0, 1, 2, 3, 4, -1])
    np.testing.assert_array_equal(pairing.loose, [False] * 5 + [True])
    # Nothing speaks of the loose cone, so it does not forbid a new one beside it.
    assert np.isinf(pairing.free_d2[5])


def test_five_vague_cones_that_all_moved_alike_are_recognised() -> None:
    rng = np.random.default_rng(2)
    mapped = ROW[:5] + 0.3 * rng.normal(size=(5, 2))
    pose_cov = np.diag([4.0, 4.0, 1e-6])
    seen = displaced(mapped, (1.0, 0.0))
    asked = replace(problem(seen, mapped, pose_cov, loose_m=0.7), new_cost=3.0)
    np.testing.assert_array_equal(pair(asked).column, range(5))


def test_three_vague_cones_are_too_few_for_a_constellation() -> None:
    rng = np.random.default_rng(2)
    mapped = ROW[:3] + 0.3 * rng.normal(size=(3, 2))
    seen = displaced(mapped, (1.0, 0.0))
    asked = problem(seen, mapped, np.diag([4.0, 4.0, 1e-6]), loose_m=0.7)
    asked = replace(asked, new_cost=-1.0)
    np.testing.assert_array_equal(pair(asked).column, [-1, -1, -1])


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_cone_is_given_to_two_observations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mapped = rng.uniform([1, -6], [15, 6], (8, 2))
    seen = np.vstack([mapped[:5] + 0.3 * rng.normal(size=(5, 2)), mapped[2:4] + 0.1])
    pose_cov = np.diag([*rng.uniform(1e-4, 1, 2), 1e-3])
    column = pair(problem(seen, mapped, pose_cov, loose_m=0.7)).column
    matched = column[column >= 0]
    assert len(np.unique(matched)) == len(matched)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_observations_and_cones_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mapped = rng.uniform([1, -6], [15, 6], (7, 2))
    shift = 0.5 * rng.normal(size=2)
    seen = mapped[:6] + shift + SIGMA_M * rng.normal(size=(6, 2))
    asked = problem(seen, mapped, np.diag([0.25, 0.25, 1e-3]), loose_m=1.2)
    straight = pair(asked)
    order, places = rng.permutation(6), rng.permutation(7)
    index = np.stack([2 * places, 2 * places + 1], axis=1).ravel()
    moved = replace(
        asked,
        xy_m=seen[order],
        noise_m2=asked.noise_m2[order],
        predicted=PredictedCones(
            np.arange(7), mapped[places], asked.predicted.cov_m2[np.ix_(index, index)]
        ),
    )
    mixed = pair(moved)
    back = np.where(mixed.column >= 0, places[mixed.column], -1)
    np.testing.assert_array_equal(back, straight.column[order])
    np.testing.assert_allclose(mixed.d2, straight.d2[order], rtol=1e-6, atol=1e-9)


def test_sure_places_are_all_recognised_whatever_the_drift() -> None:
    tried = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        mapped = rng.uniform([1, -8], [20, 8], (6, 2))
        gaps = np.linalg.norm(mapped[:, None] - mapped, axis=2) + 100 * np.eye(6)
        shift = rng.normal(size=2) * 0.15
        seen = displaced(mapped, (shift[0], shift[1]), 0.005 * rng.normal())
        # Each so near its own place that it beats "a new cone" by itself, within
        # 1.9 sigma of 0.3 m, and none near another's.
        drift_m = np.linalg.norm(seen - mapped, axis=1).max()
        if gaps.min() < 3.0 or drift_m > 0.57:
            continue
        tried += 1
        asked = problem(seen, mapped, np.diag([0.09, 0.09, 1e-4]))
        np.testing.assert_array_equal(pair(asked).column, range(6))
    assert tried >= 10
