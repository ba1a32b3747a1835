"""The contour between two colours, on rings whose middle is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.sim.lane_contour import (
    Chain,
    contours,
    neighbour_walls,
    ordered_wall,
)
from conegraph.types import Array


def ring(radius_m: float, count: int, phase: float = 0.0) -> Array:
    turn = phase + 2 * np.pi * np.arange(count) / count
    return radius_m * np.column_stack([np.cos(turn), np.sin(turn)])


def only_chain(left: Array, right: Array) -> Chain:
    (chain,) = contours(left, right, neighbour_walls(left, right))
    return chain


def turns(chain: Chain) -> float:
    """Return how often the chain goes round the origin, counter-clockwise."""
    x, y = np.vstack([chain.xy_m, chain.xy_m[:1]]).T
    return float(np.diff(np.unwrap(np.arctan2(y, x))).sum() / (2 * np.pi))


@settings(max_examples=30, deadline=None)
@given(st.integers(12, 30), st.integers(14, 40), st.floats(0, 1), st.integers(0, 10**6))
def test_a_ring_lane_is_one_loop_in_its_middle(
    inner: int, outer: int, phase: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    left = rng.permutation(ring(8.0, inner))
    right = rng.permutation(ring(11.5, outer, phase))
    chain = only_chain(left, right)
    assert chain.closed
    assert turns(chain) == pytest.approx(1.0)
    np.testing.assert_allclose(np.hypot(*chain.xy_m.T), 9.75, atol=0.6)


def test_swapped_colours_drive_the_other_way() -> None:
    chain = only_chain(ring(11.5, 24), ring(8.0, 16))
    assert turns(chain) == pytest.approx(-1.0)


def test_a_straight_lane_is_an_open_chain_with_blue_on_the_left() -> None:
    x = np.arange(0.0, 50.0, 5.0)
    left = np.column_stack([x, np.full_like(x, 1.5)])
    right = np.column_stack([x, np.full_like(x, -1.5)])
    chain = only_chain(left, right)
    assert not chain.closed
    np.testing.assert_allclose(chain.xy_m[:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(chain.xy_m[[0, -1], 0], [0.0, 45.0], atol=0.5)
    assert (np.diff(chain.xy_m[:, 0]) > 0).all()
    assert chain.width_m.max() < 3.2


def test_fences_keep_two_near_legs_apart() -> None:
    """A thin island, 2 m wide with a cone every 5 m, between two legs."""
    x = np.arange(0.0, 60.0, 5.0)
    cap = ring(4.5, 16)
    island = np.vstack([np.column_stack([x, np.full_like(x, y)]) for y in (1.0, -1.0)])
    ends = [cap[cap[:, 0] < -0.1], cap[cap[:, 0] > 0.1] + (55.0, 0.0)]
    outside = np.vstack(
        [np.column_stack([x, np.full_like(x, y)]) for y in (4.5, -4.5)] + ends
    )
    chain = only_chain(island, outside)
    assert chain.closed
    beside = np.abs(chain.xy_m[(chain.xy_m[:, 0] > 2) & (chain.xy_m[:, 0] < 53), 1])
    np.testing.assert_allclose(beside, 2.75, atol=0.3)


def test_of_crossing_fences_the_shorter_stays() -> None:
    long = np.array([[-3.0, 0.0], [3.0, 0.0]])
    short = np.array([[0.0, -2.0], [0.0, 2.0]])
    kept, dropped = neighbour_walls(short, long)
    assert (len(kept), len(dropped)) == (1, 0)
    dropped, kept = neighbour_walls(long, short)
    assert (len(kept), len(dropped)) == (1, 0)


def test_a_listed_wall_closes_and_skips_leaps() -> None:
    listed = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 40.0], [5.0, 45.0]])
    assert len(ordered_wall(listed, closed=False)) == 2
    assert len(ordered_wall(ring(10.0, 12), closed=True)) == 12


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_cones_make_no_chain(count: int) -> None:
    left, right = ring(8.0, 12), ring(11.5, count)
    assert contours(left, right, neighbour_walls(left, right)) == []


def test_cones_on_one_line_make_no_chain() -> None:
    x = np.arange(10.0)
    line = np.column_stack([x, 2 * x])
    assert (
        contours(line, line + np.array([20.0, 40.0]), neighbour_walls(line, line[:0]))
        == []
    )
