"""The middle of the road: smooth, evenly spaced, with widths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from conegraph.geometry import wrap_angle
from conegraph.track.model import CenterLine
from conegraph.types import Array, IntArray

SPACING_M = 0.5
"""Distance between points of the centre line."""
_CURVE_M = 0.25
_SMOOTH_M = 0.8
_SHORTEST_M = 1.0


def center_line(
    xy_m: Array,
    left: IntArray,
    right: IntArray,
    triangles: IntArray,
    closed: bool,
    lane_m: float,
    start_m: Array | None = None,
) -> CenterLine:
    """Return the line as far from the left boundary as from the right one.

    Cones stand on curves, not on their chords: a line half-way between chords cuts
    every corner. So each boundary is a Catmull-Rom curve through its cones, the line
    starts half-way between what faces each other across the triangles, and each of
    its points moves across by half the difference of its distances to both curves.

    Args:
        xy_m: (N, 2) cones.
        left: (L,) left boundary as rows of ``xy_m``.
        right: (R,) right boundary.
        triangles: (T, 3) the road between them, in driving order.
        closed: whether the boundaries are loops.
        lane_m: usual width, where one boundary ends before the other.
        start_m: (2,) where an open line begins, if not between its first cones.
    """
    if len(triangles) == 0:
        return CenterLine.empty()
    sides = [_curve(xy_m[chain], closed) for chain in (left, right)]
    end = 0.5 * (xy_m[left[-1]] + xy_m[right[-1]])
    middles = _middles(xy_m, triangles, closed, end)
    if start_m is not None and not closed:
        middles = _from(start_m, middles)
    line = _evenly(middles, closed)
    if len(line) < 3:
        return CenterLine.empty()
    trees = [cKDTree(side) for side in sides]
    for _ in range(2):
        left_m, right_m = _reaches(line, trees, closed, lane_m)
        across = _normals(line, closed)
        line = line + 0.5 * (left_m - right_m)[:, None] * across
        line = _evenly(_calmed(line, closed), closed)
        if len(line) < 3:
            return CenterLine.empty()
    left_m, right_m = _reaches(line, trees, closed, lane_m)
    s, heading, bend = _shape(line, closed)
    return CenterLine(s, line, heading, bend, left_m, right_m)


def _reaches(
    line: Array, trees: Sequence[cKDTree], closed: bool, lane_m: float
) -> tuple[Array, Array]:
    """Return the distances to both curves; beyond a curve's end what the lane leaves.

    Beyond both ends the line runs on as it does.
    """
    (left, at_left), (right, at_right) = (tree.query(line) for tree in trees)
    if closed:
        return np.asarray(left), np.asarray(right)
    past_left, past_right = (
        (at == 0) | (at == tree.n - 1)
        for at, tree in zip((at_left, at_right), trees, strict=True)
    )
    half = 0.5 * lane_m
    by_right = np.maximum(lane_m - right, 0.0)
    by_left = np.maximum(lane_m - left, 0.0)
    new_left = np.where(past_left, np.where(past_right, half, by_right), left)
    new_right = np.where(past_right, np.where(past_left, half, by_left), right)
    return np.asarray(new_left), np.asarray(new_right)


def _from(start: Array, middles: Array) -> Array:
    """Return an open line that begins at the start, unless it begins well before."""
    away = np.hypot(*(middles - start).T)
    at = int(np.argmin(away))
    if at > 1:
        return middles
    return np.vstack([start, middles[at + (away[at] < 1.0) :]])


def offset_line(chain_m: Array, across_m: float) -> CenterLine:
    """Return the line beside one open boundary (K, 2), at a distance to its left.

    The other boundary is taken to be as far on the other side.
    """
    side = _evenly(_curve(chain_m, closed=False), closed=False)
    if len(side) < 3:
        return CenterLine.empty()
    line = _calmed(side + across_m * _normals(side, closed=False), closed=False)
    half = np.full(len(line), abs(across_m))
    s, heading, bend = _shape(line, closed=False)
    return CenterLine(s, line, heading, bend, half, half)


def _middles(xy: Array, triangles: IntArray, closed: bool, end_m: Array) -> Array:
    """Return the middles of the gates that the triangles cross, in order."""
    middle = 0.5 * (xy[triangles[:, 0]] + xy[triangles[:, 1]])
    if closed:
        return np.asarray(middle)
    return np.vstack([middle, end_m])


def _curve(points: Array, closed: bool) -> Array:
    """Return the Catmull-Rom curve through points, sampled every 0.25 m or so.

    Tangents are those of the parabola through three neighbours over chord length.
    """
    if len(points) < 3:
        return _evenly(points, False, _CURVE_M)
    ring = np.vstack([points[-1:], points, points[:2]]) if closed else points
    step = np.diff(ring, axis=0)
    h = np.maximum(np.hypot(*step.T), 1e-6)[:, None]
    slope = step / h
    inner = (slope[:-1] * h[1:] + slope[1:] * h[:-1]) / (h[:-1] + h[1:])
    if closed:
        tangent, h, start = inner, h[1:-1], ring[1:-1]
    else:
        ends = (1.5 * slope[0] - 0.5 * inner[0], 1.5 * slope[-1] - 0.5 * inner[-1])
        tangent, start = np.vstack([ends[0], inner, ends[1]]), ring
    count = np.ceil(h[:, 0] / _CURVE_M).astype(np.int64)
    piece = np.repeat(np.arange(len(h)), count)
    rank = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)
    t = (rank / count[piece])[:, None]
    p, q = start[piece], start[piece + 1]
    m, n = tangent[piece] * h[piece], tangent[piece + 1] * h[piece]
    curve = (
        (1 + 2 * t) * (1 - t) ** 2 * p
        + t * (1 - t) ** 2 * m
        + t**2 * (3 - 2 * t) * q
        + t**2 * (t - 1) * n
    )
    return curve if closed else np.vstack([curve, points[-1:]])


def _evenly(points: Array, closed: bool, spacing_m: float = SPACING_M) -> Array:
    """Return points evenly spaced on the segments between the points."""
    ring = np.vstack([points, points[:1]]) if closed else points
    step = np.hypot(*np.diff(ring, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(step)])
    if s[-1] < _SHORTEST_M:
        return points[:1]
    count = max(round(s[-1] / spacing_m), 4)
    grid = np.linspace(0.0, s[-1], count + (not closed), endpoint=not closed)
    return np.column_stack([np.interp(grid, s, ring[:, k]) for k in (0, 1)])


def _calmed(line: Array, closed: bool) -> Array:
    """Return the line without kinks; blurred twice, so that corners are not cut."""
    sigma = _SMOOTH_M / SPACING_M
    return _blur(line, sigma, closed) + _blur(
        line - _blur(line, sigma, closed), sigma, closed
    )


def _blur(line: Array, sigma: float, closed: bool) -> Array:
    if closed:
        return np.asarray(gaussian_filter1d(line, sigma, axis=0, mode="wrap"))
    pad = min(int(4 * sigma) + 1, len(line) - 1)
    longer = np.vstack(
        [2 * line[0] - line[pad:0:-1], line, 2 * line[-1] - line[-2 : -pad - 2 : -1]]
    )
    return np.asarray(gaussian_filter1d(longer, sigma, axis=0))[pad:-pad]


def _steps(line: Array, closed: bool) -> Array:
    """Return the segments after each point; an open line repeats its last."""
    if closed:
        return np.asarray(np.roll(line, -1, axis=0) - line)
    step = np.diff(line, axis=0)
    return np.vstack([step, step[-1:]])


def _normals(line: Array, closed: bool) -> Array:
    """Return unit normals to the left; (K, 2)."""
    step = _steps(line, closed)
    before = np.roll(step, 1, axis=0)
    if not closed:
        before[0] = step[0]
    forward = step + before
    forward /= np.maximum(np.hypot(*forward.T), 1e-9)[:, None]
    return np.column_stack([-forward[:, 1], forward[:, 0]])


def _shape(line: Array, closed: bool) -> tuple[Array, Array, Array]:
    """Return arc length, heading and curvature at each point; (K,) each."""
    step = _steps(line, closed)
    length = np.hypot(*step.T)
    s = np.concatenate([[0.0], np.cumsum(length[:-1])])
    normal = _normals(line, closed)
    heading = np.arctan2(-normal[:, 0], normal[:, 1])
    before = np.roll(step, 1, axis=0)
    if not closed:
        before[0] = step[0]
    turn = np.arctan2(
        before[:, 0] * step[:, 1] - before[:, 1] * step[:, 0],
        (before * step).sum(axis=1),
    )
    arc = 0.5 * (length + np.roll(length, 1))
    return s, np.asarray(wrap_angle(heading)), turn / np.maximum(arc, 1e-9)
