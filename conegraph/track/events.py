"""Skidpad and acceleration: known maps, scripted paths, times.

There the colours do not mean left and right of one lane, and nothing needs to be
found: the rules say where the cones stand and what to drive. The car only has to
localise on the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from conegraph.geometry import to_child, to_parent
from conegraph.io.cone_names import hard_class_prob
from conegraph.sim.polyline import arc_length
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Array, ConeClass, ConeMap, IntArray, Trajectory

ACCELERATION_M = 75.0
START_BEFORE_LINE_M = 0.3
_SIGMA_M = 0.05
_LINE_HALF_M = 3.0


class Event(StrEnum):
    """The disciplines on known maps."""

    SKIDPAD = "skidpad"
    ACCELERATION = "acceleration"


@dataclass(frozen=True, slots=True)
class EventPlan:
    """What is known of an event before the car moves.

    Attributes:
        cone_map: its cones, for localising only, in the frame of the car's start.
        path_m: (K, 2) scripted path, 0.25 m apart.
        s_m: (K,) arc length along it.
        stop_s_m: where on the path to be standing.
        line_pose: (3,) middle and direction of the first timing line.
        segments: what the car does between two crossings of timing lines.
        finish_pose: (3,) the second timing line, where there is one.
    """

    cone_map: ConeMap
    path_m: Array
    s_m: Array
    stop_s_m: float
    line_pose: Array
    segments: tuple[str, ...]
    finish_pose: Array | None = None


@dataclass(frozen=True, slots=True)
class SegmentTime:
    """How long one segment took, and whether it counts."""

    name: str
    start_s: float
    end_s: float
    timed: bool

    @property
    def duration_s(self) -> float:
        """The segment's time."""
        return self.end_s - self.start_s


def plan_event(event: Event, start_pose: Array | None = None) -> EventPlan:
    """Return the map and the path of an event by the geometry of the rules.

    Skidpad: circles 18.25 m apart, 15.25 m across inside and 21.25 m outside; right,
    right timed, left, left timed, out. Acceleration: 75 m, cones every 5 m, then stop.

    Args:
        event: which one.
        start_pose: (3,) the waiting car in the frame to plan in; its own by default.
    """
    layout = built_in_track(event.value, seed=0)
    n = len(layout)
    pose = np.zeros(3) if start_pose is None else np.asarray(start_pose)
    cov = np.broadcast_to(_SIGMA_M**2 * np.eye(2), (n, 2, 2))
    prob = hard_class_prob(layout.cone_class)
    seen = np.ones(n, dtype=np.int64)
    cone_map = ConeMap(np.arange(n), to_parent(pose, layout.xy_m), cov, prob, seen)
    line = np.zeros((0, 2)) if layout.centerline_m is None else layout.centerline_m
    path = to_parent(pose, np.asarray(line))
    s = arc_length(path)
    if event is Event.SKIDPAD:
        crossing = np.array([_line_ahead(layout.xy_m, layout.cone_class), 0.0])
        segments = ("right", "right timed", "left", "left timed")
        return EventPlan(
            cone_map, path, s, float(s[-1]), _placed(pose, crossing), segments
        )
    first = np.array([START_BEFORE_LINE_M, 0.0])
    last = np.array([START_BEFORE_LINE_M + ACCELERATION_M, 0.0])
    return EventPlan(
        cone_map,
        path,
        s,
        float(s[-1]),
        _placed(pose, first),
        ("acceleration",),
        _placed(pose, last),
    )


def segment_times(plan: EventPlan, driven: Trajectory) -> tuple[SegmentTime, ...]:
    """Return the times of the segments that a car drove, as far as it got.

    A line is crossed where the path passes it forwards within 3 m of its middle; the
    moment is interpolated between two poses.
    """
    starts = _crossings(plan.line_pose, driven)
    if plan.finish_pose is not None:
        ends = [
            t for t in _crossings(plan.finish_pose, driven) if starts and t > starts[0]
        ]
        starts = [*starts[:1], *ends[:1]]
    return tuple(
        SegmentTime(
            name, begin, end, timed="timed" in name or plan.finish_pose is not None
        )
        for name, begin, end in zip(plan.segments, starts, starts[1:], strict=False)
    )


def _crossings(line_pose: Array, driven: Trajectory) -> list[float]:
    place = to_child(line_pose, driven.pose[:, :2])
    before, after = place[:-1], place[1:]
    rows = np.flatnonzero((before[:, 0] < 0.0) & (after[:, 0] >= 0.0))
    share = -before[rows, 0] / (after[rows, 0] - before[rows, 0])
    across = before[rows, 1] + share * (after[rows, 1] - before[rows, 1])
    step = driven.stamp_s[rows + 1] - driven.stamp_s[rows]
    when = driven.stamp_s[rows] + share * step
    return [float(t) for t in when[np.abs(across) < _LINE_HALF_M]]


def _placed(pose: Array, point: Array) -> Array:
    return np.array([*to_parent(pose, point[None])[0], pose[2]])


def _line_ahead(xy: Array, kind: IntArray) -> float:
    """Return how far ahead the timing line is: amid the big orange cones."""
    return float(xy[kind == ConeClass.BIG_ORANGE, 0].mean())
