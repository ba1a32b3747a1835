"""The judge: one run against the truth, every figure in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from conegraph.eval.association_metrics import AssociationMetrics, association_metrics
from conegraph.eval.consistency import PoseConsistency, pose_consistency
from conegraph.eval.map_metrics import MapMetrics, map_metrics
from conegraph.eval.matching import DEFAULT_GATE_M, TWIN_DISTANCE_M, find_twins
from conegraph.eval.record import Record
from conegraph.eval.run_metrics import (
    ClosureMetrics,
    LatencyStats,
    StatusMetrics,
    closure_metrics,
    latency_stats,
    status_metrics,
)
from conegraph.eval.trajectory_metrics import (
    MAX_TRUTH_GAP_S,
    TrajectoryMetrics,
    pair_with_truth,
    trajectory_metrics,
)
from conegraph.geometry import between
from conegraph.io.run_folder import RunFolder
from conegraph.types import IntArray, Status, Trajectory, TruthMap

OBSERVABLE_AFTER = 3
"""A cone that the sensor reported this often is one that a map should hold."""

MAX_NAMED = 10


@dataclass(frozen=True, slots=True)
class Truth:
    """What is known to be true; every part may be missing.

    Attributes:
        trajectory: true poses, in the track's frame.
        cones: true cones, in the same frame.
        observation_ids: (N,) true id of each association row, in the order of the
            rows, -1 for a false detection.
    """

    trajectory: Trajectory | None = None
    cones: TruthMap | None = None
    observation_ids: IntArray | None = None


@dataclass(frozen=True, slots=True)
class RunMetrics(Record):
    """All that the judge found out about a run; None where truth is missing.

    Attributes:
        trajectory: errors of the causal estimate, what a car would have driven by.
        smoothed: errors of the final estimate of the whole path.
        map: errors of the cone map.
        association: observations against their true ids.
        closures: laps and loop closures.
        latency_ms: time by stage.
        status: frames by status.
        warnings: what is odd about the truth or the run, in sentences.
        pose_consistency: errors of the causal estimate against its covariances.
    """

    trajectory: TrajectoryMetrics | None
    smoothed: TrajectoryMetrics | None
    map: MapMetrics | None
    association: AssociationMetrics | None
    closures: ClosureMetrics
    latency_ms: Mapping[str, LatencyStats]
    status: StatusMetrics
    warnings: tuple[str, ...]
    pose_consistency: PoseConsistency | None = None


def evaluate(
    run: RunFolder, truth: Truth, *, max_distance_m: float = DEFAULT_GATE_M
) -> RunMetrics:
    """Compare a run with the truth.

    Poses from before the car was found elsewhere on its map are of no frame: paths
    are judged from there on, and a warning says so. Later jumps count as errors.

    Args:
        run: what the run wrote.
        truth: what there is to compare with.
        max_distance_m: farthest pair of estimated and true cone.

    Raises:
        ValueError: the true ids are not as many as the association rows.
    """
    run, unplaced = _since_found(run)
    causal = _path_metrics(run.trajectory, truth.trajectory)
    cones = None
    if truth.cones is not None:
        cones = map_metrics(
            run.cone_map,
            truth.cones,
            start_pose=None if causal is None else causal.pose_truth_start,
            trajectory_pose=None if causal is None else causal.pose_truth_run,
            observable=_observable(truth.cones, truth.observation_ids),
            max_distance_m=max_distance_m,
        )
    association = None
    if truth.observation_ids is not None:
        association = association_metrics(run.associations, truth.observation_ids)
    return RunMetrics(
        trajectory=causal,
        smoothed=_path_metrics(run.smoothed, truth.trajectory),
        map=cones,
        association=association,
        closures=closure_metrics(run.summary),
        latency_ms=latency_stats(run.timing_ms),
        status=status_metrics(run.status),
        warnings=(
            *_truth_warnings(truth),
            *_run_warnings(run, causal, truth),
            *_status_warnings(run, unplaced),
        ),
        pose_consistency=_pose_consistency(run, causal, truth.trajectory),
    )


def _since_found(run: RunFolder) -> tuple[RunFolder, int]:
    """Leave out the poses before a first jump, if none was trusted; return how many."""
    status = run.status
    jumped = np.flatnonzero(status.reset_counter > 0)
    if len(jumped) == 0:
        return run, 0
    first = int(jumped[0])
    if np.isin(status.status[:first], (Status.OK.value, Status.DEGRADED.value)).any():
        return run, 0
    since_s = float(status.stamp_s[first])
    smoothed = None if run.smoothed is None else _since(run.smoothed, since_s)
    found = replace(run, trajectory=_since(run.trajectory, since_s), smoothed=smoothed)
    return found, len(run.trajectory) - len(found.trajectory)


def _since(path: Trajectory, stamp_s: float) -> Trajectory:
    later = path.stamp_s >= stamp_s
    return Trajectory(path.stamp_s[later], path.pose[later])


def _pose_consistency(
    run: RunFolder, causal: TrajectoryMetrics | None, truth: Trajectory | None
) -> PoseConsistency | None:
    """Judge the causal poses' covariances in the run's own frame, its start."""
    cov = run.pose_cov
    if causal is None or truth is None or len(cov) == 0:
        return None
    pairs = pair_with_truth(run.trajectory, truth)
    row = np.searchsorted(cov.stamp_s, pairs.stamp_s).clip(max=len(cov) - 1)
    known = cov.stamp_s[row] == pairs.stamp_s
    true = between(causal.pose_truth_start, pairs.truth[known])
    return pose_consistency(pairs.estimate[known], cov.cov[row[known]], true)


def _path_metrics(
    path: Trajectory | None, truth: Trajectory | None
) -> TrajectoryMetrics | None:
    if path is None or truth is None:
        return None
    return trajectory_metrics(path, truth)


def _observable(
    cones: TruthMap, observation_ids: IntArray | None
) -> NDArray[np.bool_] | None:
    if observation_ids is None:
        return None
    seen, count = np.unique(observation_ids, return_counts=True)
    return np.isin(cones.id, seen[count >= OBSERVABLE_AFTER])


def _truth_warnings(truth: Truth) -> list[str]:
    if truth.cones is None:
        return []
    twins, cones = find_twins(truth.cones.xy_m), truth.cones
    if len(twins) == 0:
        return []
    named = ", ".join(f"{cones.id[a]} and {cones.id[b]}" for a, b in twins[:MAX_NAMED])
    more = ", ..." if len(twins) > MAX_NAMED else ""
    return [
        f"the truth is faulty: {len(twins)} of its pairs of cones stand closer than "
        f"{TWIN_DISTANCE_M} m, which no two cones can (ids {named}{more})"
    ]


def _run_warnings(
    run: RunFolder, causal: TrajectoryMetrics | None, truth: Truth
) -> list[str]:
    warnings = []
    if not run.finished:
        warnings.append("the run did not finish: what it wrote until then is judged")
    broken = int((~np.isfinite(run.trajectory.pose).all(axis=1)).sum())
    if broken:
        warnings.append(f"{broken} poses of the trajectory are not finite")
    if truth.trajectory is not None and causal is None:
        warnings.append("no pose of the run lies within the true trajectory's time")
    if causal is not None and causal.left_out:
        warnings.append(
            f"{causal.left_out} of {len(run.trajectory)} poses have no truth: outside "
            f"its time, or in a gap of more than {MAX_TRUTH_GAP_S} s"
        )
    return warnings


def _status_warnings(run: RunFolder, unplaced: int) -> list[str]:
    """Say where the run itself did not know where the car is."""
    frames, warnings = len(run.status), []
    if unplaced:
        warnings.append(
            f"{unplaced} of {frames} frames passed until the car was found on the map: "
            "their poses are not judged"
        )
    lost = int((run.status.status == Status.LOST.value).sum())
    if lost:
        warnings.append(f"the car was LOST in {lost} of {frames} frames")
    if frames and (run.status.status == Status.INIT.value).all():
        warnings.append(f"the status was INIT to the end: {run.status.reason[-1]}")
    return warnings
