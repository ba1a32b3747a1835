"""Joint compatibility: numbers in closed form, and properties of every answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends import jcbb
from conegraph.backends.association import associate
from conegraph.backends.jcbb import Interpretation, joint_gate, judged_by_others
from conegraph.backends.landmark_filter import PredictedCones
from conegraph.backends.pairing_problem import Problem
from conegraph.config import AssociationConfig
from conegraph.geometry import rotation
from conegraph.types import Array, IntArray

CONFIG = AssociationConfig(method="jcbb")
SIGMA_M = 0.05


def problem(seen: Array, mapped: Array, pose_cov: Array) -> Problem:
    """Cones whose error is that of the car's pose and, each, `SIGMA_M`.

    ``h = R' (l - p)`` moves by ``-dp - J h dpsi`` (J the quarter turn).
    """
    m, k = len(seen), len(mapped)
    H = np.zeros((2 * k, 3))
    H[0::2, 0] = H[1::2, 1] = -1.0
    H[0::2, 2], H[1::2, 2] = mapped[:, 1], -mapped[:, 0]
    cov = H @ pose_cov @ H.T + SIGMA_M**2 * np.eye(2 * k)
    return Problem(
        seen,
        np.tile(SIGMA_M**2 * np.eye(2), (m, 1, 1)),
        PredictedCones(np.arange(k), mapped, cov),
        np.zeros((m, k)),
        np.ones((m, k), dtype=bool),
        np.full(k, 10.0),
        float(-2 * np.log(2 * np.pi * 0.02)),
        np.full(k, CONFIG.new_margin),
    )


def joint_d2(asked: Problem, row: IntArray, column: IntArray) -> float:
    """``z' S^-1 z`` of pairs, with all of S."""
    index = np.stack([2 * column, 2 * column + 1], axis=1).ravel()
    S = asked.predicted.cov_m2[np.ix_(index, index)].copy()
    for n, i in enumerate(row):
        S[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] += asked.noise_m2[i]
    z = (asked.xy_m[row] - asked.predicted.xy_m[column]).ravel()
    return float(z @ np.linalg.solve(S, z))


def test_the_joint_gate_is_a_quantile_of_chi2() -> None:
    # With two degrees of freedom P(d2 < g) = 1 - exp(-g / 2).
    assert joint_gate(1, 0.999) == pytest.approx(-2.0 * np.log(0.001))
    # With four, 1 - (1 + g / 2) exp(-g / 2).
    g = joint_gate(2, 0.999)
    assert (1.0 + g / 2.0) * np.exp(-g / 2.0) == pytest.approx(0.001)


def test_pair_by_pair_the_joint_distance_is_that_of_all_at_once() -> None:
    rng = np.random.default_rng(1)
    mapped = rng.uniform(2.0, 12.0, (6, 2))
    asked = problem(mapped[:5] + 0.3, mapped, np.diag([0.5, 0.3, 0.01]))
    node = Interpretation(np.full(5, -1))
    order = [3, 0, 4, 1, 2]
    for n, i in enumerate(order, start=1):
        node = node.joined_by(asked, i, i, 0.0)
        used = np.array(order[:n])
        assert node.d2 == pytest.approx(joint_d2(asked, used, used))
        assert node.d2 == pytest.approx(node.white @ node.white)
    # log|S| is what the costs add to d2, beside log|R| of each pair.
    logs = 2.0 * np.log(np.diag(node.chol)).sum() - 5 * 2.0 * np.log(SIGMA_M**2)
    assert node.cost - node.d2 == pytest.approx(logs)


def test_a_pair_judged_by_the_others_is_the_last_of_them_to_join() -> None:
    rng = np.random.default_rng(2)
    mapped = rng.uniform(2.0, 12.0, (4, 2))
    asked = problem(mapped + 0.2, mapped, np.diag([0.5, 0.3, 0.01]))
    all_ = np.arange(4)
    d2, logdet = judged_by_others(asked, all_, all_)
    for last in range(4):
        node = Interpretation(np.full(4, -1))
        for i in [*np.delete(all_, last).tolist(), last]:
            before, node = node, node.joined_by(asked, i, i, 0.0)
        assert d2[last] == pytest.approx(node.d2 - before.d2)
        own = 2.0 * np.log(np.diag(node.chol)[-2:]).sum()
        assert logdet[last] == pytest.approx(own)


