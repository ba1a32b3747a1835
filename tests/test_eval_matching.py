"""One-to-one matching, with the cases that a nearest neighbour gets wrong."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.eval.matching import best_match, find_twins, match_cones
from conegraph.geometry import inverse, to_parent


def test_each_true_cone_is_taken_once_and_the_rest_is_named() -> None:
    truth = np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]])
    estimate = np.array([[0.3, 0.0], [0.0, 0.1], [5.0, 0.2], [20.0, 0.0]])
    found = match_cones(estimate, truth)
    assert found.estimate.tolist() == [1, 2]
    assert found.truth.tolist() == [0, 1]
    np.testing.assert_allclose(found.distance_m, [0.1, 0.2])
    assert found.duplicate.tolist() == [0]
    assert found.false.tolist() == [3]
    assert found.missed.tolist() == [2]


def test_more_pairs_win_over_nearer_pairs() -> None:
    """Nearest first pairs 0.1 with 0.0 and strands 0.9; both have a partner."""
    truth = np.array([[0.0, 0.0], [-0.8, 0.0]])
    estimate = np.array([[0.1, 0.0], [0.9, 0.0]])
    found = match_cones(estimate, truth)
    assert found.truth.tolist() == [1, 0]
    np.testing.assert_allclose(found.distance_m, 0.9)


def test_the_gate_is_the_farthest_pair() -> None:
    truth, estimate = np.array([[0.0, 0.0]]), np.array([[0.5, 0.0]])
    assert len(match_cones(estimate, truth, max_distance_m=0.5)) == 1
    beyond = match_cones(estimate, truth, max_distance_m=0.499)
    assert (len(beyond), beyond.false.tolist(), beyond.missed.tolist()) == (0, [0], [0])


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0)])
def test_empty_sets_leave_everything_unmatched(n: int, m: int) -> None:
    found = match_cones(np.zeros((n, 2)), np.zeros((m, 2)))
    assert (len(found), len(found.false), len(found.missed)) == (0, n, m)


COORDINATES = st.lists(
    st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 2.0)), min_size=1, max_size=4
)


@given(a=COORDINATES, b=COORDINATES)
@settings(max_examples=60)
def test_is_the_best_of_all_assignments(
    a: list[tuple[float, float]], b: list[tuple[float, float]]
) -> None:
    """Compared with trying them all: most pairs, then least squared distance."""
    estimate, truth = np.array(a), np.array(b)
    found = match_cones(estimate, truth)
    swap = len(estimate) > len(truth)
    few, many = (truth, estimate) if swap else (estimate, truth)
    best = (0, 0.0)
    for choice in itertools.permutations(range(len(many)), len(few)):
        d = np.hypot(*(many[list(choice)] - few).T)
        best = min(best, (-int((d <= 1.0).sum()), float((d[d <= 1.0] ** 2).sum())))
    assert -len(found) == best[0]
    assert float((found.distance_m**2).sum()) == pytest.approx(best[1], abs=1e-9)


def test_alignment_and_pairs_are_found_from_a_rough_guess() -> None:
    """A guess off by 0.3 m and 1.5 degrees pairs only near cones at first."""
    angle = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    truth = np.stack([40 * np.cos(angle), 25 * np.sin(angle)], axis=-1)
    motion = np.array([12.0, -4.0, 0.8])
    estimate = to_parent(inverse(motion), truth)
    guess = motion + np.array([0.3, 0.0, np.deg2rad(1.5)])
    far = match_cones(to_parent(guess, estimate), truth)
    assert len(far) < len(truth)
    pose, found = best_match(estimate, truth, (np.zeros(3), guess))
    np.testing.assert_allclose(pose, motion, atol=1e-9)
    np.testing.assert_array_equal(found.estimate, found.truth)
    assert len(found) == len(truth)


def test_twins_are_found_and_neighbours_are_not() -> None:
    truth = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 0.1], [3.3, 0.0]])
    assert find_twins(truth).tolist() == [[1, 2]]
    assert find_twins(np.zeros((0, 2))).shape == (0, 2)
    assert find_twins(np.zeros((3, 2))).tolist() == [[0, 1], [0, 2], [1, 2]]
