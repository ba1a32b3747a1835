"""The judge: one run against the truth, every figure in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from conegraph.eval.alarms import alarms
from conegraph.eval.association_metrics import AssociationMetrics, association_metrics
from conegraph.eval.closure_metrics import ClosureMetrics, closure_metrics
from conegraph.eval.colour_metrics import ORANGES
from conegraph.eval.consistency import (
    InnovationConsistency,
    PoseConsistency,
    innovation_consistency,
    pose_consistency,
)
from conegraph.eval.lap_drift import LapDrifts, lap_drifts
from conegraph.eval.laps import true_laps
from conegraph.eval.map_metrics import MapMetrics, map_metrics
from conegraph.eval.matching import DEFAULT_GATE_M
from conegraph.eval.pose_pairs import PosePairs, pair_with_truth
from conegraph.eval.record import Record
from conegraph.eval.run_metrics import (
    CostMetrics,
    LatencyStats,
    StatusMetrics,
    cost_metrics,
    latency_stats,
    status_metrics,
)
from conegraph.eval.run_warnings import run_warnings, status_warnings
from conegraph.eval.track_metrics import TrackMetrics, track_metrics, true_track
from conegraph.eval.trajectory_metrics import TrajectoryMetrics, trajectory_metrics
from conegraph.eval.truth_faults import (
    Twins,
    in_words,
    truth_faults,
    without_twins,
)
from conegraph.eval.written_track import read_written_track
from conegraph.geometry import between, to_child
from conegraph.io.run_folder import RunFolder
from conegraph.track.files import TRACK
from conegraph.types import (
    IntArray,
    Lap,
    Mask,
    Status,
    Trajectory,
    TruthMap,
)

OBSERVABLE_AFTER = 3
"""A cone that the sensor reported this often is one that a map should hold."""


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
        innovation_consistency: innovations against theirs; None without any.
        lap_drift: how much error each true lap adds; None without a lap.
        track: the track that the run wrote against that of the true cones; None where
            it wrote none, or the true cones are no lane.
        cost: time and memory that the run took.
        truth_faults: true cones that cannot stand where they are said to.
        alarms: what makes all figures worth little, in sentences.
    """

    trajectory: TrajectoryMetrics | None
    smoothed: TrajectoryMetrics | None
    map: MapMetrics | None
    association: AssociationMetrics | None
    closures: ClosureMetrics
    latency_ms: Mapping[str, LatencyStats]
    status: StatusMetrics
    warnings: tuple[str, ...]
    cost: CostMetrics
    pose_consistency: PoseConsistency | None = None
    innovation_consistency: InnovationConsistency | None = None
    lap_drift: LapDrifts | None = None
    track: TrackMetrics | None = None
    truth_faults: tuple[Twins, ...] = ()
    alarms: tuple[str, ...] = ()


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
        FileFormatError: the run's track cannot be read.
    """
    run, unplaced = since_found(run)
    causal = _path_metrics(run.trajectory, truth.trajectory)
    pairs = _pairs(run, truth) if causal is not None else None
    laps = None if causal is None else _true_laps(truth, causal, run.trajectory)
    ids, faults = _sound(truth)
    cones = _map_metrics(run, truth.cones, ids, causal, max_distance_m)
    return RunMetrics(
        trajectory=causal,
        smoothed=_path_metrics(run.smoothed, truth.trajectory),
        map=cones,
        association=_association_metrics(run, ids, faults),
        closures=closure_metrics(run.summary, laps, run.associations, ids),
        latency_ms=latency_stats(run.timing_ms),
        status=status_metrics(run.status),
        warnings=(
            *in_words(faults),
            *run_warnings(run, causal, truth.trajectory),
            *status_warnings(run, unplaced),
        ),
        cost=cost_metrics(run.status.stamp_s, run.timing_ms, run.summary),
        pose_consistency=_pose_consistency(run, causal, pairs),
        innovation_consistency=innovation_consistency(
            run.consistency.nis, run.consistency.dof
        ),
        lap_drift=None if pairs is None else lap_drifts(pairs, laps or ()),
        track=_track_metrics(run, truth.cones, cones, pairs),
        truth_faults=faults,
        alarms=alarms(run),
    )


def _sound(truth: Truth) -> tuple[IntArray | None, tuple[Twins, ...]]:
    """Return the true ids (N,) with one for both of twins, and the twins."""
    ids, cones = truth.observation_ids, truth.cones
    if cones is None:
        return ids, ()
    faults = truth_faults(cones)
    return None if ids is None else without_twins(ids, cones), faults


def _pairs(run: RunFolder, truth: Truth) -> PosePairs | None:
    if truth.trajectory is None:
        return None
    return pair_with_truth(run.trajectory, truth.trajectory)


def _true_laps(
    truth: Truth, causal: TrajectoryMetrics, estimate: Trajectory
) -> tuple[Lap, ...]:
    """Return the true laps within the run's time, the gate put as the run puts it."""
    if truth.trajectory is None:
        return ()
    path, world = truth.trajectory, causal.pose_truth_start
    since, until = np.searchsorted(path.stamp_s, estimate.stamp_s[[0, -1]])
    rows = slice(max(int(since) - 1, 0), int(until) + 1)
    start_m = np.zeros((0, 2))
    if truth.cones is not None:
        oranges = np.isin(truth.cones.cone_class, ORANGES)
        start_m = to_child(world, truth.cones.xy_m[oranges])
    seen = Trajectory(path.stamp_s[rows], between(world, path.pose[rows]))
    return true_laps(seen, start_m)


