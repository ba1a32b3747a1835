"""The likeliest assignment of a frame, against every assignment there is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.association import associate
from conegraph.backends.landmark_filter import PredictedCones
from conegraph.backends.one_to_one import assign, unambiguous
from conegraph.backends.pairing_problem import Problem
from conegraph.config import AssociationConfig
from conegraph.types import Array

CONFIG = AssociationConfig(method="one_to_one")

S_M2 = 0.02
"""Innovation variance of every pair below: 0.01 of the sensor, 0.01 of the cone."""

LOG_DET = 2.0 * np.log(S_M2)


def problem(
    seen: Array, mapped: Array, new_cost: float = 20.0, margin: float = 3.0
) -> Problem:
    m, k = len(seen), len(mapped)
    return Problem(
        seen,
        np.tile(0.5 * S_M2 * np.eye(2), (m, 1, 1)),
        PredictedCones(np.arange(k), mapped, 0.5 * S_M2 * np.eye(2 * k)),
        np.zeros((m, k)),
        np.ones((m, k), dtype=bool),
        np.full(k, 10.0),
        new_cost,
        np.full(k, margin),
    )


def ways(cost: Array, used: tuple[int, ...] = ()) -> Iterator[tuple[int, ...]]:
    """Yield every assignment, -1 for none."""
    if len(cost) == 0:
        yield ()
        return
    for j in [-1, *np.flatnonzero(np.isfinite(cost[0])).tolist()]:
        if j < 0 or j not in used:
            for rest in ways(cost[1:], (*used, j)):
                yield (j, *rest)


def total(cost: Array, way: tuple[int, ...]) -> float:
    return float(sum(cost[i, j] for i, j in enumerate(way) if j >= 0))


@st.composite
def costs(draw: st.DrawFn) -> Array:
    m, k = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    cost = rng.uniform(-10.0, 2.0, (m, k))
    cost[rng.random((m, k)) < 0.3] = np.inf
    return cost


@settings(deadline=None)
@given(costs())
def test_no_assignment_is_cheaper(cost: Array) -> None:
    got = assign(cost)
    best = min(total(cost, way) for way in ways(cost))
    assert total(cost, tuple(got.tolist())) == pytest.approx(best, abs=1e-9)


@settings(deadline=None)
@given(costs(), st.floats(0.5, 8.0))
def test_what_is_unambiguous_leads_every_other_pair(cost: Array, margin: float) -> None:
    column = assign(cost)
    best = total(cost, tuple(column.tolist()))
    clear = unambiguous(cost, column, margin)
    for i, j in enumerate(column.tolist()):
        if j < 0:
            assert not clear[i]
            continue
        rivals = [
            total(cost, way)
            for way in ways(cost)
            if way[i] != j and (way[i] >= 0 or j in way)
        ]
        lead = min(rivals, default=np.inf) - best
        if abs(lead - margin) > 1e-9:
            assert clear[i] == (lead >= margin)


def test_the_whole_frame_is_weighed_where_the_nearest_is_taken_away() -> None:
    # On a line, cones at 0 and 1, observations at 0.45 and 0.0. The first is nearest
    # to the cone at 0, but that would leave the second none: 0.2025 / S = 10.1
    # against 0.3025 / S = 15.1 for the first and 0 for the second.
    mapped = np.array([[5.0, 0.0], [5.0, 1.0]])
    seen = np.array([[5.0, 0.45], [5.0, 0.0]])
    wide = CONFIG.model_copy(update={"gate_d2": 20.0})
    asked = problem(seen, mapped, new_cost=30.0, margin=0.0)
    np.testing.assert_array_equal(associate(wide, asked).column, [1, 0])
    alone = associate(wide, problem(seen[:1], mapped, 30.0, 0.0))
    assert alone.column[0] in (-1, 0)


@pytest.mark.parametrize(("lead", "matched"), [(5.9, -1), (6.1, 0)])
def test_a_match_leads_its_rival_by_the_margin(lead: float, matched: int) -> None:
    # Between cones a metre apart, at a from the one: lead = (1 - 2 a) / S.
    a = 0.5 * (1.0 - lead * S_M2)
    wide = CONFIG.model_copy(update={"gate_d2": 100.0})
    asked = problem(np.array([[5.0, a]]), np.array([[5.0, 0.0], [5.0, 1.0]]), 60.0)
    assert associate(wide, asked).column[0] == matched


@pytest.mark.parametrize(("gain", "matched"), [(2.9, -1), (3.1, 0)])
def test_a_match_must_beat_a_new_cone(gain: float, matched: int) -> None:
    # d2 = 0.2^2 / S = 2; gain = new_cost - d2 - log|S|.
    asked = problem(
        np.array([[5.0, 0.2]]), np.array([[5.0, 0.0]]), 2.0 + LOG_DET + gain
    )
    pairing = associate(CONFIG, asked)
    assert pairing.column[0] == matched
    assert pairing.d2[0] == pytest.approx(2.0)


def test_colour_tells_apart_what_distance_does_not() -> None:
    mapped = np.array([[5.0, 0.0], [5.0, 0.9]])
    asked = problem(np.array([[5.0, 0.45]]), mapped)
    assert associate(CONFIG, asked).column[0] == -1
    coloured = replace(asked, cost=np.array([[-2.0, 5.0]]))
    assert associate(CONFIG, coloured).column[0] == 0


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_rows_and_columns_says_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mapped = rng.uniform(0.0, 3.0, (6, 2))
    seen = mapped[rng.permutation(6)[:5]] + 0.1 * rng.standard_normal((5, 2))
    rows, columns = rng.permutation(5), rng.permutation(6)
    first = associate(CONFIG, problem(seen, mapped)).column
    again = associate(CONFIG, problem(seen[rows], mapped[columns])).column
    named = np.where(again >= 0, columns[again], -1)
    np.testing.assert_array_equal(named, first[rows])
    taken = first[first >= 0]
    assert len(np.unique(taken)) == len(taken)
