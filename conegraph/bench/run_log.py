"""What is kept of every frame of a measured run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from conegraph.eval.association_metrics import majority
from conegraph.types import Array, FrameRecord, IntArray, MatchStatus, Trajectory

_USED = (MatchStatus.MATCHED, MatchStatus.TENTATIVE)


@dataclass(slots=True)
class RunLog:
    """Columns that grow by one entry a frame, unless they say otherwise.

    Attributes:
        stamp_s: stamps of the estimates.
        pose: (3,) causal poses.
        cov: (3, 3) their covariances.
        frame_ms: time spent on the frame.
        lap: true lap that the frame is in, from 1.
        nis: normalised innovation squared, NaN without one.
        nis_dof: its degrees of freedom.
        landmark: landmarks matched.
        true_id: (k,) true ids of the observations matched to them.
        seen_id: true ids of all observations.
        closed: frames with an accepted loop closure.
        laps: laps that the back end has counted.
    """

    stamp_s: list[float] = field(default_factory=list)
    pose: list[Array] = field(default_factory=list)
    cov: list[Array] = field(default_factory=list)
    frame_ms: list[float] = field(default_factory=list)
    lap: list[int] = field(default_factory=list)
    nis: list[float] = field(default_factory=list)
    nis_dof: list[int] = field(default_factory=list)
    landmark: list[IntArray] = field(default_factory=list)
    true_id: list[IntArray] = field(default_factory=list)
    seen_id: list[IntArray] = field(default_factory=list)
    closed: list[int] = field(default_factory=list)
    laps: int = 0

    def add(self, record: FrameRecord, lap: int) -> None:
        """Keep a frame."""
        estimate, made = record.estimate, record.associations
        if any(closure.accepted for closure in record.closures):
            self.closed.append(len(self.stamp_s))
        self.stamp_s.append(estimate.stamp_s)
        self.pose.append(estimate.pose)
        self.cov.append(estimate.pose_cov)
        self.frame_ms.append(record.stage_ms["frame"])
        self.lap.append(lap)
        self.nis.append(made.nis)
        self.nis_dof.append(made.nis_dof)
        used = np.array([s in _USED for s in made.status], dtype=np.bool_)
        ids = record.observations.truth_id
        seen = np.full(len(used), -1) if ids is None else ids
        self.landmark.append(made.landmark_id[used])
        self.true_id.append(seen[used])
        self.seen_id.append(seen)
        self.laps += len(record.laps)

    def path(self, end_s: float = np.inf) -> Trajectory:
        """Return the causal path up to a stamp."""
        n = int(np.searchsorted(self.stamp_s, end_s, side="right"))
        poses = np.array(self.pose[:n]).reshape(-1, 3)
        return Trajectory(np.array(self.stamp_s[:n]), poses)

    def seen_often(self, times: int, end_s: float) -> IntArray:
        """Return the true cones that were reported so often up to a stamp."""
        n = int(np.searchsorted(self.stamp_s, end_s, side="right"))
        ids = np.concatenate([np.zeros(0, dtype=np.int64), *self.seen_id[:n]])
        cone, count = np.unique(ids[ids >= 0], return_counts=True)
        return cone[count >= times]

    def false_closures(self) -> int:
        """Count accepted closures most of whose frame's matches are wrong.

        A landmark stands for the true cone that most of its matches show.
        """
        if not self.closed:
            return 0
        landmark, cone = np.concatenate(self.landmark), np.concatenate(self.true_id)
        own, shown = majority(landmark, cone)

        def is_false(k: int) -> bool:
            right = shown[np.searchsorted(own, self.landmark[k])] == self.true_id[k]
            return bool(len(right) and right.mean() < 0.5)

        return sum(is_false(k) for k in self.closed)
