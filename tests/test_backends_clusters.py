"""Posts nearer to each other than a sensor is precise, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conegraph.backends.clusters import settle_clusters
from conegraph.backends.landmark_filter import PredictedCones
from conegraph.backends.pairing_problem import Problem
from conegraph.backends.pairing_state import PairingState
from conegraph.config import AssociationConfig
from conegraph.types import Array

CONFIG = AssociationConfig()
S_M2 = 0.02
"""Innovation variance of a pair: half of the sensor, half of the post."""

NEW_COST = 10.0


def problem(seen: Array, mapped: Array) -> Problem:
    m, k = len(seen), len(mapped)
    return Problem(
        seen,
        np.tile(0.5 * S_M2 * np.eye(2), (m, 1, 1)),
        PredictedCones(np.arange(k), mapped, 0.5 * S_M2 * np.eye(2 * k)),
        np.zeros((m, k)),
        np.ones((m, k), dtype=bool),
        np.full(k, 10.0),
        NEW_COST,
        np.full(k, CONFIG.new_margin),
    )


def settle(asked: Problem) -> PairingState:
    return settle_clusters(CONFIG, asked, PairingState.start(asked))


def test_one_sight_between_two_posts_is_one_of_them() -> None:
    posts = np.array([[5.0, 0.15], [5.0, -0.15]])
    state = settle(problem(np.array([[5.0, 0.0]]), posts))
    assert state.column[0] in (0, 1)
    assert state.soft[0]
    # Ways: new, the one, the other, with scores 0, g, g. In the last it is 0.3 m off.
    g = NEW_COST - 0.15**2 / S_M2 - 2 * np.log(S_M2)
    other = np.exp(g / 2) / (1 + 2 * np.exp(g / 2))
    np.testing.assert_allclose(state.spread_m2[0], np.diag([0.0, other * 0.09]))
    assert state.d2[0] == pytest.approx(0.15**2 / S_M2)


def test_a_soft_pair_corrects_by_what_it_says() -> None:
    posts = np.array([[5.0, 0.15], [5.0, -0.15]])
    state = settle(problem(np.array([[5.2, 0.0]]), posts))
    j = int(state.column[0])
    # Along x nothing is open: gain 0.01 / 0.02 of 0.2 m. Across, the spread is added.
    assert state.h[j, 0] == pytest.approx(5.1)
    gain = 0.01 / (S_M2 + state.spread_m2[0, 1, 1])
    assert state.h[j, 1] == pytest.approx(posts[j, 1] * (1 - gain))
    assert state.cov[2 * j, 2 * j] == pytest.approx(0.005)


def test_two_sights_of_two_posts_are_told_apart_together() -> None:
    posts = np.array([[5.0, 0.2], [5.0, -0.2]])
    seen = posts[::-1] + np.array([0.0, 0.1])
    state = settle(problem(seen, posts))
    np.testing.assert_array_equal(state.column, [1, 0])
    # Straight: 2 * 0.01 / S = 1. Crossed: (0.5^2 + 0.3^2) / S = 17. Less one pair:
    # at least g more. So nothing is open and hardly anything is added.
    assert not state.soft.any()
    assert np.abs(state.spread_m2).max() < 0.16 * np.exp(-8.0) * 1.01


def test_a_second_sight_beside_the_only_post_is_a_new_one() -> None:
    asked = problem(np.array([[5.0, 0.0], [5.0, 0.5]]), np.array([[5.0, 0.02]]))
    state = settle(asked)
    np.testing.assert_array_equal(state.column, [0, -1])
    assert state.beside.tolist() == [False, True]


def test_two_sights_that_may_be_one_thing_make_no_new_cone() -> None:
    # 0.1 m apart with 0.02 m^2 between them: d2 = 0.5, less than APART_D2.
    asked = problem(np.array([[5.0, 0.0], [5.0, 0.1]]), np.array([[5.0, 0.0]]))
    assert not settle(asked).beside.any()


def test_cones_of_a_boundary_are_no_cluster() -> None:
    posts = np.array([[5.0, 0.5], [5.0, -0.5]])
    wide = replace(
        problem(np.array([[5.0, 0.0]]), posts), noise_m2=np.tile(np.eye(2), (1, 1, 1))
    )
    state = settle(wide)
    assert state.column[0] == -1
    assert not state.soft.any()


def test_forbidden_posts_are_no_candidates() -> None:
    posts = np.array([[5.0, 0.15], [5.0, -0.15]])
    seen = np.array([[5.0, 0.1], [5.0, 0.0]])
    asked = replace(
        problem(seen, posts), allowed=np.array([[False, True], [False, True]])
    )
    state = settle(asked)
    assert sorted(state.column.tolist()) == [-1, 1]
