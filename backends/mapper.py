"""The factor graph behind the tracker: every frame, solved by iSAM2.

(Kaess, Johannsson, Roberts, Ila, Leonard, Dellaert, "iSAM2: Incremental smoothing
and mapping using the Bayes tree", IJRR 2012.)
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from conegraph.backends.factors import (
    KNOWN_MAP_SIGMAS,
    ORIGIN_SIGMAS,
    bias_prior,
    bias_walk,
    cone_factors,
    free_motion,
    known_cone_prior,
    odometry_motion,
    one_cone,
    start_prior,
    velocity_prior,
)
from conegraph.backends.motion import NV, OdometryIncrement, yaw_rate_bias_sigma
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.config import Isam2Config, MotionConfig
from conegraph.geometry import to_child, to_parent
from conegraph.types import Array, ConeMap, Trajectory

log = logging.getLogger(__name__)

WILDFIRE = 1e-3
"""Smallest change that is passed on through the tree."""

BIAS_SEGMENT_S = 10.0
"""Length of a stretch of time with one yaw-rate bias."""

POLISH_ROUNDS = 2
"""Linearisations of odometry with a bias in the final solution."""

CLOSURE_D2 = 25.0
"""A closure whose factors end up farther off than this, on average, is undone."""


@dataclass(frozen=True, slots=True)
class Retraction:
    """A loop closure that did not stand the test after the fact."""

    stamp_s: float
    d2: float


class Mapper:
    """Feeds tracked frames into iSAM2 and reads estimates back."""

    def __init__(
        self, config: Isam2Config, motion: MotionConfig, known: ConeMap | None = None
    ) -> None:
        """Start with an empty graph, or with the cones of a known map."""
        self._config, self._motion = config, motion
        bias_sigma = yaw_rate_bias_sigma(motion)
        self.has_bias = bias_sigma > 0.0
        self.isam = _new_isam()
        self.stamps_s: list[float] = []
        self.cones: dict[int, int] = {}
        self.velocities: set[int] = set()
        self.rebuilt = 0
        self.failed = False
        self.segment = 0
        self._segment_s = -np.inf
        self._graph = gtsam.NonlinearFactorGraph()
        self._first = gtsam.Values()
        self._removed: set[int] = set()
        self._sightings: Counter[int] = Counter()
        self._new = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._closing: list[tuple[TrackedFrame, int, list[int]]] = []
        self._last_state = np.zeros(NV)
        self._odometry: list[tuple[int, int, OdometryIncrement, int]] = []
        self._new.add(start_prior(ORIGIN_SIGMAS if known is None else KNOWN_MAP_SIGMAS))
        if self.has_bias:
            self._new.add(bias_prior(bias_sigma))
            self._new_values.insert(B(0), np.zeros(1))
        if known is not None:
            for cone, xy, cov in zip(
                known.id.tolist(), known.xy_m, known.cov_m2, strict=True
            ):
                self._new.add(known_cone_prior(cone, xy, cov))
                self._insert_cone(cone, xy)

    def update(self, frames: Sequence[TrackedFrame]) -> list[Retraction]:
        """Add frames and solve; return closures that had to be undone.

        A solver that throws is thrown away: the whole graph is solved anew in
        batch from the tracker's own estimates, and if that fails too, without the
        frames' cones.
        """
        for frame in frames:
            self._add(frame)
        first_new = self._graph.size()
        for n in range(self._new.size()):
            self._graph.add(self._new.at(n))
        self._first.insert(self._new_values)
        try:
            self.isam.update(self._new, self._new_values)
            self.isam.calculateEstimatePose2(X(len(self.stamps_s) - 1))
        except RuntimeError as error:
            log.warning("iSAM2: %s; solving the graph anew", _short(error))
            self._rebuild(first_new)
        self._new = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        return [] if self.failed else self._verify()

    def _add(self, frame: TrackedFrame) -> None:
        k = len(self.stamps_s)
        self.stamps_s.append(frame.stamp_s)
        if k == 0:
            self._segment_s = frame.stamp_s
        pose = frame.state[:3]
        self._new_values.insert(X(k), gtsam.Pose2(*pose))
        if k > 0:
            self._join(k, frame)
        for cone, xy in zip(frame.landmark_id.tolist(), frame.xy_m, strict=True):
            if cone not in self.cones:
                self._insert_cone(cone, to_parent(pose, xy[None])[0])
        self._sightings.update(frame.landmark_id.tolist())
        begin = self._graph.size() + self._new.size()
        for factor in cone_factors(
            k, frame.landmark_id, frame.xy_m, frame.cov_m2, self._kernels(frame)
        ):
            self._new.add(factor)
        if frame.closure:
            end = self._graph.size() + self._new.size()
            self._closing.append((frame, k, list(range(begin, end))))
        for kept, gone in frame.merged:
            if kept in self.cones and gone in self.cones:
                self._new.add(one_cone(kept, gone))
        self._last_state = frame.state

    def _kernels(self, frame: TrackedFrame) -> list[float | None]:
        """Return each sighting's kernel width.

        Cones found again after a drift were tested as a constellation and pull
        without a kernel: one would see the drift as an outlier and let go.
        """
        plain = self._config.robust_kernel == "none"
        width = self._config.robust_width
        return [None if plain or found else width for found in frame.vague.tolist()]

    def _join(self, k: int, frame: TrackedFrame) -> None:
        """Add the motion between the last frame and this one."""
        if frame.increment is not None:
            bias = self._bias(frame) if self.has_bias else None
            if bias is not None:
                place = self._graph.size() + self._new.size()
                self._odometry.append((place, k, frame.increment, bias[0]))
            before = self._last_state[:3]
            self._new.add(odometry_motion(k, frame.increment, before, bias))
            return
        u, r = self._last_state[3:5]
        if k - 1 not in self.velocities:
            self._new_values.insert(V(k - 1), np.array([u, 0.0, r]))
            self.velocities.add(k - 1)
            doubt = self._motion.start_speed_sigma_mps
            sigmas = np.array([max(doubt, 0.01), max(0.2 * doubt, 0.01)])
            self._new.add(velocity_prior(k - 1, np.array([u, r]), sigmas))
        self._new_values.insert(V(k), np.array([frame.state[3], 0.0, frame.state[4]]))
        self.velocities.add(k)
        before_s = self.stamps_s[k - 1]
        for factor in free_motion(k, before_s, frame.stamp_s, self._motion):
            self._new.add(factor)

    def _bias(self, frame: TrackedFrame) -> tuple[int, float]:
        """Return the segment of the yaw-rate bias and its value in the tracker."""
        value = float(frame.state[5])
        elapsed_s = frame.stamp_s - self._segment_s
        if elapsed_s > BIAS_SEGMENT_S:
            self.segment += 1
            self._segment_s = frame.stamp_s
            walk = self._motion.gyro_bias_walk
            self._new.add(bias_walk(self.segment, elapsed_s, walk))
            self._new_values.insert(B(self.segment), np.array([value]))
        return self.segment, value

    def _insert_cone(self, cone: int, xy_m: Array) -> None:
        self.cones[cone] = len(self.cones)
        self._new_values.insert(L(cone), xy_m)

    def _rebuild(self, trusted: int) -> None:
        """Solve everything again, at worst without the newest cones.

        If even that fails the graph is given up: `failed` is set, and what it last
        believed is all that it will ever say.
        """
        self.rebuilt += 1
        for first_new in (self._graph.size(), trusted):
            try:
                self._restart(self._live(first_new))
            except RuntimeError as error:
                log.warning("batch: %s", _short(error))
            else:
                return
        log.warning("the factor graph has no solution; going on without it")
        self.failed = True

    def _live(self, trusted: int) -> gtsam.NonlinearFactorGraph:
        """Return the factors not undone; past `trusted` only those of the motion."""
        graph = gtsam.NonlinearFactorGraph()
        for n in range(self._graph.size()):
            factor = self._graph.at(n)
            cone = isinstance(factor, gtsam.BearingRangeFactor2D)
            if n not in self._removed and (n < trusted or not cone):
                graph.add(factor)
        return graph

    def _restart(self, graph: gtsam.NonlinearFactorGraph) -> None:
        keys = set(graph.keyVector())
        values = gtsam.Values(self._first)
        every = list(values.keys())
        for key in every:
            if key not in keys:
                values.erase(key)
        isam = _new_isam()
        isam.update(graph, solve(graph, values))
        self.isam, self._graph, self._first = isam, graph, values
        self._removed, self._closing, self._odometry = set(), [], []
        self.cones = {c: n for c, n in self.cones.items() if L(c) in keys}

    def _verify(self) -> list[Retraction]:
        """Test closures against the solved graph and undo those that do not fit.

        A wrong closure that a robust kernel has let go of shows as residuals far
        outside their noise, where a right one has been pulled together.
        """
        undone = []
        for frame, k, index in self._closing:
            pose = self.pose(k)
            cones = np.array([self.cone_m(c) for c in frame.landmark_id.tolist()])
            residual = frame.xy_m - to_child(pose, cones)
            white = np.linalg.solve(frame.cov_m2, residual[..., None])[..., 0]
            d2 = float(np.median((residual * white).sum(axis=1)))
            if d2 > CLOSURE_D2:
                undone.append(Retraction(frame.stamp_s, d2))
                self._remove(frame, index)
        self._closing = []
        return undone

    def _remove(self, frame: TrackedFrame, index: list[int]) -> None:
        """Take a frame's cone factors out, save those that alone hold a cone."""
        gone = [
            n
            for n, cone in zip(index, frame.landmark_id.tolist(), strict=True)
            if self._sightings[cone] > 1
        ]
        self._removed.update(gone)
        self._sightings.subtract(
            cone
            for n, cone in zip(index, frame.landmark_id.tolist(), strict=True)
            if n in self._removed
        )
        self.isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), gone)

    def pose(self, k: int) -> Array:
        """(3,) pose of frame k as the graph has it now."""
        return _as_array(self.isam.calculateEstimatePose2(X(k)))

    def cone_m(self, cone: int) -> Array:
        """(2,) a cone as the graph has it now."""
        return np.asarray(self.isam.calculateEstimatePoint2(L(cone)))

    def settle(self, *, polish: bool) -> Trajectory | None:
        """Solve to convergence if asked; return the whole path, None if failed.

        iSAM2 ends where its thresholds let it; three forced relinearisations used
        to move a map by 0.3 m.
        """
        if self.failed:
            return None
        values = self.isam.calculateEstimate()
        if polish:
            try:
                for _ in range(POLISH_ROUNDS if self._odometry else 1):
                    graph = self._at(values)
                    values = solve(graph, values)
                isam = _new_isam()
                isam.update(graph, values)
                self.isam = isam
            except RuntimeError as error:
                log.warning("batch: %s; keeping what iSAM2 had", _short(error))
        poses = [_as_array(values.atPose2(X(k))) for k in range(len(self.stamps_s))]
        return Trajectory(np.array(self.stamps_s), np.array(poses).reshape(-1, 3))

    def _at(self, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
        """Return the live factors, odometry with a bias linearised at the values.

        Where the tracker was when it made them, these are off by half the square of
        the turn that closures have given the map since, step after step.
        """
        stale = {place for place, _, _, _ in self._odometry}
        graph = gtsam.NonlinearFactorGraph()
        for n in range(self._graph.size()):
            if n not in self._removed and n not in stale:
                graph.add(self._graph.at(n))
        for _, k, increment, segment in self._odometry:
            before = _as_array(values.atPose2(X(k - 1)))
            bias = float(values.atVector(B(segment))[0])
            graph.add(odometry_motion(k, increment, before, (segment, bias)))
        return graph

    def mend(self) -> None:
        """Replace a solver that turned out to be unusable when it was read."""
        self._rebuild(self._graph.size())

    def cone_cov_m2(self, cone: int) -> Array:
        """(2, 2) covariance of a cone in the world."""
        return np.asarray(self.isam.marginalCovariance(L(cone)))


def solve(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Solve a graph in batch by Levenberg-Marquardt."""
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(30)
    params.setRelativeErrorTol(1e-6)
    params.setlambdaInitial(1e-9)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


def _short(error: Exception) -> str:
    """Return gtsam's complaint without its page of advice."""
    text = " ".join(str(error).split())
    return text.split(" Thrown when")[0]


def _as_array(pose: gtsam.Pose2) -> Array:
    return np.array([pose.x(), pose.y(), pose.theta()])


def _new_isam() -> gtsam.ISAM2:
    """Return a solver with thresholds by kind of variable, in m and rad.

    Velocities enter almost linearly and are never linearised anew; one scalar
    threshold for all variables makes the median update twelve times slower.
    """
    thresholds = gtsam.ISAM2ThresholdMap()
    thresholds.insert(("x", np.array([0.05, 0.05, 0.005])))
    thresholds.insert(("l", np.array([0.05, 0.05])))
    thresholds.insert(("v", np.array([1e3, 1e3, 1e3])))
    thresholds.insert(("b", np.array([5e-4])))
    params = gtsam.ISAM2Params()
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(WILDFIRE))
    params.setRelinearizeThreshold(thresholds)
    params.relinearizeSkip = 1
    params.findUnusedFactorSlots = False
    return gtsam.ISAM2(params)
