"""When the true car crossed the start line."""

from __future__ import annotations

import numpy as np

from conegraph.backends.laps import LapCounter
from conegraph.config import StartLineConfig
from conegraph.eval.align import distance
from conegraph.eval.reference_graph import truth_of
from conegraph.types import ConeClass, Recording


def true_lap_ends(recording: Recording) -> tuple[float, ...]:
    """Return the stamps at which the true car ended a lap, none without a start gate.

    The gate is that of the true start cones, or the one that back ends take on tracks
    without any.

    Raises:
        ValueError: the recording does not know the truth.
    """
    truth, cones = truth_of(recording), recording.truth_map
    counter = LapCounter(StartLineConfig())
    if cones is not None:
        start = np.isin(cones.cone_class, (ConeClass.ORANGE, ConeClass.BIG_ORANGE))
        counter.locate_gate(truth.cones_m(cones.id[start]))
    path = truth.trajectory
    moved = np.concatenate([[0.0], distance(path.pose[1:, :2], path.pose[:-1, :2])])
    laps = [
        counter.advance(stamp, pose, step)
        for stamp, pose, step in zip(
            path.stamp_s.tolist(), path.pose, moved.tolist(), strict=True
        )
    ]
    return tuple(lap.end_s for lap in laps if lap is not None)
