"""Built-in tracks, by the geometry of the Formula Student rules."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from conegraph.errors import SourceError
from conegraph.sim.cone_rows import GATE_HALF_M, closed_course, layout_of
from conegraph.sim.polyline import spline
from conegraph.sim.random_course import random_center
from conegraph.sim.skidpad import (
    CENTRES_APART_M,
    ENTRY_M,
    INNER_RADIUS_M,
    OUTER_RADIUS_M,
    skidpad_path,
)
from conegraph.types import Array, ConeClass, TrackLayout

HALF_LANE_M = 1.75
_STEP_M = 0.25

_AUTOCROSS_M = (
    *((-12, 0), (0, 0), (14, 0), (28, 0), (42, 0), (56, 1)),
    *((70, 6), (78, 17), (78, 31), (70, 42), (57, 46)),
    *((46, 43), (35, 49), (24, 43), (13, 49), (2, 44)),
    *((-12, 46), (-23, 43), (-27, 36), (-22, 29.5), (-12, 29)),
    *((2, 31), (14, 31), (26, 31), (38, 31)),
    *((49, 30), (54, 23.5), (49, 17), (38, 16)),
    *((27, 16), (19, 17.5), (12, 21), (3, 21), (-4, 17.5), (-12, 16), (-24, 15.5)),
    *((-34, 12.5), (-36, 6), (-30, 1)),
)
"""Points of the autocross course, joined by a spline, a line for each part: start
straight, sweeper, slalom, hairpin, short straight, hairpin the other way, chicane,
last corner."""


def built_in_track(name: str, seed: int) -> TrackLayout:
    """Return a built-in track.

    Args:
        name: one of `BUILT_IN_TRACKS`.
        seed: makes the course of ``random``; the others are always the same.

    Returns:
        The layout with its centre line, in the frame of the car at its start.

    Raises:
        SourceError: no built-in track has this name; the text lists those there are.
    """
    make = _TRACKS.get(name)
    if make is None:
        names = ", ".join(BUILT_IN_TRACKS)
        raise SourceError(f"no built-in track {name!r}; there are: {names}")
    return make(np.random.default_rng(seed))


def _autocross(_: np.random.Generator) -> TrackLayout:
    corners = np.array(_AUTOCROSS_M, dtype=np.float64)
    return closed_course("autocross", spline(corners, _STEP_M, True), HALF_LANE_M)


def _oval(_: np.random.Generator) -> TrackLayout:
    """Two straights of 50 m joined by half circles of 15 m radius, to the left."""
    radius, straight = 15.0, 50.0
    x = np.arange(0.0, straight, _STEP_M)
    turn = np.arange(0.0, np.pi, _STEP_M / radius)
    along = np.column_stack([x, np.zeros_like(x)])
    bend = np.column_stack(
        [straight + radius * np.sin(turn), radius * (1 - np.cos(turn))]
    )
    half = np.vstack([along, bend])
    return closed_course(
        "oval", np.vstack([half, (straight, 2 * radius) - half]), HALF_LANE_M
    )


def _random(rng: np.random.Generator) -> TrackLayout:
    return closed_course("random", random_center(rng), HALF_LANE_M)


def _skidpad(_: np.random.Generator) -> TrackLayout:
    """Two circles, centres 18.25 m apart, driven right, right, left, left.

    16 cones stand on either inner circle; of 16 places on an outer circle the three
    towards the other circle stay free, which leaves 13 and opens the lane. The car
    waits 15 m before the timing line, where the frame has its origin.
    """
    entry, leave, half_lane = ENTRY_M, 20.0, 1.5
    bearing = np.deg2rad(22.5) * np.arange(16)
    circle = np.column_stack([np.sin(bearing), -np.cos(bearing)])
    centre = np.array([entry, CENTRES_APART_M / 2])
    mirror = np.array([1.0, -1.0])
    inner = centre + INNER_RADIUS_M * circle
    outer = centre + OUTER_RADIUS_M * circle[2:-1]
    lanes = _two_rows(
        np.array([1.0, 3.5, 6.0, *entry + np.arange(9.0, 25.1, 2.0)]), half_lane
    )
    path = skidpad_path(entry, leave, CENTRES_APART_M / 2, _STEP_M)
    posts = np.array([[entry + 1.5, 1.8], [entry - 1.5, 1.8]])
    return layout_of(
        "skidpad",
        {
            ConeClass.BLUE: np.vstack([inner, outer * mirror]),
            ConeClass.YELLOW: np.vstack([inner * mirror, outer]),
            ConeClass.ORANGE: lanes,
            ConeClass.BIG_ORANGE: np.vstack([posts, posts * mirror]),
        },
        start_pose=np.zeros(3),
        closed=False,
        centerline_m=path + np.array([entry, 0.0]),
        in_driving_order=False,
    )


def _acceleration(_: np.random.Generator) -> TrackLayout:
    """75 m straight, cones every 5 m, then a braking zone of orange cones.

    The car waits 0.3 m before the start line, where the frame has its origin.
    """
    before, length, brake = 0.3, 75.0, 75.0
    rows = before + np.arange(5.0, length, 5.0)
    zone = before + length + np.arange(5.0, brake + 1.0, 5.0)
    lines = before + np.array([0.0, length])
    gates = (lines[:, None] + (-GATE_HALF_M, GATE_HALF_M)).ravel()
    x = np.arange(0.0, before + length + 0.8 * brake, _STEP_M)
    return layout_of(
        "acceleration",
        {
            ConeClass.BLUE: np.column_stack([rows, np.full_like(rows, HALF_LANE_M)]),
            ConeClass.YELLOW: np.column_stack([rows, np.full_like(rows, -HALF_LANE_M)]),
            ConeClass.ORANGE: _two_rows(zone, HALF_LANE_M),
            ConeClass.BIG_ORANGE: _two_rows(gates, HALF_LANE_M),
        },
        start_pose=np.zeros(3),
        closed=False,
        centerline_m=np.column_stack([x, np.zeros_like(x)]),
    )


def _two_rows(x_m: Array, half_lane_m: float) -> Array:
    """Return cones at the given distances on both sides of the x axis; (2 N, 2)."""
    y = np.full_like(x_m, half_lane_m)
    return np.vstack([np.column_stack([x_m, y]), np.column_stack([x_m, -y])])


_TRACKS: dict[str, Callable[[np.random.Generator], TrackLayout]] = {
    "autocross": _autocross,
    "oval": _oval,
    "random": _random,
    "skidpad": _skidpad,
    "acceleration": _acceleration,
}
BUILT_IN_TRACKS: tuple[str, ...] = tuple(_TRACKS)
