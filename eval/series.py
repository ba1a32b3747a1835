"""A run along its way, thinned to what a drawing can show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import distance
from conegraph.eval.consistency import pose_nees
from conegraph.eval.judge import RunMetrics, Truth, since_found
from conegraph.eval.pose_pairs import pair_with_truth, path_length
from conegraph.eval.run_metrics import FRAME, cost_metrics
from conegraph.geometry import between, compose, inverse, to_parent, wrap_angle
from conegraph.io.run_folder import RunFolder
from conegraph.types import Array, IntArray

MAX_SAMPLES = 400
FRAME_MS_EDGES: Array = np.geomspace(0.01, 10_000.0, 61)
"""Ten bins a decade, from 10 us to 10 s."""


@dataclass(frozen=True, slots=True)
class RunSeries:
    """What happened along the way; every array may be empty.

    Attributes:
        stamp_s: (N,) since the first judged pose, s, N at most `MAX_SAMPLES`.
        distance_m: (N,) true distance driven until then, m.
        position_error_m: (N,) of the causal estimate from the first pose on, m.
        heading_error_rad: (N,) likewise, in (-pi, pi].
        nees: (N,) of the causal pose, 3 degrees of freedom; NaN where not known.
        frame_ms_edges: (B + 1,) edges of a histogram of the time per frame, ms.
        frame_ms_counts: (B,) frames in each of its bins.
        lap_p99_ms: (L,) 99th percentile of the time per frame in each lap, ms.
    """

    stamp_s: Array
    distance_m: Array
    position_error_m: Array
    heading_error_rad: Array
    nees: Array
    frame_ms_edges: Array
    frame_ms_counts: IntArray
    lap_p99_ms: Array


@dataclass(frozen=True, slots=True)
class PlacedMap:
    """A map and a path where they fit the truth best, all in the truth's frame.

    Attributes:
        xy_m: (N, 2) cones of the map.
        cone_class: (N,) their `ConeClass`.
        path_m: (P, 2) the causal path.
        true_xy_m: (M, 2) true cones, None where nobody knows.
        true_class: (M,) their `ConeClass`, None likewise.
        true_path_m: (Q, 2) the true path, None where nobody knows.
    """

    xy_m: Array
    cone_class: IntArray
    path_m: Array
    true_xy_m: Array | None = None
    true_class: IntArray | None = None
    true_path_m: Array | None = None


def run_series(run: RunFolder, truth: Truth) -> RunSeries:
    """Look along a run; without a true path there are no errors."""
    stamp_s = distance_m = error_m = heading_rad = nees = np.zeros(0)
    found, _ = since_found(run)
    if truth.trajectory is not None:
        pairs = pair_with_truth(found.trajectory, truth.trajectory)
        if len(pairs.stamp_s):
            start = compose(pairs.truth[0], inverse(pairs.estimate[0]))
            true = between(start, pairs.truth)
            keep = _thinned(len(pairs.stamp_s))
            stamp_s = (pairs.stamp_s - pairs.stamp_s[0])[keep]
            distance_m = path_length(pairs.truth[:, :2])[keep]
            error_m = distance(pairs.estimate[keep, :2], true[keep, :2])
            heading_rad = wrap_angle(pairs.estimate[keep, 2] - true[keep, 2])
            cov = run.pose_cov.at(pairs.stamp_s[keep])
            nees = pose_nees(pairs.estimate[keep], cov, true[keep])
    counts, _ = np.histogram(run.timing_ms.get(FRAME, np.zeros(0)), FRAME_MS_EDGES)
    cost = cost_metrics(run.status.stamp_s, run.timing_ms, run.summary)
    return RunSeries(
        stamp_s=stamp_s,
        distance_m=distance_m,
        position_error_m=error_m,
        heading_error_rad=heading_rad,
        nees=nees,
        frame_ms_edges=FRAME_MS_EDGES,
        frame_ms_counts=counts.astype(np.int64),
        lap_p99_ms=np.array(cost.lap_p99_ms),
    )


def placed_map(run: RunFolder, truth: Truth, metrics: RunMetrics) -> PlacedMap:
    """Move a run's map and path to where the judge found that they fit best."""
    pose = _placement(metrics)
    cones, path = truth.cones, truth.trajectory
    return PlacedMap(
        xy_m=to_parent(pose, run.cone_map.xy_m),
        cone_class=run.cone_map.cone_class,
        path_m=compose(pose, run.trajectory.pose)[:, :2],
        true_xy_m=None if cones is None else cones.xy_m,
        true_class=None if cones is None else cones.cone_class,
        true_path_m=None if path is None else path.pose[:, :2],
    )


def _placement(metrics: RunMetrics) -> Array:
    if metrics.map is not None and metrics.map.matched > 1:
        return metrics.map.pose_truth_run
    if metrics.trajectory is not None:
        return metrics.trajectory.pose_truth_run
    return np.zeros(3)


def _thinned(n: int) -> IntArray:
    return np.unique(np.linspace(0, n - 1, min(n, MAX_SAMPLES)).astype(np.int64))
