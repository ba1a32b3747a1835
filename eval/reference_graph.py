"""The factor graph of a whole recording with true associations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from conegraph.backends.factors import (
    ORIGIN_SIGMAS,
    bias_prior,
    bias_walk,
    cone_factors,
    free_motion,
    odometry_motion,
    start_prior,
    start_velocity_prior,
)
from conegraph.backends.graph_builder import pose_array
from conegraph.backends.journal import BIAS_SEGMENT_S
from conegraph.backends.motion import OdometryIncrement, yaw_rate_bias_sigma
from conegraph.backends.odometry_queue import OdometryQueue
from conegraph.backends.solver import solve
from conegraph.config import MotionConfig
from conegraph.eval.pose_pairs import pair_with_truth
from conegraph.geometry import between, to_child
from conegraph.types import (
    Array,
    ConeObservations,
    IntArray,
    Mask,
    Recording,
    SensorModel,
    Trajectory,
    VelocityObservation,
)

ROUNDS = 2
"""Solutions with a bias, each with the odometry linearised where the last one was; a
third moved no cone by more than 0.01 mm."""


@dataclass(frozen=True, slots=True)
class StartFrameTruth:
    """The truth as seen from the car at the first frame.

    Attributes:
        cone_id: (N,) ids, ascending.
        xy_m: (N, 2) positions.
        trajectory: true poses.
    """

    cone_id: IntArray
    xy_m: Array
    trajectory: Trajectory

    def cones_m(self, ids: IntArray) -> Array:
        """Return (k, 2) true positions of the given cones."""
        found: Array = self.xy_m[np.searchsorted(self.cone_id, ids)]
        return found

    def path(self, stamp_s: Array) -> Trajectory:
        """Return the true poses at stamps, which must lie inside the truth."""
        blank = Trajectory(stamp_s, np.zeros((len(stamp_s), 3)))
        pairs = pair_with_truth(blank, self.trajectory)
        if pairs.left_out:
            raise ValueError(f"no true pose at {pairs.left_out} of the frames")
        return Trajectory(stamp_s, pairs.truth)


def truth_of(recording: Recording) -> StartFrameTruth:
    """Return the truth in the frame of the car at the recording's first frame.

    Raises:
        ValueError: the recording does not know the truth.
    """
    path, cones = recording.truth_trajectory, recording.truth_map
    frames = _frames(recording)
    if path is None or cones is None or not frames:
        raise ValueError(f"{recording.name}: no truth to refer to")
    first = np.array([frames[0].stamp_s])
    pairs = pair_with_truth(Trajectory(first, np.zeros((1, 3))), path)
    if pairs.left_out:
        raise ValueError(f"{recording.name}: no true pose at the first frame")
    order = np.argsort(cones.id)
    start = pairs.truth[0]
    return StartFrameTruth(
        cones.id[order],
        to_child(start, cones.xy_m[order]),
        Trajectory(path.stamp_s, between(start, path.pose)),
    )


@dataclass(frozen=True, slots=True)
class Solved:
    """A solution: cones (N,) ascending, their places (N, 2), and the path."""

    cone_id: IntArray
    xy_m: Array
    path: Trajectory


@dataclass(frozen=True, slots=True)
class _Step:
    """Odometry up to frame k, and the stretch of time whose bias it has."""

    k: int
    increment: OdometryIncrement
    segment: int


class ReferenceGraph:
    """All factors of a recording; solutions of it, or of its beginning.

    Frames come in the order of their stamps; of two with one stamp the second is
    left out, as the back ends do. The odometry's bias is constant over 10 s.
    """

    def __init__(self, recording: Recording, motion: MotionConfig) -> None:
        """Build the factors.

        Raises:
            ValueError: the recording lacks truth or sensor, or frames lack ids.
        """
        sensor = recording.sensor
        if sensor is None:
            raise ValueError(f"{recording.name}: its sensor is not known")
        self.truth = truth_of(recording)
        self._frames = _frames(recording)
        self._motion = _with_known_bias(motion, recording)
        self._has_bias = yaw_rate_bias_sigma(self._motion) > 0.0
        stamps = np.array([f.stamp_s for f in self._frames])
        self._path = self.truth.path(stamps)
        self._moves = list(self._all_moves(_queue(recording, self._motion)))
        self._ids = [np.asarray(f.truth_id)[self._is_true(f)] for f in self._frames]
        self._cones = [self._cones_of(k, f, sensor) for k, f in enumerate(self._frames)]

    def optimum(self, end_s: float = np.inf) -> Solved:
        """Solve for what had been seen up to a stamp."""
        n = int(np.searchsorted(self._path.stamp_s, end_s, side="right"))
        values = self._true_values(n)
        for _ in range(ROUNDS if self._segments(n) else 1):
            graph = self._graph(n, values)
            # Farther than a back end would care to.
            values = solve(graph, values, iterations=50, tolerance=1e-9)
        ids = self._seen(n)
        xy = np.array([values.atPoint2(L(c)) for c in ids.tolist()]).reshape(-1, 2)
        poses = [pose_array(values.atPose2(X(k))) for k in range(n)]
        pose = np.array(poses).reshape(-1, 3)
        return Solved(ids, xy, Trajectory(self._path.stamp_s[:n], pose))

    def covariances(self) -> tuple[IntArray, Array, Array]:
        """Linearise at the truth and invert.

        Returns:
            Ids (N,) of the cones ascending, their joint covariance (2N, 2N), and the
            variance (F,) of each frame's position, the sum over x and y.
        """
        n = len(self._frames)
        values = self._true_values(n)
        marginals = gtsam.Marginals(self._graph(n, values), values)
        ids = self._seen(n)
        keys = [L(c) for c in ids.tolist()]
        cov = np.asarray(marginals.jointMarginalCovariance(keys).fullMatrix())
        position = [
            np.trace(marginals.marginalCovariance(X(k))[:2, :2]) for k in range(n)
        ]
        return ids, cov, np.array(position)

    def causal_cov(self, k: int) -> Array:
        """Return the covariance (3, 3) of frame k's pose given all up to that frame.

        Linearised at the truth.
        """
        values = self._true_values(k + 1)
        marginals = gtsam.Marginals(self._graph(k + 1, values), values)
        return np.asarray(marginals.marginalCovariance(X(k)))

    @property
    def stamp_s(self) -> Array:
        """(F,) stamps of the frames."""
        return self._path.stamp_s

    def _all_moves(
        self, queue: OdometryQueue | None
    ) -> Iterator[_Step | list[gtsam.NonlinearFactor]]:
        """Yield what joins each frame to the one before: odometry or free motion."""
        stamps = self._path.stamp_s
        if queue is not None and len(stamps):
            queue.samples(float(stamps[0]))
        for k in range(1, len(stamps)):
            before_s, now_s = float(stamps[k - 1]), float(stamps[k])
            increment = None if queue is None else queue.take(before_s, now_s)
            if increment is None:
                moved = between(self._path.pose[k - 1], self._path.pose[k])
                speed_mps = float(moved[0]) / (now_s - before_s)
                yield free_motion(k, before_s, now_s, speed_mps, self._motion)
            else:
                yield _Step(k, increment, self._segment(now_s))

    def _segment(self, stamp_s: float) -> int:
        return int((stamp_s - self._path.stamp_s[0]) // BIAS_SEGMENT_S)

    def _cones_of(
        self, k: int, frame: ConeObservations, sensor: SensorModel
    ) -> list[gtsam.NonlinearFactor]:
        """Return the factors of a frame's true cones, noise at their true places."""
        rows, ids = np.flatnonzero(self._is_true(frame)), self._ids[k]
        there = to_child(self._path.pose[k], self.truth.cones_m(ids))
        cov = sensor.covariance(there)
        return list(cone_factors(k, ids, frame.xy_m[rows], cov, [None] * len(rows)))

    def _is_true(self, frame: ConeObservations) -> Mask:
        if frame.truth_id is None:
            raise ValueError("a frame without true ids")
        return np.isin(frame.truth_id, self.truth.cone_id)

    def _seen(self, n: int) -> IntArray:
        none = np.zeros(0, dtype=np.int64)
        return np.unique(np.concatenate([none, *self._ids[:n]]))

    def _steps(self, n: int) -> list[_Step]:
        return [
            move for move in self._moves[: max(n - 1, 0)] if isinstance(move, _Step)
        ]

    def _free(self, n: int) -> list[int]:
        """Return the frames that have a velocity: the ends of free steps."""
        free = {
            k
            for k, move in enumerate(self._moves[: max(n - 1, 0)], start=1)
            if not isinstance(move, _Step)
        }
        return sorted(free | {k - 1 for k in free})

    def _true_values(self, n: int) -> gtsam.Values:
        values = gtsam.Values()
        poses = self._path.pose
        for k in range(n):
            values.insert(X(k), gtsam.Pose2(*poses[k]))
        ids = self._seen(n)
        for cone, xy in zip(ids.tolist(), self.truth.cones_m(ids), strict=True):
            values.insert(L(cone), xy)
        for k in self._free(n):
            a, b = max(k - 1, 0), min(k + 1, len(poses) - 1)
            step = between(poses[a], poses[b])
            twist = step / (self._path.stamp_s[b] - self._path.stamp_s[a])
            values.insert(V(k), np.array([twist[0], 0.0, twist[2]]))
        for segment in self._segments(n):
            values.insert(B(segment), np.zeros(1))
        return values

    def _segments(self, n: int) -> range:
        """Return the stretches of time with a bias, none where there is no bias."""
        steps = self._steps(n) if self._has_bias else []
        return range(steps[-1].segment + 1) if steps else range(0)

    def _graph(self, n: int, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
        """Join the factors of the first n frames, odometry linearised at the values."""
        graph = gtsam.NonlinearFactorGraph()
        graph.add(start_prior(ORIGIN_SIGMAS))
        for factors in self._cones[:n]:
            for factor in factors:
                graph.add(factor)
        for move in self._moves[: max(n - 1, 0)]:
            if isinstance(move, _Step):
                graph.add(self._odometry(move, values))
            else:
                for factor in move:
                    graph.add(factor)
        self._add_priors(graph, n)
        return graph

    def _odometry(self, step: _Step, values: gtsam.Values) -> gtsam.NonlinearFactor:
        before = pose_array(values.atPose2(X(step.k - 1)))
        bias = None
        if self._has_bias:
            bias = step.segment, float(values.atVector(B(step.segment))[0])
        return odometry_motion(step.k, step.increment, before, bias)

    def _add_priors(self, graph: gtsam.NonlinearFactorGraph, n: int) -> None:
        """Add what is known of biases and of the velocity where free motion starts."""
        segments = self._segments(n)
        if segments:
            graph.add(bias_prior(yaw_rate_bias_sigma(self._motion)))
        for segment in segments[1:]:
            graph.add(bias_walk(segment, BIAS_SEGMENT_S, self._motion.gyro_bias_walk))
        free = self._free(n)
        if free:
            k = free[0]
            dt_s = float(self._path.stamp_s[k + 1] - self._path.stamp_s[k])
            graph.add(start_velocity_prior(k, dt_s, np.zeros(2), self._motion))


def _frames(recording: Recording) -> list[ConeObservations]:
    frames = [e for e in recording.stream if isinstance(e, ConeObservations)]
    by_stamp = {f.stamp_s: f for f in reversed(frames)}
    return [by_stamp[stamp] for stamp in sorted(by_stamp)]


def _queue(recording: Recording, motion: MotionConfig) -> OdometryQueue | None:
    samples = [e for e in recording.stream if isinstance(e, VelocityObservation)]
    if not samples or not motion.use_odometry:
        return None
    queue = OdometryQueue(motion)
    for sample in sorted(samples, key=lambda v: v.stamp_s):
        queue.push(sample)
    return queue


def _with_known_bias(motion: MotionConfig, recording: Recording) -> MotionConfig:
    """Fill in the bias's sigma where the recording knows it and nobody set it."""
    known = recording.yaw_rate_bias_radps
    if motion.gyro_bias_sigma_radps is not None or known is None:
        return motion
    return motion.model_copy(update={"gyro_bias_sigma_radps": known})