def test_pairs_that_each_pass_alone_must_agree() -> None:
    # Seen 0.9 m farther on, in a row 1.2 m apart under 1 m of doubt: the nearest cone
    # is the next but for the one that stands apart and has no next.
    mapped = np.array([[4.0, 2.0], [5.2, 2.0], [6.4, 2.0], [7.6, 2.0], [6.0, -9.0]])
    asked = problem(mapped + np.array([0.9, 0.0]), mapped, np.diag([1.0, 1e-4, 1e-8]))
    np.testing.assert_array_equal(associate(CONFIG, asked).column, range(5))
    nearest = associate(CONFIG.model_copy(update={"method": "nearest"}), asked)
    assert (nearest.column[:3] == [1, 2, 3]).all()


def test_an_observation_that_contradicts_the_others_stays_alone() -> None:
    mapped = np.array([[4.0, 2.0], [7.0, -2.0], [10.0, 2.0], [13.0, -2.0]])
    seen = mapped + np.array([0.6, 0.0])
    seen[3] = mapped[3] - np.array([0.6, 0.0])
    asked = problem(seen, mapped, np.diag([0.25, 1e-4, 1e-8]))
    # Alone it is as good as the others: 0.36 / (0.25 + 2 * 0.05^2) = 1.4.
    pairing = associate(CONFIG, asked)
    np.testing.assert_array_equal(pairing.column, [0, 1, 2, -1])


def test_a_row_shifted_by_one_cone_is_left_open() -> None:
    # Three of five equally spaced cones, seen half a spacing off.
    mapped = np.array([[2.0 * i, 0.0] for i in range(1, 6)])
    seen = mapped[1:4] + np.array([1.0, 0.0])
    asked = problem(seen, mapped, np.diag([1.0, 1e-4, 1e-8]))
    assert (associate(CONFIG, asked).column == -1).all()
    # At 0.1 m under 0.5 m of doubt the neighbours are (1.9^2 - 0.1^2) / 0.25 worse.
    near = replace(asked, xy_m=mapped[1:4] + np.array([0.1, 0.0]))
    sharp = replace(
        near, predicted=problem(seen, mapped, np.diag([0.25, 1e-4, 1e-8])).predicted
    )
    np.testing.assert_array_equal(associate(CONFIG, sharp).column, [1, 2, 3])


def test_a_search_cut_short_answers_with_what_it_has(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mapped = np.array([[3.0 * i, 1.8 * (-1) ** i] for i in range(1, 9)])
    asked = problem(mapped + 0.02, mapped, np.diag([1.0, 1.0, 1e-4]))
    monkeypatch.setattr(jcbb, "MAX_NODES", 0)
    column = associate(CONFIG, asked).column
    found = column >= 0
    assert found.any()
    np.testing.assert_array_equal(column[found], np.flatnonzero(found))


@st.composite
def worlds(draw: st.DrawFn) -> tuple[Problem, np.random.Generator]:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    k = draw(st.integers(1, 7))
    mapped = rng.uniform(-6.0, 6.0, (k, 2)) + np.array([8.0, 0.0])
    pose_cov = np.diag([0.3, 0.3, 0.05]) ** 2
    shift = 0.3 * rng.standard_normal(2)
    moved = mapped @ rotation(0.05 * float(rng.standard_normal())).T + shift
    seen = moved[rng.random(k) < 0.8] + SIGMA_M * rng.standard_normal(2)
    clutter = rng.uniform(-6.0, 6.0, (draw(st.integers(0, 2)), 2))
    clutter += np.array([8.0, 0.0])
    return problem(np.vstack([seen, clutter]), mapped, pose_cov), rng


@settings(deadline=None, max_examples=60)
@given(worlds())
def test_every_answer_is_one_to_one_compatible_and_free_of_order(
    world: tuple[Problem, np.random.Generator],
) -> None:
    asked, rng = world
    column = associate(CONFIG, asked).column
    row = np.flatnonzero(column >= 0)
    assert len(np.unique(column[row])) == len(row)
    if len(row):
        confidence = 1.0 - np.exp(-0.5 * CONFIG.gate_d2)
        assert joint_d2(asked, row, column[row]) <= joint_gate(len(row), confidence)
    rows = rng.permutation(len(asked.xy_m))
    columns = rng.permutation(len(asked.predicted.xy_m))
    index = np.stack([2 * columns, 2 * columns + 1], axis=1).ravel()
    shuffled = replace(
        asked,
        xy_m=asked.xy_m[rows],
        predicted=PredictedCones(
            np.arange(len(columns)),
            asked.predicted.xy_m[columns],
            asked.predicted.cov_m2[np.ix_(index, index)],
        ),
    )
    again = associate(CONFIG, shuffled).column
    named = np.where(again >= 0, columns[again], -1)
    np.testing.assert_array_equal(named, column[rows])
