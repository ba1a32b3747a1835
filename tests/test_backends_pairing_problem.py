"""Distances and colours that every association method weighs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.pairing_problem import Pairing, colour_cost, mahalanobis

BLUE = [0.9, 0.025, 0.025, 0.025, 0.025]
YELLOW = [0.025, 0.9, 0.025, 0.025, 0.025]
UNKNOWN = [0.0, 0.0, 0.0, 0.0, 1.0]
EVEN = [0.2] * 5


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 4))
def test_distances_are_those_of_linear_algebra(seed: int, m: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2 * k, 2 * k))
    joint = root @ root.T
    roots = rng.normal(size=(m, 2, 2))
    noise = roots @ roots.transpose(0, 2, 1) + 0.01 * np.eye(2)
    seen, predicted = rng.normal(size=(m, 2)), rng.normal(size=(k, 2))
    d2, logdet = mahalanobis(seen, noise, predicted, joint)
    for i in range(m):
        for j in range(k):
            S = joint[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] + noise[i]
            e = seen[i] - predicted[j]
            assert d2[i, j] == pytest.approx(e @ np.linalg.solve(S, e), rel=1e-6)
            assert logdet[i, j] == pytest.approx(np.linalg.slogdet(S)[1], abs=1e-6)


def test_colours_that_agree_are_a_bonus_and_others_a_penalty() -> None:
    cost = colour_cost(np.array([BLUE, UNKNOWN, EVEN]), np.array([BLUE, YELLOW]))
    # Unknown spreads evenly: blue is 0.9 + 0.025/4 of one colour, and the other
    # three are 0.025 + 0.025/4 each.
    same, other = 0.90625, 0.03125
    want = -2 * np.log(4 * (same**2 + 3 * other**2))
    assert cost[0, 0] == pytest.approx(want)
    want = -2 * np.log(4 * (2 * same * other + 2 * other**2))
    assert cost[0, 1] == pytest.approx(want)
    # What says nothing of the colour costs nothing.
    np.testing.assert_allclose(cost[1:], 0.0, atol=1e-12)


def test_sure_colours_are_not_trusted_without_bound() -> None:
    sure = np.eye(5)[:2]
    cost = colour_cost(sure, sure)
    np.testing.assert_allclose(np.diag(cost), -2 * np.log(4.0))
    assert cost[0, 1] == pytest.approx(-2 * np.log(0.05))


def test_matched_are_those_with_a_column() -> None:
    far = np.zeros(3)
    pairing = Pairing(np.array([2, -1, 0]), far, far, np.zeros(3, dtype=bool))
    np.testing.assert_array_equal(pairing.matched, [True, False, True])
