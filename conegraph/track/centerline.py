"""The middle of the road: smooth, evenly spaced, with widths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conegraph.geometry import wrap_angle
from conegraph.track.model import CenterLine
from conegraph.track.nearest import Nearest
from conegraph.track.plane import Points, coordinates, points, turn
from conegraph.types import Array, IntArray

SPACING_M = 0.5
"""Distance between points of the centre line."""
_CURVE_M = 0.25
_SMOOTH = 0.8 / SPACING_M
"""Sigma of the blur in points, cut off after four of them."""
_REACH = round(4 * _SMOOTH)
_WEIGHTS = np.exp(-0.5 * (np.arange(-_REACH, _REACH + 1) / _SMOOTH) ** 2)
_WEIGHTS /= _WEIGHTS.sum()
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
    cone = points(xy_m)
    curves = [
        Nearest(coordinates(_curve(cone[chain], closed))) for chain in (left, right)
    ]
    middles = 0.5 * (cone[triangles[:, 0]] + cone[triangles[:, 1]])
    if not closed:
        middles = np.append(middles, 0.5 * (cone[left[-1]] + cone[right[-1]]))
        if start_m is not None:
            middles = _from(complex(*start_m), middles)
    line = _evenly(middles, closed)
    for _ in range(2):
        if len(line) < 3:
            return CenterLine.empty()
        left_m, right_m = _reaches(line, curves, closed, lane_m)
        line = line + 0.5 * (left_m - right_m) * _normals(line, closed)
        line = _evenly(_calmed(line, closed), closed)
    if len(line) < 3:
        return CenterLine.empty()
    return _described(line, closed, *_reaches(line, curves, closed, lane_m))


def offset_line(chain_m: Array, across_m: float) -> CenterLine:
    """Return the line beside one open boundary (K, 2), at a distance to its left.

    The other boundary is taken to be as far on the other side.
    """
    side = _evenly(_curve(points(chain_m), closed=False), closed=False)
    if len(side) < 3:
        return CenterLine.empty()
    line = _calmed(side + across_m * _normals(side, closed=False), closed=False)
    half = np.full(len(line), abs(across_m))
    return _described(line, False, half, half)


def _reaches(
    line: Points, curves: Sequence[Nearest], closed: bool, lane_m: float
) -> tuple[Array, Array]:
    """Return the distances to both curves; beyond a curve's end what the lane leaves.

    Beyond both ends the line runs on as it does.
    """
    (left, at_left), (right, at_right) = (
        curve.one(coordinates(line)) for curve in curves
    )
    if closed:
        return left, right
    past_left, past_right = (
        (at == 0) | (at == len(curve) - 1)
        for at, curve in zip((at_left, at_right), curves, strict=True)
    )
    half = 0.5 * lane_m
    by_right = np.maximum(lane_m - right, 0.0)
    by_left = np.maximum(lane_m - left, 0.0)
    new_left = np.where(past_left, np.where(past_right, half, by_right), left)
    new_right = np.where(past_right, np.where(past_left, half, by_left), right)
    return new_left, new_right


def _from(start: complex, middles: Points) -> Points:
    """Return an open line that begins at the start, unless it begins well before."""
    away = np.abs(middles - start)
    at = int(np.argmin(away))
    if at > 1:
        return middles
    return np.append(start, middles[at + int(away[at] < 1.0) :])


def _curve(corner: Points, closed: bool) -> Points:
    """Return the Catmull-Rom curve through corners, sampled every 0.25 m or so.

    Tangents are those of the parabola through three neighbours over chord length.
    """
    if len(corner) < 3:
        return _evenly(corner, False, _CURVE_M)
    ring = np.concatenate([corner[-1:], corner, corner[:2]]) if closed else corner
    step = ring[1:] - ring[:-1]
    h = np.maximum(np.abs(step), 1e-6)
    slope = step / h
    tangent = (slope[:-1] * h[1:] + slope[1:] * h[:-1]) / (h[:-1] + h[1:])
    if closed:
        ring, step, h = ring[1:-1], step[1:-1], h[1:-1]
    else:
        first, last = 1.5 * slope[[0, -1]] - 0.5 * tangent[[0, -1]]
        tangent = np.concatenate([[first], tangent, [last]])
    # Each piece is p + m t + b t^2 + a t^3, t from 0 to 1.
    p, m, n = ring[:-1], tangent[:-1] * h, tangent[1:] * h
    a, b = m + n - 2.0 * step, 3.0 * step - 2.0 * m - n
    count = np.ceil(h / _CURVE_M).astype(np.int64)
    piece = np.repeat(np.arange(len(h)), count)
    rank = np.arange(len(piece)) - (np.cumsum(count) - count)[piece]
    t = rank / count[piece]
    curve = ((a[piece] * t + b[piece]) * t + m[piece]) * t + p[piece]
    return curve if closed else np.append(curve, corner[-1])


def _evenly(corner: Points, closed: bool, spacing_m: float = SPACING_M) -> Points:
    """Return points evenly spaced on the segments between corners."""
    ring = np.append(corner, corner[0]) if closed else corner
    s = np.append(0.0, np.abs(ring[1:] - ring[:-1]).cumsum())
    if s[-1] < _SHORTEST_M:
        return corner[:1]
    count = max(round(s[-1] / spacing_m), 4)
    grid = np.arange(count + (not closed)) * (s[-1] / count)
    return np.asarray(np.interp(grid, s, ring))


def _calmed(line: Points, closed: bool) -> Points:
    """Return the line without kinks; blurred twice, so that corners are not cut."""
    blurred = _blur(line, closed)
    return blurred + _blur(line - blurred, closed)


def _blur(line: Points, closed: bool) -> Points:
    """Return the line under a Gaussian; an open one goes on as it came, turned over."""
    if closed:
        longer = line[np.arange(-_REACH, len(line) + _REACH) % len(line)]
        return np.convolve(longer, _WEIGHTS, mode="valid")
    pad = min(_REACH, len(line) - 1)
    before, after = (
        2 * line[0] - line[pad:0:-1],
        2 * line[-1] - line[-2 : -pad - 2 : -1],
    )
    longer = np.concatenate([before, line, after])
    if pad < _REACH:
        longer = np.pad(longer, _REACH - pad, mode="symmetric")
    return np.convolve(longer, _WEIGHTS, mode="valid")


def _steps(line: Points, closed: bool) -> tuple[Points, Points]:
    """Return the segments before and after each point; at an end there is but one."""
    step = line[1:] - line[:-1]
    joint = line[:1] - line[-1:]
    first, last = (joint, joint) if closed else (step[:1], step[-1:])
    return np.concatenate([first, step]), np.concatenate([step, last])


def _normals(line: Points, closed: bool) -> Points:
    """Return unit normals to the left; (K,)."""
    before, after = _steps(line, closed)
    forward = before + after
    return np.asarray(1j * forward / np.maximum(np.abs(forward), 1e-9))


def _described(line: Points, closed: bool, left_m: Array, right_m: Array) -> CenterLine:
    """Return the line with arc length, heading and curvature at each point."""
    before, after = _steps(line, closed)
    length = np.abs(after)
    s = np.append(0.0, np.cumsum(length[:-1]))
    heading = wrap_angle(np.angle(before + after))
    arc = np.maximum(0.5 * (np.abs(before) + length), 1e-9)
    bend = turn(before, after) / arc
    return CenterLine(s, coordinates(line), heading, bend, left_m, right_m)
