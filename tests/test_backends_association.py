"""The methods side by side: empty frames, forbidden pairs, nearest neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from conegraph.backends.association import associate
from conegraph.backends.landmark_filter import PredictedCones
from conegraph.backends.pairing_problem import Problem
from conegraph.config import AssociationConfig
from conegraph.types import Array

Method = Literal["sequential", "one_to_one", "jcbb", "nearest", "known"]
METHODS: list[Method] = ["sequential", "one_to_one", "jcbb", "nearest", "known"]


def problem(seen: Array, mapped: Array, sigma_m: float = 0.1) -> Problem:
    m, k = len(seen), len(mapped)
    return Problem(
        seen,
        np.tile(0.01 * np.eye(2), (m, 1, 1)),
        PredictedCones(np.arange(k), mapped, sigma_m**2 * np.eye(2 * k)),
        np.zeros((m, k)),
        np.ones((m, k), dtype=bool),
        np.full(k, 10.0),
        20.0,
        np.full(k, 3.0),
    )


@pytest.mark.parametrize("method", METHODS)
def test_without_cones_nothing_is_matched(method: Method) -> None:
    config = AssociationConfig(method=method)
    xy = np.array([[5.0, 1.0], [8.0, -1.0]])
    unmapped = associate(config, problem(xy, np.zeros((0, 2))))
    np.testing.assert_array_equal(unmapped.column, [-1, -1])
    assert np.isinf(unmapped.d2).all()
    unseen = associate(config, problem(np.zeros((0, 2)), xy))
    assert unseen.column.shape == (0,)
    assert unseen.loose.shape == (2,)


@pytest.mark.parametrize("method", METHODS)
def test_cones_in_their_places_are_matched(method: Method) -> None:
    mapped = np.array([[5.0, 1.0], [8.0, -1.0], [11.0, 2.0]])
    order = [2, 0, 1]
    asked = problem(mapped[order], mapped)
    if method == "known":
        asked = replace(asked, allowed=np.eye(3, dtype=bool)[order])
    pairing = associate(AssociationConfig(method=method), asked)
    np.testing.assert_array_equal(pairing.column, order)
    np.testing.assert_allclose(pairing.d2, 0.0, atol=1e-12)


def test_two_observations_may_share_a_nearest_cone() -> None:
    seen = np.array([[5.0, 0.1], [5.0, -0.1]])
    mapped = np.array([[5.0, 0.0], [15.0, 0.0]])
    pairing = associate(AssociationConfig(method="nearest"), problem(seen, mapped))
    np.testing.assert_array_equal(pairing.column, [0, 0])
    # S = 0.01 + 0.01: 0.1^2 / 0.02.
    np.testing.assert_allclose(pairing.d2, 0.5)


def test_the_nearest_cone_is_the_nearest_in_its_own_uncertainty() -> None:
    seen, mapped = np.array([[5.0, 0.0]]), np.array([[5.0, 0.3], [5.0, -0.4]])
    asked = problem(seen, mapped)
    cov = np.diag([0.01, 0.01, 0.16, 0.16])
    asked = replace(asked, predicted=PredictedCones(np.arange(2), mapped, cov))
    pairing = associate(AssociationConfig(method="nearest"), asked)
    # 0.09 / 0.02 = 4.5 against 0.16 / 0.17.
    np.testing.assert_array_equal(pairing.column, [1])
    np.testing.assert_allclose(pairing.d2, 0.16 / 0.17)


def test_the_gate_is_the_last_that_counts() -> None:
    # S = 0.02 I, so d2 = e^2 / 0.02 meets a gate of 8 at e = 0.4.
    config = AssociationConfig(method="nearest", gate_d2=8.0)
    mapped = np.array([[5.0, 0.0], [9.0, 0.0]])
    seen = np.array([[5.0, 0.399], [9.0, 0.401]])
    pairing = associate(config, problem(seen, mapped))
    np.testing.assert_array_equal(pairing.column, [0, -1])


@pytest.mark.parametrize("method", METHODS)
def test_forbidden_pairs_are_never_made(method: Method) -> None:
    # Two cones so near to each other that distance alone would swap them.
    mapped = np.array([[5.0, 0.0], [5.0, 0.3]])
    seen = np.array([[5.0, 0.28], [5.0, 0.02]])
    asked = replace(problem(seen, mapped), allowed=np.eye(2, dtype=bool))
    pairing = associate(AssociationConfig(method=method), asked)
    np.testing.assert_array_equal(pairing.column, [0, 1])


@pytest.mark.parametrize("method", METHODS)
def test_an_observation_with_no_allowed_cone_stays_alone(method: Method) -> None:
    mapped = np.array([[5.0, 0.0], [8.0, 0.3]])
    allowed = np.array([[False, False], [False, True]])
    asked = replace(problem(mapped, mapped), allowed=allowed)
    pairing = associate(AssociationConfig(method=method), asked)
    np.testing.assert_array_equal(pairing.column, [-1, 1])


def test_known_ids_pair_however_far_apart() -> None:
    mapped = np.array([[5.0, 0.0], [8.0, 3.0]])
    asked = problem(mapped[::-1] + 7.0, mapped)
    asked = replace(asked, allowed=np.eye(2, dtype=bool)[::-1])
    pairing = associate(AssociationConfig(method="known"), asked)
    np.testing.assert_array_equal(pairing.column, [1, 0])
    # S = 0.02 I and an offset of 7 m along both axes.
    np.testing.assert_allclose(pairing.d2, 2 * 49.0 / 0.02)
