"""Tracks that look the same in many places: no pose on them can be told."""

from __future__ import annotations

import numpy as np

from conegraph.types import ConeClass, TrackLayout

HALF_LANE_M = 1.75
STEP_M = 0.25


def circle(n: int = 32, radius_m: float = 15.0) -> TrackLayout:
    """Return a circle with n cones on either side, driven to the left."""
    turn = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    fine = np.linspace(0, 2 * np.pi, int(2 * np.pi * radius_m / STEP_M), endpoint=False)
    return TrackLayout(
        "circle",
        np.vstack([(radius_m - HALF_LANE_M) * ring, (radius_m + HALF_LANE_M) * ring]),
        np.repeat([int(ConeClass.BLUE), int(ConeClass.YELLOW)], n),
        start_pose=np.array([radius_m, 0.0, np.pi / 2]),
        centerline_m=radius_m * np.column_stack([np.cos(fine), np.sin(fine)]),
    )


def straight(
    length_m: float = 200.0, spacing_m: float = 4.0, beyond_m: float = 120.0
) -> TrackLayout:
    """Return a straight whose ends lie beyond what any sensor of ours sees."""
    x = np.arange(-beyond_m, length_m + beyond_m, spacing_m)
    side = np.full_like(x, HALF_LANE_M)
    way = np.arange(0.0, length_m, STEP_M)
    return TrackLayout(
        "straight",
        np.vstack([np.column_stack([x, side]), np.column_stack([x, -side])]),
        np.repeat([int(ConeClass.BLUE), int(ConeClass.YELLOW)], len(x)),
        start_pose=np.zeros(3),
        closed=False,
        centerline_m=np.column_stack([way, np.zeros_like(way)]),
    )
