"""Whether a track that was found is the true one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from shapely import LinearRing, Polygon
from shapely.geometry.base import BaseGeometry

from conegraph.bench.track_truth import KnownTrack
from conegraph.sim.polyline import nearest
from conegraph.track import Track
from conegraph.track.shapes import road_polygon
from conegraph.types import Array, ConeClass, IntArray

_AHEAD_M = 10.0
_OFF_M = 1.0


def edges_right(track: Track, truth: KnownTrack) -> tuple[int, int]:
    """Return how many directed edges of the boundaries are true ones, and of how many.

    Gate cones stand beside the boundary as often as on it: one that is left out
    breaks no edge.
    """
    right = count = 0
    for chain, true in ((track.left, truth.left), (track.right, truth.right)):
        kept = _kept(truth, true, chain)
        following = dict(zip(kept.tolist(), np.roll(kept, -1).tolist(), strict=True))
        pairs = list(zip(chain.tolist(), np.roll(chain, -1).tolist(), strict=True))
        pairs = pairs if track.closed else pairs[:-1]
        count += len(pairs)
        right += sum(following.get(a) == b for a, b in pairs)
    return right, count


def _kept(truth: KnownTrack, true: IntArray, chain: IntArray) -> IntArray:
    """Return a true boundary without the gate cones that a found one leaves out."""
    gate = truth.cone_class[true] >= ConeClass.ORANGE
    return np.asarray(true[~gate | np.isin(true, chain)])


def without_gate(truth: KnownTrack, track: Track) -> KnownTrack:
    """Return the truth without the gate cones that a track leaves out."""
    left = _kept(truth, truth.left, track.left)
    return replace(truth, left=left, right=_kept(truth, truth.right, track.right))


def all_edges(track: Track, truth: KnownTrack) -> bool:
    """Return whether no cone of a true boundary is left out, gate cones excepted."""
    for chain, true in ((track.left, truth.left), (track.right, truth.right)):
        needed = true[truth.cone_class[true] <= ConeClass.YELLOW]
        if not np.isin(needed, chain).all():
            return False
    return track.closed == truth.closed


def road_iou(track: Track, truth: KnownTrack) -> float:
    """Return the overlap of the road with the true one: intersection over union."""
    true = _ring(truth.xy_m, truth.left, truth.right)
    road = road_polygon(track).buffer(0)
    return float(road.intersection(true).area / road.union(true).area)


def wrong_map(track: Track, truth: KnownTrack) -> str:
    """Return what is wrong with a map, "" if it is right.

    Right: closed, boundaries simple and not crossing, IoU with the unspoilt road
    above 0.9.
    """
    if not track.closed:
        return track.reason or "open"
    left, right = LinearRing(track.left_m), LinearRing(track.right_m)
    if not (left.is_simple and right.is_simple):
        return "boundary crosses itself"
    if left.intersects(right):
        return "boundaries cross"
    iou = road_iou(track, truth)
    return "" if iou > 0.9 else f"IoU {iou:.2f}"


def ahead_right(track: Track, truth: KnownTrack, pose: Array) -> bool:
    """Return whether the line runs 10 m ahead of a car, within 1 m of the true one."""
    line = track.centerline.xy_m
    if len(line) < 3:
        return False
    away = np.hypot(*(line - pose[:2]).T)
    if track.closed:
        line = np.roll(line, -int(np.argmin(away)), axis=0)
    else:
        line = line[int(np.argmin(away)) :]
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    s += float(np.hypot(*(line[0] - pose[:2])))
    first = line[s <= _AHEAD_M]
    if s[-1] < _AHEAD_M or len(first) < 3:
        return False
    way = first[-1] - pose[:2]
    forward = way @ (np.cos(pose[2]), np.sin(pose[2])) > -_AHEAD_M / 2
    return bool(forward and off_line_m(first, truth).max() < _OFF_M)


def off_line_m(xy: Array, truth: KnownTrack) -> Array:
    """Return how far points are off the true line, across it."""
    line = truth.line_m
    _, index = nearest(xy, line)
    forward = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    forward /= np.hypot(*forward.T)[:, None]
    off = xy - line[index]
    t = forward[index]
    return np.asarray(np.abs(t[:, 0] * off[:, 1] - t[:, 1] * off[:, 0]))


def _ring(xy: Array, left: IntArray, right: IntArray) -> BaseGeometry:
    a, b = (Polygon(xy[side]).buffer(0) for side in (left, right))
    return a.difference(b) if a.area > b.area else b.difference(a)
