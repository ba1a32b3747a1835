"""When the true car crossed the start line."""

from __future__ import annotations

import numpy as np

from conegraph.eval.colour_metrics import ORANGES
from conegraph.eval.laps import true_laps
from conegraph.eval.reference_graph import truth_of
from conegraph.types import Recording


def true_lap_ends(recording: Recording) -> tuple[float, ...]:
    """Return the stamps at which the true car ended a lap, none without a start gate.

    The gate is that of the true start cones, or the one that back ends take on tracks
    without any.

    Raises:
        ValueError: the recording does not know the truth.
    """
    truth, cones = truth_of(recording), recording.truth_map
    start_m = np.zeros((0, 2))
    if cones is not None:
        start_m = truth.cones_m(cones.id[np.isin(cones.cone_class, ORANGES)])
    return tuple(lap.end_s for lap in true_laps(truth.trajectory, start_m))