def _association_metrics(
    run: RunFolder, ids: IntArray | None, faults: tuple[Twins, ...]
) -> AssociationMetrics | None:
    if ids is None:
        return None
    twins = np.array([f.ids for f in faults], dtype=np.int64).ravel()
    return association_metrics(run.associations, ids, twins)


def _map_metrics(
    run: RunFolder,
    truth: TruthMap | None,
    ids: IntArray | None,
    causal: TrajectoryMetrics | None,
    max_distance_m: float,
) -> MapMetrics | None:
    if truth is None:
        return None
    return map_metrics(
        run.cone_map,
        truth,
        start_pose=None if causal is None else causal.pose_truth_start,
        trajectory_pose=None if causal is None else causal.pose_truth_run,
        observable=None if ids is None else _observable(truth, ids),
        max_distance_m=max_distance_m,
    )


def _track_metrics(
    run: RunFolder,
    truth: TruthMap | None,
    cones: MapMetrics | None,
    pairs: PosePairs | None,
) -> TrackMetrics | None:
    """Judge the track that the run wrote at its end, if there is a true one."""
    if truth is None or cones is None or not run.finished:
        return None
    track = read_written_track(run.folder / TRACK)
    if track is None:
        return None
    true = true_track(truth, None if pairs is None else pairs.truth[0])
    if true is None:
        return None
    pose = cones.pose_truth_run
    return track_metrics(track, run.cone_map, truth, true, pose, cones.gate_m)


def since_found(run: RunFolder) -> tuple[RunFolder, int]:
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
    run: RunFolder, causal: TrajectoryMetrics | None, pairs: PosePairs | None
) -> PoseConsistency | None:
    """Judge the causal poses' covariances in the run's own frame, its start."""
    if causal is None or pairs is None or len(run.pose_cov) == 0:
        return None
    true = between(causal.pose_truth_start, pairs.truth)
    return pose_consistency(pairs.estimate, run.pose_cov.at(pairs.stamp_s), true)


def _path_metrics(
    path: Trajectory | None, truth: Trajectory | None
) -> TrajectoryMetrics | None:
    if path is None or truth is None:
        return None
    return trajectory_metrics(path, truth)


def _observable(cones: TruthMap, ids: IntArray) -> Mask:
    """Mark the true cones (M,) that were reported often enough."""
    seen, count = np.unique(ids, return_counts=True)
    return np.isin(without_twins(cones.id, cones), seen[count >= OBSERVABLE_AFTER])
