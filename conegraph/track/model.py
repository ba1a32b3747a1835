"""What track detection hands over: boundaries, road, centre line, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.types import Array, IntArray


@dataclass(frozen=True, slots=True)
class Unused:
    """A cone that is on no boundary, and why."""

    id: int
    reason: str


@dataclass(frozen=True, slots=True)
class Relabelled:
    """A cone that stands on the other side than its colour says."""

    id: int
    colour: str
    side: str


@dataclass(frozen=True, slots=True)
class Bridge:
    """A gap in a boundary where cones seem to be missing."""

    side: str
    from_id: int
    to_id: int
    gap_m: float


@dataclass(frozen=True, slots=True)
class CenterLine:
    """The middle of the road for a planner, evenly spaced.

    Attributes:
        s_m: (K,) arc length from the first point.
        xy_m: (K, 2) points; of a loop the first is not repeated.
        heading_rad: (K,) direction of travel, in (-pi, pi].
        curvature_1pm: (K,) in 1/m, left turns positive.
        left_m: (K,) distance to the left boundary, straight across.
        right_m: (K,) distance to the right boundary.
    """

    s_m: Array
    xy_m: Array
    heading_rad: Array
    curvature_1pm: Array
    left_m: Array
    right_m: Array

    def __len__(self) -> int:
        return len(self.s_m)

    @staticmethod
    def empty() -> CenterLine:
        """A line without points."""
        none = np.zeros(0)
        return CenterLine(none, np.zeros((0, 2)), none, none, none, none)


@dataclass(frozen=True, slots=True)
class Track:
    """A road between cones, or the answer that there is none to be seen.

    Attributes:
        id: (N,) ids of the cones that were looked at.
        xy_m: (N, 2) their positions.
        left: (L,) rows of the left boundary, in driving order.
        right: (R,) rows of the right boundary.
        triangles: (T, 3) rows: the road as a strip of triangles, in driving order,
            each counter-clockwise. They cover the road once.
        centerline: the middle of the road.
        closed: whether it is a loop.
        confidence: from 0, "I do not know", to 1.
        reason: what the confidence suffers from; empty where nothing does.
        length_m: of the centre line, around a loop.
        lane_m: usual width of the lane.
        unused: cones on no boundary.
        relabelled: cones on the other side than their colour says.
        bridged: gaps where cones seem to be missing.
    """

    id: IntArray
    xy_m: Array
    left: IntArray
    right: IntArray
    triangles: IntArray
    centerline: CenterLine
    closed: bool
    confidence: float
    reason: str
    length_m: float
    lane_m: float
    unused: tuple[Unused, ...] = ()
    relabelled: tuple[Relabelled, ...] = ()
    bridged: tuple[Bridge, ...] = ()

    @property
    def left_id(self) -> IntArray:
        """(L,) ids of the left boundary."""
        return self.id[self.left]

    @property
    def right_id(self) -> IntArray:
        """(R,) ids of the right boundary."""
        return self.id[self.right]

    @property
    def left_m(self) -> Array:
        """(L, 2) positions of the left boundary."""
        return self.xy_m[self.left]

    @property
    def right_m(self) -> Array:
        """(R, 2) positions of the right boundary."""
        return self.xy_m[self.right]

    @property
    def triangle_id(self) -> IntArray:
        """(T, 3) ids of the corners of the triangles."""
        return self.id[self.triangles]

    @staticmethod
    def unknown(
        reason: str,
        ids: IntArray | None = None,
        xy_m: Array | None = None,
        unused: tuple[Unused, ...] = (),
    ) -> Track:
        """Return "I do not know", with the reason."""
        none = np.zeros(0, dtype=np.int64)
        return Track(
            none if ids is None else ids,
            np.zeros((0, 2)) if xy_m is None else xy_m,
            none,
            none,
            np.zeros((0, 3), dtype=np.int64),
            CenterLine.empty(),
            closed=False,
            confidence=0.0,
            reason=reason,
            length_m=0.0,
            lane_m=float("nan"),
            unused=unused,
        )
