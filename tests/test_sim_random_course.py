"""Random courses: every generator state leads to one that keeps its promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.sim.polyline import arc_length, curvature, ring
from conegraph.sim.random_course import is_valid_center, random_center
from conegraph.types import Array


def loop(radius_m: float, squeeze: float = 1.0) -> Array:
    """Return an ellipse of points 0.5 m apart, near enough."""
    turn = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    dense = radius_m * np.column_stack([np.cos(turn), squeeze * np.sin(turn)])
    s = arc_length(ring(dense, closed=True))
    at = np.arange(0, s[-1], 0.5)[:-1]
    return dense[np.searchsorted(s, at) % len(dense)]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_random_course_keeps_its_length_radius_and_distance(seed: int) -> None:
    line = random_center(np.random.default_rng(seed))
    total = arc_length(ring(line, closed=True))[-1]
    assert 200.0 <= total <= 500.0
    assert 1 / np.abs(curvature(line, closed=True)).max() > 3.4
    apart = np.linalg.norm(line[:, None] - line[None], axis=2)
    steps = np.abs(np.subtract.outer(np.arange(len(line)), np.arange(len(line))))
    along = 0.5 * np.minimum(steps, len(line) - steps)
    assert apart[along > 10.0].min() > 5.9


def test_it_goes_round_once_either_way() -> None:
    turns = [
        curvature(random_center(np.random.default_rng(s)), closed=True).sum() * 0.5
        for s in range(20)
    ]
    np.testing.assert_allclose(np.abs(turns), 2 * np.pi, rtol=0.01)
    assert {float(np.sign(t)) for t in turns} == {-1.0, 1.0}


@pytest.mark.parametrize(
    ("line", "valid"),
    [
        (loop(50.0), True),
        (loop(30.0), False),
        (loop(82.0), False),
        (loop(80.0, squeeze=0.12), False),
        (loop(60.0, squeeze=0.5), True),
    ],
    ids=["fair", "too short", "too long", "too tight", "oval"],
)
def test_validity_is_about_length_radius_and_distance(line: Array, valid: bool) -> None:
    assert is_valid_center(line) is valid


def test_legs_that_come_near_are_invalid() -> None:
    """A peanut whose waist is 5 m wide, in gentle curves."""
    turn = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    reach = 30.0 + 27.5 * np.cos(2 * turn)
    dense = reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    s = arc_length(ring(dense, closed=True))
    line = dense[np.searchsorted(s, np.arange(0, s[-1], 0.5)[:-1]) % len(dense)]
    assert 200.0 < s[-1] < 500.0
    assert not is_valid_center(line)
