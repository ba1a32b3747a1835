"""The line a careful driver follows along a track, found from its cones."""

from __future__ import annotations

import numpy as np

from conegraph.errors import SourceError
from conegraph.sim.lane_contour import (
    Chain,
    contours,
    neighbour_walls,
    ordered_wall,
)
from conegraph.sim.polyline import (
    arc_length,
    nearest,
    project,
    resample,
    smooth,
    tangent,
)
from conegraph.sim.skidpad import recognise_skidpad
from conegraph.types import Array, ConeClass, TrackLayout

SPACING_M = 0.25
_SMOOTH_M = 1.5
_EXIT_M = 15.0
_JOIN_M = 10.0
"""A centre line whose ends are this near, or nearer, is a loop."""
_LANE_M = (0.7, 4.5)
"""How far from the middle the orange cones of a lane stand, least and most."""
_RUN_OUT_M = 150.0
_LEAD_IN_M = 25.0
_STOP_M = 4.0
_SHORTEST_M = 10.0
_LEAST_ALONG = 0.6
_END_POINTS = 20
_MOST_CONES = 3000
"""The search compares every two cones of a colour; courses have a few hundred."""
_ORANGE = (ConeClass.ORANGE, ConeClass.BIG_ORANGE)
_NO_WALL = np.zeros((0, 2, 2))


def driving_line(layout: TrackLayout) -> Array:
    """Return the line to drive, evenly spaced by about 0.25 m and without kinks.

    It is the layout's own centre line where there is one, the scripted path of a
    skidpad, and otherwise the contour between blue cones on the left and yellow
    ones on the right; orange cones join the side they stand on. It starts beside
    the start pose, without one between the big orange cones, without those beside
    the first blue cone. A start pose that looks backwards turns it around.

    Args:
        layout: the track.

    Returns:
        (K, 2) points in the track's frame; `closes` says whether it is a loop.

    Raises:
        SourceError: no lane can be made out.
    """
    if layout.centerline_m is not None and len(layout.centerline_m) >= 2:
        line = layout.centerline_m
        closed = layout.closed and _gap(line) <= _JOIN_M
    elif (path := recognise_skidpad(layout, _EXIT_M, SPACING_M)) is not None:
        line, closed = path, False
    else:
        line, closed = _lane(layout)
    line = _from_start(layout, resample(line, SPACING_M, closed), closed)
    if not closed:
        line = _before_wall(layout, line)
    return smooth(line, _SMOOTH_M, SPACING_M, closed)


def closes(line_m: Array) -> bool:
    """Return whether a driving line is a loop: its ends are one step apart."""
    return _gap(line_m) < 2 * SPACING_M


def start_line_at(layout: TrackLayout, line_m: Array) -> float:
    """Return how far along the line the start gate of big orange cones stands.

    Layouts without one are taken to have it 6 m ahead, where the rules put it.
    """
    gate = layout.xy_m[layout.cone_class == ConeClass.BIG_ORANGE]
    ahead = line_m[: round(25.0 / SPACING_M)]
    away, index = nearest(gate, ahead)
    index = index[away < _LANE_M[1]]
    return float(arc_length(ahead)[index].mean()) if len(index) else 6.0


def _gap(line: Array) -> float:
    return float(np.hypot(*(line[0] - line[-1])))


def _lane(layout: TrackLayout) -> tuple[Array, bool]:
    """Return the contour of a layout's lane and whether it is a loop."""
    left, right, orange = (
        layout.xy_m[np.isin(layout.cone_class, classes)]
        for classes in (ConeClass.BLUE, ConeClass.YELLOW, _ORANGE)
    )
    if len(layout) > _MOST_CONES:
        raise SourceError(
            f"track {layout.name}: {len(layout)} cones, more than {_MOST_CONES}"
        )
    listed = [
        ordered_wall(points, layout.closed) if layout.in_driving_order else _NO_WALL
        for points in (left, right)
    ]
    chain = _chain(layout, left, right, listed)
    side = _side(orange, chain)
    left = np.vstack([left, orange[side > 0]])
    right = np.vstack([right, orange[side < 0]])
    chain = _chain(layout, left, right, listed)
    away, _ = nearest(np.vstack([left, right]), chain.xy_m)
    along = float((away < 1.5 * np.median(chain.width_m)).mean())
    if along < _LEAST_ALONG:
        raise SourceError(
            f"track {layout.name}: no single lane between blue cones on the left and "
            f"yellow ones on the right; the longest has {along:.0%} of them beside it"
        )
    return chain.xy_m, chain.closed or (layout.closed and _gap(chain.xy_m) <= _JOIN_M)


