"""Planar lines against circles, whose length and curvature are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conegraph.sim import polyline
from conegraph.types import Array


def circle(radius_m: float, count: int, clockwise: bool = False) -> Array:
    turn = 2 * np.pi * np.arange(count) / count
    return radius_m * np.column_stack(
        [np.cos(turn), (-1 if clockwise else 1) * np.sin(turn)]
    )


@given(st.floats(2.0, 200.0), st.integers(8, 400), st.booleans())
def test_curvature_of_a_circle_is_the_turn_per_chord(
    radius_m: float, count: int, clockwise: bool
) -> None:
    step = np.pi / count
    expected = (-1 if clockwise else 1) * step / (radius_m * np.sin(step))
    kappa = polyline.curvature(circle(radius_m, count, clockwise), closed=True)
    np.testing.assert_allclose(kappa, expected, rtol=1e-6)


def test_curvature_of_an_open_line_has_a_value_at_every_point() -> None:
    line = circle(10.0, 100)[:50]
    kappa = polyline.curvature(line, closed=False)
    assert kappa.shape == (50,)
    np.testing.assert_allclose(kappa, 0.1, rtol=1e-3)


def test_resampling_keeps_to_the_polygon() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    line = polyline.resample(square, 0.5, closed=True)
    assert len(line) == 32
    np.testing.assert_allclose(
        np.hypot(*np.diff(polyline.ring(line, True), axis=0).T), 0.5
    )
    open_line = polyline.resample(square, 0.5, closed=False)
    assert len(open_line) == 25
    np.testing.assert_allclose(open_line[[0, -1]], square[[0, -1]])


def test_repeated_points_do_no_harm() -> None:
    line = np.array([[0.0, 0.0], [0.0, 0.0], [3.0, 4.0], [3.0, 4.0]])
    np.testing.assert_allclose(
        polyline.resample(line, 1.0, closed=False)[:, 1], np.arange(6) * 0.8
    )


@pytest.mark.parametrize("radius_m", [4.0, 9.125, 40.0])
def test_smoothing_moves_an_arc_as_twicing_predicts(radius_m: float) -> None:
    """A blur damps the circle to g = exp(-s^2 / 2 R^2), twicing to 1 - (1 - g)^2."""
    sigma = 1.5
    line = polyline.smooth(circle(radius_m, 400), sigma, 0.25, closed=True)
    damping = np.exp(-0.5 * (sigma / radius_m) ** 2)
    expected = radius_m * (1 - (1 - damping) ** 2)
    np.testing.assert_allclose(np.hypot(*line.T), expected, rtol=2e-3)


def test_smoothing_keeps_the_ends_and_the_spacing_of_an_open_line() -> None:
    corner = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0]])
    line = polyline.smooth(corner, 1.5, 0.25, closed=False)
    np.testing.assert_allclose(line[[0, -1]], corner[[0, -1]], atol=1e-6)
    steps = np.hypot(*np.diff(line, axis=0).T)
    np.testing.assert_allclose(steps, steps.mean(), rtol=5e-3)


def test_a_right_angle_is_rounded_as_twicing_predicts() -> None:
    """At the corner p' = (1, 1) / 2 and p'' = (-a, a), so the curvature is 2^1.5 a.

    A blurred ramp has the Gaussian for its second derivative, twicing twice that
    less the Gaussian of a sqrt(2) wider blur: a = (2 - 1/sqrt(2)) / (s sqrt(2 pi)).
    """
    corner = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0]])
    line = polyline.smooth(corner, 2.0, 0.1, closed=False)
    sharpest = polyline.curvature(line, closed=False).max()
    expected = 2**1.5 * (2 - 0.5**0.5) / (2.0 * np.sqrt(2 * np.pi))
    assert sharpest == pytest.approx(expected, rel=0.01)


@given(st.floats(0, 2 * np.pi), st.floats(-3.0, 3.0))
def test_projection_measures_across_the_line_left_positive(
    bearing: float, across_m: float
) -> None:
    line = circle(10.0, 1000)
    point = (10.0 - across_m) * np.array([[np.cos(bearing), np.sin(bearing)]])
    index, across = polyline.project(point, line, closed=True)
    np.testing.assert_allclose(across, across_m, atol=1e-3)
    away = np.angle(np.exp(1j * (2 * np.pi * index[0] / 1000 - bearing)))
    assert abs(away) <= np.pi / 1000 + 1e-9
