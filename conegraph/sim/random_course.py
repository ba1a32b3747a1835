"""Random closed courses that keep to the Formula Student rules."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from conegraph.sim.polyline import arc_length, blur, curvature, resample, ring, spline
from conegraph.types import Array

_LENGTH_M = (210.0, 490.0)
_PITCH_M = (14.0, 21.0)
_ROUNDING = (0.3, 0.45)
"""Sigma of the blur that rounds corners, in grid steps of the outline."""
_KEPT = 0.86
"""Share of its length that the outline keeps when its corners are rounded."""
_LEAST_RADIUS_M = 3.5
_LEGS_APART_M = 6.0
_STEP_M = 0.5
_WAVES, _WAVE_M, _SWING_M = 6, (70.0, 160.0), 14.0
_CALM = 0.97


def random_center(rng: np.random.Generator) -> Array:
    """Return the middle (K, 2) of a random closed course, 200 to 500 m long.

    The outline of a random tree on a square grid is a loop that never crosses
    itself and keeps its legs apart. Its corners are rounded and the plane is warped
    by random waves. A course that turns tighter than a radius of 4.75 m (with a lane
    of 3.5 m an outer hairpin diameter of 13 m; the rules ask for 9), or whose legs
    come nearer than 6 m, is drawn again with smaller waves: without any it is valid,
    so every generator state leads to a course.
    """
    swing = _SWING_M
    while True:
        line = _draw(rng, swing)
        if is_valid_center(line):
            return line
        swing *= _CALM


def is_valid_center(line_m: Array) -> bool:
    """Return whether a loop of points 0.5 m apart is wide in corners and between legs.

    Points nearer than the clearance must be near along the line too: on the
    tightest arc that the clearance allows, a half circle, by pi / 2 times as much.
    """
    if np.abs(curvature(line_m, closed=True)).max() > 1 / _LEAST_RADIUS_M:
        return False
    length = len(line_m) * _STEP_M
    pairs = cKDTree(line_m).query_pairs(_LEGS_APART_M, output_type="ndarray")
    along = np.abs(pairs[:, 0] - pairs[:, 1]) * _STEP_M
    along = np.minimum(along, length - along)
    apart = bool(along.max(initial=0.0) < 0.5 * np.pi * _LEGS_APART_M)
    return apart and 200.0 <= length <= 500.0


def _draw(rng: np.random.Generator, swing_m: float) -> Array:
    length = rng.uniform(*_LENGTH_M)
    nodes = max(round(length / (4 * _KEPT * rng.uniform(*_PITCH_M))), 3)
    pitch = length / (4 * _KEPT * nodes)
    rounding = pitch * rng.uniform(*_ROUNDING)
    outline = resample(pitch * _tree_outline(rng, nodes), _STEP_M, closed=True)
    outline = _warped(rng, outline, swing_m) * (1.0, rng.choice((-1.0, 1.0)))
    line = blur(outline, rounding / _STEP_M, closed=True)
    scale = length / arc_length(ring(line, closed=True))[-1]
    return spline(scale * line, _STEP_M, closed=True)


def _tree_outline(rng: np.random.Generator, nodes: int) -> Array:
    """Return the corners (4 * nodes, 2) of the outline of a random grid tree.

    Nodes are 2 apart and the outline runs at 1/2 from them, so that its corners are
    1 apart. The walk goes counter-clockwise around a node, from the corner behind one
    way to the next, and wherever a branch leaves it goes around that branch first.
    """
    tree: dict[complex, set[complex]] = {0j: set()}
    while len(tree) < nodes:
        node = list(tree)[int(rng.integers(len(tree)))]
        way = 1j ** int(rng.integers(4))
        if node + way not in tree:
            tree[node + way] = {-way}
            tree[node].add(way)
    corners, node, way = [], 0j, 1 + 0j
    for _ in range(4 * nodes):
        corners.append(2 * node + 0.5 * way * (1 + 1j))
        way *= 1j
        if way in tree[node]:
            node, way = node + way, -way
    return np.array([[c.real, c.imag] for c in corners])


def _warped(rng: np.random.Generator, xy: Array, swing_m: float) -> Array:
    """Return the points moved by plane waves of random length, bearing and phase."""
    number = 2 * np.pi / rng.uniform(*_WAVE_M, _WAVES)
    bearing, phase, side = rng.uniform(0, 2 * np.pi, (3, _WAVES))
    wave = np.column_stack([number * np.cos(bearing), number * np.sin(bearing)])
    push = np.column_stack([np.cos(side), np.sin(side)]) / np.sqrt(_WAVES)
    moved: Array = xy + swing_m * np.sin(xy @ wave.T + phase) @ push
    return moved
