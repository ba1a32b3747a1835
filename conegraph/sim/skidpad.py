"""The skidpad of the Formula Student rules: its geometry, and how to spot one.

Two pairs of circles touch at the middle of the timing line. The car comes in
along the line between them, drives the right circle twice, the left one twice,
and leaves straight on. Colours do not mean left and right of a single lane here,
so the path is scripted.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from conegraph.types import Array, ConeClass, TrackLayout

CENTRES_APART_M = 18.25
INNER_RADIUS_M = 15.25 / 2
OUTER_RADIUS_M = 21.25 / 2
ENTRY_M = 15.0
"""How far before the timing line a driverless car waits."""
_RADIUS_SLACK_M = 0.4
_LEAST_INNER = 10
_LEAST_BESIDE = 0.8
"""Share of blue and yellow cones that stand on the circles: lobes of other courses
can pass for one circle, but not all of their cones for four."""


def skidpad_path(
    entry_m: float, exit_m: float, radius_m: float, step_m: float
) -> Array:
    """Return the scripted path (K, 2): crossing at the origin, heading along x.

    Args:
        entry_m: straight before the timing line.
        exit_m: straight after it.
        radius_m: radius driven in either circle.
        step_m: distance between points.
    """
    turn = np.linspace(0.0, 4 * np.pi, round(4 * np.pi * radius_m / step_m) + 1)[1:]
    circle = radius_m * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    come = np.arange(-entry_m, 1e-9, step_m)
    leave = np.arange(step_m, exit_m + 1e-9, step_m)
    straight = [np.column_stack([x, np.zeros_like(x)]) for x in (come, leave)]
    return np.vstack([straight[0], circle * (1, -1), circle, straight[1]])


def recognise_skidpad(
    layout: TrackLayout, exit_m: float, step_m: float
) -> Array | None:
    """Return the scripted path through a layout that is a skidpad, else None.

    With a start pose the car comes from there; without one it comes from 15 m before
    the timing line, from where the circle with yellow inner cones is the right one.
    """
    lane = np.isin(layout.cone_class, (ConeClass.BLUE, ConeClass.YELLOW))
    centres = _centres(layout.xy_m[lane]) if lane.sum() > 2 * _LEAST_INNER else None
    if centres is None:
        return None
    crossing, across = centres.mean(axis=0), centres[1] - centres[0]
    radius = 0.5 * float(np.hypot(*across))
    forward = np.array([-across[1], across[0]]) / (2 * radius)
    if layout.start_pose is not None:
        come = crossing - layout.start_pose[:2]
        forward = forward * np.sign(forward @ come)
        entry = max(float(forward @ come), step_m)
    else:
        forward = forward * _forward_sign(layout, centres)
        entry = ENTRY_M
    path = skidpad_path(entry, exit_m, radius, step_m)
    return np.asarray(path @ [forward, [-forward[1], forward[0]]] + crossing)


def _forward_sign(layout: TrackLayout, centres: Array) -> float:
    """+1 when the first centre, to the left of ``forward``, has blue inner cones."""
    away = np.linalg.norm(layout.xy_m - centres[:, None], axis=2)
    inner = np.abs(away - INNER_RADIUS_M) < _RADIUS_SLACK_M
    blue, yellow = (layout.cone_class == c for c in (ConeClass.BLUE, ConeClass.YELLOW))
    lead = (inner & blue).sum(axis=1) - (inner & yellow).sum(axis=1)
    return 1.0 if lead[0] >= lead[1] else -1.0


def _centres(xy_m: Array) -> Array | None:
    """Return the two centres (2, 2) if the cones stand on skidpad circles."""
    found = _vote(xy_m)
    for pair in combinations(found, 2):
        centres = np.array(pair)
        if abs(np.hypot(*(centres[0] - centres[1])) - CENTRES_APART_M) > 1.0:
            continue
        centres = np.array([_refine(xy_m, c) for c in centres])
        away = np.linalg.norm(xy_m - centres[:, None], axis=2)
        inner = np.abs(away - INNER_RADIUS_M) < _RADIUS_SLACK_M
        outer = np.abs(away - OUTER_RADIUS_M) < _RADIUS_SLACK_M
        beside = (inner | outer).any(axis=0).mean()
        if inner.sum(axis=1).min() >= _LEAST_INNER and beside >= _LEAST_BESIDE:
            return centres
    return None


def _vote(xy_m: Array) -> Array:
    """Return circle centres that many pairs of cones agree on (Hough); (M, 2).

    Two points on a circle of known radius leave two places for its centre.
    """
    pairs = cKDTree(xy_m).query_pairs(1.9 * INNER_RADIUS_M, output_type="ndarray")
    a, b = xy_m[pairs[:, 0]], xy_m[pairs[:, 1]]
    half = 0.5 * (b - a)
    length = np.hypot(*half.T)[:, None]
    rise = np.sqrt(INNER_RADIUS_M**2 - length**2) / length
    aside = np.column_stack([-half[:, 1], half[:, 0]]) * rise
    places = np.vstack([a + half + aside, a + half - aside])
    tree = cKDTree(places)
    votes = tree.query_ball_point(places, _RADIUS_SLACK_M, return_length=True)
    peaks: list[Array] = []
    for k in np.argsort(-votes, kind="stable"):
        if votes[k] < _LEAST_INNER or len(peaks) == 6:
            break
        if all(np.hypot(*(places[k] - p)) > 2.0 for p in peaks):
            peaks.append(places[k])
    return np.array(peaks).reshape(-1, 2)


def _refine(xy_m: Array, centre: Array) -> Array:
    """Return the centre of the circle of inner radius fitted to cones near it."""
    away = np.hypot(*(xy_m - centre).T)
    near = xy_m[np.abs(away - INNER_RADIUS_M) < 2 * _RADIUS_SLACK_M]

    def off(place: Array) -> Array:
        """How far each cone is off the circle around a place."""
        return np.asarray(np.hypot(*(near - place).T) - INNER_RADIUS_M)

    return np.asarray(least_squares(off, centre, loss="soft_l1").x)
