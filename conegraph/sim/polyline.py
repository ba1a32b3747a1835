"""Planar lines as arrays of points: arc length, resampling, smoothing, sides.

A closed line is stored without repeating its first point. Lines are (K, 2) in
metres; nothing here knows about cones or cars.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from conegraph.types import Array, IntArray


def ring(xy_m: Array, closed: bool) -> Array:
    """Return the points, with the first repeated at the end when closed."""
    return np.vstack([xy_m, xy_m[:1]]) if closed else np.asarray(xy_m)


def arc_length(xy_m: Array) -> Array:
    """Return the distance along an open line at each of its points; shape (K,)."""
    steps = np.hypot(*np.diff(xy_m, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _knots(xy_m: Array, closed: bool) -> tuple[Array, Array]:
    """Return strictly increasing arc lengths and their points, ring included."""
    points = ring(xy_m, closed)
    moved = np.hypot(*np.diff(points, axis=0).T) > 1e-9
    points = points[np.concatenate([[True], moved])]
    return arc_length(points), points


def _even(length_m: float, spacing_m: float, closed: bool) -> Array:
    """Return evenly spaced arc lengths, about the given distance apart."""
    steps = max(round(length_m / spacing_m), 4)
    return np.linspace(0.0, length_m, steps + (not closed), endpoint=not closed)


def resample(xy_m: Array, spacing_m: float, closed: bool) -> Array:
    """Return points evenly spaced on the straight segments between the points."""
    s, points = _knots(xy_m, closed)
    grid = _even(s[-1], spacing_m, closed)
    return np.column_stack([np.interp(grid, s, points[:, k]) for k in (0, 1)])


def spline(xy_m: Array, spacing_m: float, closed: bool) -> Array:
    """Return points evenly spaced on the cubic spline through the points."""
    s, points = _knots(xy_m, closed)
    curve = CubicSpline(s, points, bc_type="periodic" if closed else "natural")
    dense = np.asarray(curve(_even(s[-1], spacing_m / 4, closed)))
    s, points = _knots(dense, closed)
    curve = CubicSpline(s, points, bc_type="periodic" if closed else "natural")
    return np.asarray(curve(_even(s[-1], spacing_m, closed)))


def blur(xy_m: Array, sigma: float, closed: bool) -> Array:
    """Return evenly spaced points blurred by a Gaussian of ``sigma`` steps.

    An arc of curvature k moves inwards by k sigma^2 / 2; the ends of an open line
    stay where they are.
    """
    if closed:
        return np.asarray(gaussian_filter1d(xy_m, sigma, axis=0, mode="wrap"))
    pad = min(int(4 * sigma) + 1, len(xy_m) - 1)
    long = np.pad(xy_m, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(long, sigma, axis=0))[pad:-pad]


def smooth(xy_m: Array, sigma_m: float, spacing_m: float, closed: bool) -> Array:
    """Return an evenly spaced line without kinks, close to the given points.

    Blurring what a blur has taken away and adding it back (Tukey's twicing) undoes
    most of the pull inwards, so that corners are rounded and not cut.
    """
    line = resample(xy_m, spacing_m, closed)
    sigma = sigma_m / spacing_m
    once = blur(line, sigma, closed)
    return spline(once + blur(line - once, sigma, closed), spacing_m, closed)


def tangent(xy_m: Array, closed: bool) -> Array:
    """Return unit tangents by central differences; shape (K, 2)."""
    if closed:
        step = np.roll(xy_m, -1, axis=0) - np.roll(xy_m, 1, axis=0)
    else:
        step = np.gradient(xy_m, axis=0)
    return np.asarray(step / np.hypot(*step.T)[:, None])


def normal(xy_m: Array, closed: bool) -> Array:
    """Return unit normals to the left of the direction of travel; shape (K, 2)."""
    forward = tangent(xy_m, closed)
    return np.column_stack([-forward[:, 1], forward[:, 0]])


def curvature(xy_m: Array, closed: bool) -> Array:
    """Return the signed curvature in 1/m, left turns positive; shape (K,).

    The turn of the tangent per arc length over two neighbouring segments.
    """
    wrapped = np.vstack([xy_m[-1:], ring(xy_m, True)]) if closed else xy_m
    step = np.diff(wrapped, axis=0)
    length = np.hypot(*step.T)
    a, b = step[:-1], step[1:]
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    kappa = turn / (0.5 * (length[:-1] + length[1:]))
    return kappa if closed else np.pad(kappa, 1, mode="edge")


def nearest(xy_m: Array, line_m: Array) -> tuple[Array, IntArray]:
    """Return the distance (N,) to the nearest point of a line, and its index (N,)."""
    away, index = cKDTree(line_m).query(xy_m)
    return np.asarray(away), np.asarray(index, dtype=np.int64)


def project(xy_m: Array, line_m: Array, closed: bool) -> tuple[IntArray, Array]:
    """Find each point's nearest point of a densely sampled line.

    Args:
        xy_m: (N, 2) points.
        line_m: (K, 2) line.
        closed: whether the line is a loop.

    Returns:
        (N,) index into the line and (N,) signed distance across it, left positive.
    """
    _, index = nearest(xy_m, line_m)
    across = ((xy_m - line_m[index]) * normal(line_m, closed)[index]).sum(axis=1)
    return index, across
