"""What the data allow: the batch optimum with true associations.

Accuracies of the back ends are read as ratios to it, so that a figure says how good
the estimator is and not how good the sensor or how kind the track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.config import MotionConfig
from conegraph.eval.align import align_se2, distance, rms
from conegraph.eval.reference_graph import ReferenceGraph, Solved, truth_of
from conegraph.types import Array, IntArray, Mask, Recording, Trajectory


@dataclass(frozen=True, slots=True)
class ReferenceSolution:
    """The batch optimum and the truth, both in the frame of the first true pose.

    Attributes:
        cone_id: (N,) ids of the cones that were seen, ascending.
        xy_m: (N, 2) their optimal positions.
        true_xy_m: (N, 2) their true positions.
        path: the optimal pose at every frame.
        true_path: the true pose at every frame.
    """

    cone_id: IntArray
    xy_m: Array
    true_xy_m: Array
    path: Trajectory
    true_path: Trajectory

    def map_rmse_aligned_m(self, ids: IntArray | None = None) -> float:
        """Return the RMSE of the map after the rigid motion that fits it best.

        Args:
            ids: only these cones count, both for the fit and for the error; all by
                default. Ids that were never seen are left out.
        """
        keep = self._kept(ids)
        return align_se2(self.xy_m[keep], self.true_xy_m[keep]).rmse_m

    def map_rmse_m(self) -> float:
        """Return the RMSE of the map in the start frame."""
        return rms(distance(self.xy_m, self.true_xy_m))

    def pose_rmse_m(self) -> float:
        """Return the RMSE of the positions of the path in the start frame."""
        return rms(distance(self.path.pose[:, :2], self.true_path.pose[:, :2]))

    def _kept(self, ids: IntArray | None) -> Mask:
        if ids is None:
            return np.ones(len(self.cone_id), dtype=np.bool_)
        return np.isin(self.cone_id, ids)


@dataclass(frozen=True, slots=True)
class CramerRao:
    """Lower bounds on root mean square errors, and the covariance they come from.

    Attributes:
        cone_id: (N,) ids of the cones that were seen, ascending.
        cov_m2: (2N, 2N) joint covariance of the cones in the start frame.
        map_rmse_aligned_m: ``sqrt(tr(P C P) / N)``, P taking out rigid motions.
        map_rmse_m: ``sqrt(tr(C) / N)``, in the start frame.
        pose_rmse_m: likewise of the path's positions, in the start frame.
        aligned_mse_sigma_m2: standard deviation of the aligned mean squared error
            of one drive, ``sqrt(2 tr((P C P)^2)) / N``: what a measured ratio may
            differ by.
    """

    cone_id: IntArray
    cov_m2: Array
    map_rmse_aligned_m: float
    map_rmse_m: float
    pose_rmse_m: float
    aligned_mse_sigma_m2: float


def batch_optimum(
    recording: Recording, motion: MotionConfig | None = None
) -> ReferenceSolution:
    """Return the most probable path and map, given all data and the true ids.

    Levenberg-Marquardt over a pose at every frame and all cones, with the factors of
    the graph back end: no robust kernels, the sensor's covariance evaluated where
    the cone truly is (from the noisy range near cones weigh too much and the map
    shrinks), odometry with its yaw-rate bias where the recording has it and white
    noise on acceleration elsewhere. It starts from the truth, being a reference.

    Args:
        recording: a stream with truth ids, true poses and true cones; its sensor.
        motion: the motion model, the default one if left out.

    Raises:
        ValueError: the recording lacks truth or sensor.
    """
    graph = ReferenceGraph(recording, motion or MotionConfig())
    return _solution(graph, graph.optimum())


def prefix_optima(
    recording: Recording, ends_s: Sequence[float], motion: MotionConfig | None = None
) -> list[ReferenceSolution]:
    """Return `batch_optimum` of what had been seen up to each of the stamps."""
    graph = ReferenceGraph(recording, motion or MotionConfig())
    return [_solution(graph, graph.optimum(end_s)) for end_s in ends_s]


def cramer_rao(recording: Recording, motion: MotionConfig | None = None) -> CramerRao:
    """Return the Cramér-Rao bound of the graph of `batch_optimum`.

    The information matrix is that of the graph linearised at the truth, the first
    pose held as the back ends hold it. With C the covariance of the N cones, an
    unbiased estimate has at least ``E |e|^2 = tr(C)``. Aligning takes away the part
    of e that a translation or a small rotation of the true map explains: with Q an
    orthonormal basis of these three directions and ``P = I - Q Q'``,
    ``E |P e|^2 = tr(P C P)``.

    The prior on the motion takes part (a Bayesian bound): with odometry it is what
    the wheels measure, without it is what a car can do.

    Raises:
        ValueError: the recording lacks truth or sensor.

    Source: H. Van Trees, "Detection, Estimation, and Modulation Theory", 1968,
    section 2.4.
    """
    graph = ReferenceGraph(recording, motion or MotionConfig())
    ids, cov, position_var = graph.covariances()
    xy = truth_of(recording).cones_m(ids)
    fitted = without_rigid_motion(cov, xy)
    n = max(len(ids), 1)
    return CramerRao(
        cone_id=ids,
        cov_m2=cov,
        map_rmse_aligned_m=float(np.sqrt(np.trace(fitted) / n)),
        map_rmse_m=float(np.sqrt(np.trace(cov) / n)),
        pose_rmse_m=float(np.sqrt(np.mean(position_var))),
        aligned_mse_sigma_m2=float(np.sqrt(2.0 * np.sum(fitted**2)) / n),
    )


def causal_bound(
    recording: Recording, count: int, motion: MotionConfig | None = None
) -> tuple[Array, Array]:
    """Return the Cramér-Rao bound on the position of a car that cannot look ahead.

    At each of some frames, evenly spread, the bound of `cramer_rao` for that frame's
    position in the start frame given the frames up to it and no later ones:
    ``sqrt(tr C_xy)``. No unbiased estimator that drives by its own estimate does
    better.

    Returns:
        Stamps (count,) and bounds (count,) in m.

    Raises:
        ValueError: the recording lacks truth or sensor.
    """
    graph = ReferenceGraph(recording, motion or MotionConfig())
    ends = np.linspace(0, len(graph.stamp_s) - 1, count + 1)[1:].astype(np.int64)
    bounds = [np.sqrt(np.trace(graph.causal_cov(k)[:2, :2])) for k in ends.tolist()]
    return graph.stamp_s[ends], np.array(bounds)


def without_rigid_motion(cov_m2: Array, xy_m: Array) -> Array:
    """Return ``P C P``: the covariance of what a best rigid fit leaves.

    Args:
        cov_m2: (2N, 2N) joint covariance of N points, x and y in turn.
        xy_m: (N, 2) where the points are.
    """
    n = len(xy_m)
    centred = xy_m - xy_m.mean(axis=0)
    turn = np.column_stack([-centred[:, 1], centred[:, 0]]).ravel()
    shift = np.tile(np.eye(2), (n, 1))
    basis, _ = np.linalg.qr(np.column_stack([shift, turn]))
    projector = np.eye(2 * n) - basis @ basis.T
    fitted: Array = projector @ cov_m2 @ projector
    return fitted


def _solution(graph: ReferenceGraph, solved: Solved) -> ReferenceSolution:
    truth = graph.truth
    return ReferenceSolution(
        solved.cone_id,
        solved.xy_m,
        truth.cones_m(solved.cone_id),
        solved.path,
        truth.path(solved.path.stamp_s),
    )
