"""What the mapper was told, frame by frame, and what of it was taken back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.types import Array, IntArray, Mask, MatchStatus, Revision

BIAS_SEGMENT_S = 10.0
"""Length of a stretch of time with one yaw-rate bias."""


@dataclass(slots=True)
class Entry:
    """One frame of the journal.

    Attributes:
        k: its number, that of its pose.
        frame: what the tracker said.
        before: the entry before it, None for the first.
        segment: stretch of time whose bias its odometry has.
        walk_s: time since the last segment began if this one begins a new one.
        moving: whether a velocity belongs to its pose.
        starts_moving: whether the pose before it gets a velocity because of it.
        kept: (n,) sightings that have not been taken back.
    """

    k: int
    frame: TrackedFrame
    before: Entry | None = field(repr=False)
    segment: int
    walk_s: float
    moving: bool
    starts_moving: bool
    kept: Mask

    @property
    def cones(self) -> IntArray:
        """(m,) cones of the sightings kept."""
        return self.frame.landmark_id[self.kept]


class Journal:
    """Everything that the graph is made of, to make it again without a mistake."""

    def __init__(self, given: Iterable[int] = ()) -> None:
        """Start empty.

        Args:
            given: cones of a given map, which holds them as a sighting does.
        """
        self.entries: list[Entry] = []
        self.sightings = dict.fromkeys(given, 1)
        self._segment_s = -np.inf

    def __len__(self) -> int:
        return len(self.entries)

    def append(self, frame: TrackedFrame) -> Entry:
        """Write down the next frame."""
        before = self.entries[-1] if self.entries else None
        segment, walk_s = 0, 0.0
        if before is None:
            self._segment_s = frame.stamp_s
        else:
            segment = before.segment
            elapsed_s = frame.stamp_s - self._segment_s
            if frame.increment is not None and elapsed_s > BIAS_SEGMENT_S:
                segment, walk_s = segment + 1, elapsed_s
                self._segment_s = frame.stamp_s
        joined = before is not None and not frame.jump
        moving = joined and frame.increment is None
        entry = Entry(
            len(self.entries),
            frame,
            before,
            segment,
            walk_s,
            moving,
            moving and before is not None and not before.moving,
            np.ones(len(frame.landmark_id), dtype=bool),
        )
        self.entries.append(entry)
        for cone in frame.landmark_id.tolist():
            self.sightings[cone] = self.sightings.get(cone, 0) + 1
        return entry

    def retract(
        self, entry: Entry, index: IntArray, d2: Array, *, closure: bool = False
    ) -> list[Revision]:
        """Take sightings of an entry back, save those that alone hold a cone.

        Args:
            entry: the frame.
            index: (n,) places in its list of sightings.
            d2: (n,) what speaks against them.
            closure: whether with them a loop is undone.

        Returns:
            What was taken back: one revision, or none if nothing could be.
        """
        frame, gone = entry.frame, []
        for n, i in enumerate(index.tolist()):
            cone = int(frame.landmark_id[i])
            if entry.kept[i] and self.sightings[cone] > 1:
                entry.kept[i] = False
                self.sightings[cone] -= 1
                gone.append(n)
        if not gone:
            return []
        at = index[gone]
        return [
            Revision(
                frame.stamp_s,
                frame.row[at],
                frame.landmark_id[at],
                d2[gone],
                closure=closure,
            )
        ]

    def adopt(
        self, entry: Entry, index: IntArray, cone: IntArray, d2: Array
    ) -> Revision:
        """Let sightings that were left aside count after all.

        Args:
            entry: the frame.
            index: (n,) places among its unclaimed sightings.
            cone: (n,) what they show.
            d2: (n,) how well they fit it.
        """
        frame, found = entry.frame, entry.frame.unclaimed.subset(index)
        others = np.setdiff1d(np.arange(len(frame.unclaimed)), index)
        entry.frame = replace(
            frame,
            landmark_id=np.concatenate([frame.landmark_id, cone]),
            row=np.concatenate([frame.row, found.row]),
            xy_m=np.concatenate([frame.xy_m, found.xy_m]),
            cov_m2=np.concatenate([frame.cov_m2, found.reported_m2]),
            reported_m2=np.concatenate([frame.reported_m2, found.reported_m2]),
            vague=np.concatenate([frame.vague, np.zeros(len(cone), dtype=bool)]),
            unclaimed=frame.unclaimed.subset(others),
        )
        entry.kept = np.concatenate([entry.kept, np.ones(len(cone), dtype=bool)])
        for one in cone.tolist():
            self.sightings[one] += 1
        return Revision(frame.stamp_s, found.row, cone, d2, MatchStatus.MATCHED)

    def drop(self, entry: Entry) -> None:
        """Take all sightings of an entry back, whatever they hold."""
        for cone in entry.cones.tolist():
            self.sightings[cone] -= 1
        entry.kept[:] = False
