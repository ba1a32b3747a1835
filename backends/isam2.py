"""The factor-graph back end: tracked by a local filter, mapped by iSAM2."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from conegraph.backends.mapper import Mapper
from conegraph.backends.snapshot import take_snapshot
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.backends.tracker import Tracker
from conegraph.config import Config, Isam2Config
from conegraph.types import (
    Associations,
    ConeMap,
    ConeObservations,
    Estimate,
    LoopClosure,
    SensorModel,
    Trajectory,
)

FEW_SIGHTINGS = 10
"""Sightings that are worth a graph update; sparse streams wait for as many."""

MANY_FRAMES = 60
"""Frames after which the graph is updated even so."""


class Isam2Backend(Tracker):
    """A tracker in the frame path and a factor graph behind it.

    Every frame is tracked at once by the filter that the EKF uses too, restricted
    to the cones near the car. Frames with all their measurements are queued; every
    `update_period_s` the graph takes them in, and its solution replaces what the
    tracker holds. Associations are made with the joint covariance of the car and
    the visible cones that the graph gave.
    """

    def __init__(
        self,
        config: Config,
        sensor: SensorModel | None,
        known_map: ConeMap | None = None,
        *,
        add_cones: bool = True,
    ) -> None:
        """Start at the origin with an empty graph, or on a known map."""
        super().__init__(config, sensor, known_map, add_cones=add_cones)
        if not isinstance(config.backend, Isam2Config):
            raise TypeError("Isam2Backend needs a configuration of kind isam2")
        self._graph_config = config.backend
        self.mapper = Mapper(config.backend, config.motion, known_map)
        self._waiting: list[TrackedFrame] = []
        self._updated_s = -np.inf
        self._pose_cov = np.zeros((3, 3))
        self._anchor_m = np.zeros(2)

    def observe_cones(self, frame: ConeObservations) -> Associations | None:
        """Track a frame; now and then let the graph take in what is waiting."""
        result = super().observe_cones(frame)
        if result is None or self.tracked is None:
            return None
        self._waiting.append(self.tracked)
        began = time.perf_counter()
        if self._is_due(self.tracked):
            self._update_graph()
        spent_ms = 1e3 * (time.perf_counter() - began)
        stages = {**(self.last_events.stage_ms or {}), "graph": spent_ms}
        self.last_events = replace(self.last_events, stage_ms=stages)
        return result

    def estimate(self) -> Estimate:
        """Return the tracker's estimate with the pose's uncertainty in the world.

        The tracker's own covariance counts from the last graph update on; what the
        graph said of the pose then is added, its heading at the distance since.
        """
        local = super().estimate()
        ahead = local.pose[:2] - self._anchor_m
        lever = np.eye(3)
        lever[0, 2], lever[1, 2] = -ahead[1], ahead[0]
        world = lever @ self._pose_cov @ lever.T
        return replace(local, pose_cov=local.pose_cov + world)

    def finish(self) -> Trajectory | None:
        """Solve the whole graph to convergence and take its map over."""
        if self._waiting:
            self._update_graph()
        if len(self.mapper.journal) == 0:
            return None
        try:
            path = self.mapper.settle(polish=self._graph_config.polish)
            if path is not None:
                self._take_map()
        except (RuntimeError, np.linalg.LinAlgError):
            return None
        return path

    def _take_map(self) -> None:
        """Take places and covariances of all cones from the settled graph."""
        book, mapper = self.map.book, self.mapper
        found = {
            row: (mapper.cone_m(cone), mapper.cone_cov_m2(cone))
            for row, cone in enumerate(book.id.tolist())
            if cone in mapper.cones
        }
        self.map.release()
        for row, (xy, cov) in found.items():
            book.xy_m[row], book.cov_m2[row] = xy, cov

    def _is_due(self, newest: TrackedFrame) -> bool:
        if newest.closure or len(self._waiting) >= MANY_FRAMES:
            return True
        late = newest.stamp_s - self._updated_s >= self._graph_config.update_period_s
        return late and sum(len(f.landmark_id) for f in self._waiting) >= FEW_SIGHTINGS

    def _update_graph(self) -> None:
        """Let the graph take in the waiting frames and load what it then believes.

        gtsam's errors end here: a solver that cannot be read is rebuilt, and once
        the graph has no solution at all the tracker goes on alone.
        """
        frames, self._waiting = self._waiting, []
        self._updated_s = frames[-1].stamp_s
        if self.mapper.failed:
            return
        try:
            retractions = self.mapper.update(frames)
            if not self.mapper.failed:
                self._load_snapshot()
        except (RuntimeError, np.linalg.LinAlgError):
            self.mapper.mend()
            return
        if retractions:
            undone = tuple(
                LoopClosure(
                    r.stamp_s, 0.0, False, f"undone: residual d2 {np.median(r.d2):.0f}"
                )
                for r in retractions
                if r.closure
            )
            events = self.last_events
            self.last_events = replace(events, closures=events.closures + undone)

    def _load_snapshot(self) -> None:
        snapshot = take_snapshot(
            self.mapper,
            self.sensor.max_range_m + self._graph_config.snapshot_margin_m,
        )
        self._pose_cov = snapshot.pose_cov
        self._anchor_m = snapshot.state[:2]
        self.map.load(
            snapshot.state,
            snapshot.cov,
            snapshot.ids,
            snapshot.all_ids,
            snapshot.all_xy_m,
        )
