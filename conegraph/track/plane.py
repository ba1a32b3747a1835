"""Points and steps of the plane as complex numbers x + iy.

A step's length is its absolute value, 1j times a step is a quarter turn to its left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array, IntArray

Points = NDArray[np.complex128]


def points(xy: Array) -> Points:
    """Return points (N,) from their coordinates (N, 2)."""
    return np.asarray(xy[:, 0] + 1j * xy[:, 1])


def coordinates(points: Points) -> Array:
    """Return coordinates (N, 2) of points (N,)."""
    return points.view(np.float64).reshape(-1, 2)


def outer(a: Points, b: Points) -> Array:
    """Return a x b, positive where b turns left from a."""
    return np.asarray(a.real * b.imag - a.imag * b.real)


def inner(a: Points, b: Points) -> Array:
    """Return a . b, positive where b goes a's way."""
    return np.asarray(a.real * b.real + a.imag * b.imag)


def turn(a: Points, b: Points) -> Array:
    """Return by how many rad b turns left from a."""
    return np.arctan2(outer(a, b), inner(a, b))


def median(values: Array) -> float:
    """Return the median; `np.median` takes ten times as long on a dozen values."""
    rising = np.sort(values)
    return float(0.5 * (rising[(len(rising) - 1) // 2] + rising[len(rising) // 2]))


def distinct(values: IntArray) -> IntArray:
    """Return the values rising, each once; for few of them faster than `np.unique`."""
    rising = np.sort(values)
    fresh = np.append(True, rising[1:] != rising[:-1])
    return np.asarray(rising[fresh[: len(rising)]])
