"""A back end's map against the truth, and against the batch optimum's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.bench.rows import ReferenceMap
from conegraph.bench.run_log import RunLog
from conegraph.eval.align import align_se2
from conegraph.eval.judge import OBSERVABLE_AFTER
from conegraph.eval.map_metrics import MapMetrics, map_metrics
from conegraph.eval.matching import match_cones
from conegraph.eval.reference_graph import StartFrameTruth
from conegraph.eval.trajectory_metrics import trajectory_metrics
from conegraph.geometry import to_parent
from conegraph.types import ConeMap, IntArray, TruthMap


@dataclass(frozen=True, slots=True)
class JudgedMap:
    """A map's figures, and the aligned RMSE of the batch optimum on the same cones."""

    metrics: MapMetrics
    batch_rmse_m: float


class MapJudge:
    """Judges maps in the frame of the car at the first frame."""

    def __init__(self, truth: StartFrameTruth, cone_class: IntArray) -> None:
        """Take the truth and the classes (N,) of its cones, ids ascending."""
        self._truth = truth
        self._cones = TruthMap(truth.cone_id, truth.xy_m, cone_class)

    def judge(
        self,
        cone_map: ConeMap,
        log: RunLog,
        reference: ReferenceMap | None,
        end_s: float = np.inf,
    ) -> JudgedMap:
        """Compare a map, made from the frames up to a stamp, with truth and reference.

        Recall asks for the cones that had been reported often enough until then. The
        ratio to the optimum is one of the same cones: those that the map has found.
        """
        cones = self._cones
        often = log.seen_often(OBSERVABLE_AFTER, end_s)
        path = trajectory_metrics(log.path(end_s), self._truth.trajectory)
        metrics = map_metrics(
            cone_map,
            cones,
            start_pose=np.zeros(3),
            trajectory_pose=None if path is None else path.pose_truth_run,
            observable=np.isin(cones.id, often),
        )
        placed = to_parent(metrics.pose_truth_run, cone_map.xy_m)
        found = np.sort(match_cones(placed, cones.xy_m, metrics.gate_m).truth)
        return JudgedMap(metrics, self._batch_rmse(found, reference))

    def _batch_rmse(self, found: IntArray, reference: ReferenceMap | None) -> float:
        if reference is None:
            return float("nan")
        both = found[np.isin(self._cones.id[found], reference.cone_id)]
        xy = reference.chosen_m(self._cones.id[both])
        return align_se2(xy, self._cones.xy_m[both]).rmse_m