def _chain(
    layout: TrackLayout, left: Array, right: Array, listed: list[Array]
) -> Chain:
    """Return the contour to drive: of the long ones that nearest to the start."""
    near = neighbour_walls(left, right)
    walls = [np.concatenate(pair) for pair in zip(near, listed, strict=True)]
    chains = contours(left, right, (walls[0], walls[1]))
    loops = [c for c in chains if c.closed and c.length_m > _SHORTEST_M]
    chains = loops if loops and layout.closed else chains
    longest = max((c.length_m for c in chains), default=0.0)
    if longest < _SHORTEST_M:
        raise SourceError(
            f"track {layout.name}: no lane between its {len(left)} cones on the left "
            f"and {len(right)} on the right"
        )
    chains = [c for c in chains if c.length_m > 0.5 * longest]
    if layout.start_pose is None:
        return max(chains, key=lambda c: c.length_m)
    start = layout.start_pose[:2]
    return min(chains, key=lambda c: float(np.hypot(*(c.xy_m - start).T).min()))


def _side(orange: Array, chain: Chain) -> Array:
    """Return +1 for orange cones left of the lane, -1 right of it, 0 elsewhere.

    An open lane is taken to run straight on: braking zones are orange only.
    """
    line = smooth(chain.xy_m, _SMOOTH_M, SPACING_M, chain.closed)
    if not chain.closed:
        reach = np.arange(SPACING_M, _RUN_OUT_M, SPACING_M)[:, None]
        back, ahead = line[0] - line[_END_POINTS], line[-1] - line[-_END_POINTS]
        before = line[0] + reach[::-1] * back / np.hypot(*back)
        beyond = line[-1] + reach * ahead / np.hypot(*ahead)
        line = np.vstack([before, line, beyond])
    _, across = project(orange, line, chain.closed)
    beside = (np.abs(across) > _LANE_M[0]) & (np.abs(across) < _LANE_M[1])
    return np.asarray(np.sign(across) * beside)


def _from_start(layout: TrackLayout, line: Array, closed: bool) -> Array:
    """Return the line from the start on, in the direction in which the car looks."""
    if layout.start_pose is None:
        return np.roll(line, -_first(layout, line), axis=0) if closed else line
    start, yaw = layout.start_pose[:2], layout.start_pose[2]
    (index,), _ = project(start[None], line, closed)
    if tangent(line, closed)[index] @ (np.cos(yaw), np.sin(yaw)) < 0:
        line, index = line[::-1], len(line) - 1 - index
    if closed:
        return np.roll(line, -index, axis=0)
    behind = float(np.hypot(*(line[index] - start)))
    if index == 0 and SPACING_M < behind < _LEAD_IN_M:
        return resample(np.vstack([start, line]), SPACING_M, closed=False)
    return line[index:]


def _before_wall(layout: TrackLayout, line: Array) -> Array:
    """Return an open line up to a stop in front of cones that stand across it."""
    away, index = nearest(layout.xy_m, line)
    across = index[(away < _LANE_M[0]) & (index > len(line) // 2)]
    return line[: across.min() - round(_STOP_M / SPACING_M)] if len(across) else line


def _first(layout: TrackLayout, line: Array) -> int:
    """Return the index beside the start gate, or beside the first blue cone."""
    gate, blue = (
        layout.xy_m[layout.cone_class == c]
        for c in (ConeClass.BIG_ORANGE, ConeClass.BLUE)
    )
    away, _ = nearest(gate, line)
    gate = gate[away < _LANE_M[1]]
    place = gate.mean(axis=0) if len(gate) else blue[0] if len(blue) else line[0]
    return int(nearest(place[None], line)[1][0])
