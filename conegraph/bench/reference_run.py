"""The batch optimum of a stream as a row."""

from __future__ import annotations

import time

from conegraph.bench.lap_truth import true_lap_ends
from conegraph.bench.rows import Job, ReferenceMap, ReferenceRow
from conegraph.eval.reference import (
    ReferenceSolution,
    causal_bound,
    cramer_rao,
    prefix_optima,
)
from conegraph.types import Recording

CAUSAL_FRAMES = 12
"""Frames at which the bound on a causal pose is computed: each takes a solution."""


def refer(job: Job, recording: Recording) -> ReferenceRow:
    """Solve for the optimum at every true lap's end and at the end of the stream.

    Raises:
        ValueError: the recording lacks truth or sensor.
    """
    began = time.perf_counter()
    ends = true_lap_ends(recording)
    *laps, final = prefix_optima(recording, (*ends, float("inf")))
    bound = cramer_rao(recording)
    causal_s, causal_m = causal_bound(recording, CAUSAL_FRAMES)
    last_s = float(final.path.stamp_s[-1])
    return ReferenceRow(
        key=job.key,
        laps=tuple(_map_at(end_s, lap) for end_s, lap in zip(ends, laps, strict=True)),
        final=_map_at(last_s, final),
        map_rmse_m=final.map_rmse_aligned_m(),
        map_bound_m=bound.map_rmse_aligned_m,
        map_bound_sigma=bound.aligned_mse_sigma_m2 / bound.map_rmse_aligned_m**2,
        pose_rmse_m=final.pose_rmse_m(),
        pose_bound_m=bound.pose_rmse_m,
        causal_s=tuple(causal_s.tolist()),
        causal_bound_m=tuple(causal_m.tolist()),
        wall_s=time.perf_counter() - began,
    )


def _map_at(end_s: float, solution: ReferenceSolution) -> ReferenceMap:
    return ReferenceMap(
        end_s=end_s,
        cone_id=tuple(solution.cone_id.tolist()),
        xy_m=tuple((x, y) for x, y in solution.xy_m.tolist()),
    )
