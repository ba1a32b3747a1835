"""Cones along a lane, set as the Formula Student rules ask.

Rules and competition handbook: at most 5 m between cones in driving direction and
less in corners, blue on the left, yellow on the right, big orange cones right
before and after a timing line, the car waiting 6 m before that line.
"""

from __future__ import annotations

import numpy as np

from conegraph.geometry import to_child
from conegraph.sim.polyline import arc_length, curvature, normal, ring, spline, tangent
from conegraph.types import Array, ConeClass, TrackLayout

START_BEFORE_LINE_M = 6.0
GATE_HALF_M = 0.3
_STRAIGHT_SPACING_M, _CORNER_SPACING_M = 4.5, 2.5
_STRAIGHT, _CORNER = 0.01, 0.12
"""Curvatures in 1/m up to which a lane counts as straight, from which as a corner."""
_STEP_M = 0.25


def closed_course(name: str, center_m: Array, half_width_m: float) -> TrackLayout:
    """Return a closed course: cones beside a loop, with its start on a straight.

    Args:
        name: the layout's name.
        center_m: (K, 2) smooth loop in driving direction.
        half_width_m: from the middle of the lane to either row of cones.

    Returns:
        The layout in the frame of the car at its start, so that the start pose is
        zero and the timing line crosses the lane 6 m along it. Cones come in driving
        order from the line on: blue, yellow, then the four big orange ones.
    """
    center = _from_straight(spline(center_m, _STEP_M, closed=True))
    start = np.array([*center[0], np.arctan2(*tangent(center, closed=True)[0][::-1])])
    center = to_child(start, center)
    gate = round(START_BEFORE_LINE_M / _STEP_M)
    blue, left_gate = _row(center, gate, half_width_m)
    yellow, right_gate = _row(center, gate, -half_width_m)
    return layout_of(
        name,
        {
            ConeClass.BLUE: blue,
            ConeClass.YELLOW: yellow,
            ConeClass.BIG_ORANGE: np.vstack([left_gate, right_gate]),
        },
        start_pose=np.zeros(3),
        closed=True,
        centerline_m=center,
    )


def layout_of(
    name: str,
    cones_m: dict[ConeClass, Array],
    *,
    start_pose: Array,
    closed: bool,
    centerline_m: Array,
    in_driving_order: bool = True,
) -> TrackLayout:
    """Return a layout of the given cones, (N, 2) for each class."""
    classes = [np.full(len(xy), int(c)) for c, xy in cones_m.items()]
    return TrackLayout(
        name,
        np.vstack(list(cones_m.values())),
        np.concatenate(classes).astype(np.int64),
        start_pose=start_pose,
        closed=closed,
        centerline_m=centerline_m,
        in_driving_order=in_driving_order,
    )


def _from_straight(center: Array) -> Array:
    """Return the loop from where the way to the timing line and beyond bends least."""
    window = round(3 * START_BEFORE_LINE_M / _STEP_M)
    bend = np.abs(curvature(center, closed=True))
    total = np.cumsum(np.concatenate([[0.0], bend, bend[:window]]))
    return np.roll(center, -int(np.argmin(total[window:-1] - total[: len(bend)])), 0)


def _row(center: Array, gate: int, offset_m: float) -> tuple[Array, Array]:
    """Return the cones of one side after the gate, and its two gate cones.

    Cones split the row into equal shares of length over the spacing wanted there.
    """
    row = np.roll(center + offset_m * normal(center, closed=True), -gate, axis=0)
    bend = np.abs(np.roll(curvature(center, closed=True), -gate))
    spacing = np.interp(
        bend, (_STRAIGHT, _CORNER), (_STRAIGHT_SPACING_M, _CORNER_SPACING_M)
    )
    points = ring(row, closed=True)
    s = arc_length(points)
    share = np.concatenate([[0.0], np.cumsum(np.diff(s) / spacing)])
    count = int(np.ceil(share[-1]))
    at = np.interp(np.linspace(0.0, share[-1], count, endpoint=False)[1:], share, s)
    posts = np.array([GATE_HALF_M, s[-1] - GATE_HALF_M])

    def place(where: Array) -> Array:
        return np.column_stack([np.interp(where, s, points[:, k]) for k in (0, 1)])

    return place(at), place(posts)
