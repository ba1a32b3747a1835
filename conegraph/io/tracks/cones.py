"""Collecting the cones of a track file, and what every format shares."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.cone_names import cone_class
from conegraph.types import Array, ConeClass, TrackLayout

NARROWEST_LOOP_M = 8.0
"""A hairpin of a Formula Student track is at least 9 m wide outside."""


NOT_CONES = ("inactive_noise", "invisible", "midpoint", "timekeeping")
"""Names that simulators give to things that no camera sees as a cone."""


class ConeCollector:
    """Takes cones one by one; drops what is none and exact duplicates."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cones: dict[tuple[float, float, ConeClass], None] = {}
        self.dropped: Counter[str] = Counter()

    def drop(self, reason: str, count: int = 1) -> None:
        """Count something that was left out."""
        if count:
            self.dropped[reason] += count

    def add(self, name: str, xy_m: list[float] | None) -> None:
        """Take a cone by its class name in the file; None is a malformed position."""
        kind = cone_class(name)
        if kind is None:
            known = name.strip().lower() in NOT_CONES
            self.drop(f"not a cone: {name}" if known else "unknown class name")
        elif xy_m is None:
            self.drop("malformed row")
        elif (cone := (xy_m[0], xy_m[1], kind)) in self._cones:
            self.drop("exact duplicate")
        else:
            self._cones[cone] = None

    def layout(
        self,
        *,
        start_pose: list[float] | None = None,
        closed: bool | None = None,
        centerline_m: Array | None = None,
        in_driving_order: bool = False,
    ) -> TrackLayout:
        """Return what was collected; ``closed`` None means by its shape.

        Raises:
            FileFormatError: there is no cone.
        """
        if not self._cones:
            raise FileFormatError(self._path, f"holds no cone ({dict(self.dropped)})")
        xy = np.array([cone[:2] for cone in self._cones])
        return TrackLayout(
            name=self._path.stem,
            xy_m=xy,
            cone_class=np.array([cone[2] for cone in self._cones], dtype=np.int64),
            start_pose=None if start_pose is None else np.array(start_pose),
            closed=is_loop(xy) if closed is None else closed,
            centerline_m=centerline_m,
            in_driving_order=in_driving_order,
            dropped=dict(self.dropped),
        )


def is_loop(xy_m: Array) -> bool:
    """Return whether cones (N, 2) lie too wide to be a straight.

    The extent across their principal axis is compared with the narrowest loop that
    the rules allow; an acceleration track is 3 to 5 m wide.
    """
    centred = xy_m - xy_m.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    return len(axes) > 1 and float(np.ptp(centred @ axes[1])) >= NARROWEST_LOOP_M
