"""The factor-graph back end: tracked by a local filter, mapped by iSAM2."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from conegraph.backends.base import FrameEvents
from conegraph.backends.mapper import Mapper
from conegraph.backends.mapping import InlineMapping, Mapped, Mapping, Settled
from conegraph.backends.mapping_process import ProcessMapping
from conegraph.backends.snapshot import Snapshot
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.backends.tracker import Tracker
from conegraph.config import Config, Isam2Config
from conegraph.types import (
    Associations,
    ConeMap,
    ConeObservations,
    Estimate,
    IntArray,
    LoopClosure,
    Revision,
    SensorModel,
    Trajectory,
)

FEW_SIGHTINGS = 10
"""Sightings that are worth a graph update; sparse streams wait for as many."""

MANY_FRAMES = 60
"""Frames after which the graph is updated even so."""

EDGE_M = 4.0
"""Cones this far beyond the sensor's range must be at hand."""

OLDEST_SNAPSHOT = 45
"""Frames since a snapshot after which it is not worth going back to."""


class Isam2Backend(Tracker):
    """A tracker in the frame path and a factor graph behind it.

    Every frame is tracked at once by the filter that the EKF uses too, restricted
    to the cones near the car. Frames with all their measurements are queued; every
    `update_period_s` the graph takes them in, and its solution replaces what the
    tracker holds: where the graph works in its own process, the frames that came
    meanwhile are gone through again. Associations are made with the joint
    covariance of the car and the visible cones that the graph gave.
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
        self._graph_config = graph = config.backend
        radius_m = self.sensor.max_range_m + graph.snapshot_margin_m
        self.mapping: Mapping
        if graph.mapping == "process":
            self.mapping = ProcessMapping(
                graph, config.motion, known_map, self._noise_model(), radius_m
            )
        else:
            mapper = Mapper(graph, config.motion, known_map, self._noise_model())
            self.mapping = InlineMapping(mapper, radius_m)
        self._frames = 0
        self._waiting: list[TrackedFrame] = []
        self._since: deque[TrackedFrame] = deque(maxlen=OLDEST_SNAPSHOT)
        self._undone: list[Revision] = []
        self._updated_s = -np.inf
        self._pose_cov = np.zeros((3, 3))
        self._anchor_m = np.zeros(2)

    def observe_cones(self, frame: ConeObservations) -> Associations | None:
        """Track a frame; now and then let the graph take in what is waiting."""
        began = time.perf_counter()
        self._take(self.mapping.poll())
        self.map.fetch(self.sensor.max_range_m + EDGE_M)
        spent_s = time.perf_counter() - began
        result = super().observe_cones(frame)
        if result is None or self.tracked is None:
            return None
        self._frames += 1
        self._waiting.append(self.tracked)
        self._since.append(self.tracked)
        began = time.perf_counter()
        if self._is_due(self.tracked) and not self.mapping.busy:
            self._take(self.mapping.poll())
            frames, self._waiting = self._waiting, []
            self._updated_s = self.tracked.stamp_s
            self.mapping.submit(frames)
            self._take(self.mapping.poll())
        spent_s += time.perf_counter() - began
        undone, self._undone = tuple(self._undone), []
        stages = {**(self.last_events.stage_ms or {}), "graph": 1e3 * spent_s}
        self.last_events = replace(
            self.last_events,
            closures=self.last_events.closures + _undone_closures(undone),
            revisions=undone,
            stage_ms=stages,
        )
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
            self.mapping.submit(self._waiting)
            self._waiting = []
        self.last_events = FrameEvents()
        settled = self.mapping.finish(polish=self._graph_config.polish)
        if settled is None:
            return None
        undone = (*self._undone, *settled.revisions)
        self.last_events = FrameEvents(
            closures=_undone_closures(undone), revisions=undone
        )
        self._take_map(settled)
        return settled.path

    def _take_map(self, settled: Settled) -> None:
        """Take places and covariances of all cones from the settled graph."""
        self.map.release()
        book = self.map.book
        _, row, found = np.intersect1d(book.id, settled.ids, return_indices=True)
        book.xy_m[row], book.cov_m2[row] = settled.xy_m[found], settled.cov_m2[found]

    def _is_due(self, newest: TrackedFrame) -> bool:
        if newest.closure or len(self._waiting) >= MANY_FRAMES:
            return True
        late = newest.stamp_s - self._updated_s >= self._graph_config.update_period_s
        return late and sum(len(f.landmark_id) for f in self._waiting) >= FEW_SIGHTINGS

    def _take(self, mapped: Mapped | None) -> None:
        """Go on from what the graph believes; note what it took back."""
        if mapped is not None:
            self._undone += mapped.revisions
            if mapped.snapshot is not None:
                self._resume(mapped.snapshot)

    def _resume(self, snapshot: Snapshot) -> None:
        """Load a snapshot and go through the frames again that it has not seen.

        One older than `OLDEST_SNAPSHOT`, or than a jump of the car, is left alone.
        """
        behind = self._frames - 1 - snapshot.k
        if behind > OLDEST_SNAPSHOT:
            return
        again = list(self._since)[len(self._since) - behind :]
        if any(frame.jump for frame in again):
            return
        self._pose_cov = snapshot.pose_cov
        self._anchor_m = snapshot.state[:2]
        self.map.load(
            snapshot.state,
            snapshot.cov,
            snapshot.ids,
            snapshot.all_ids,
            snapshot.all_xy_m,
        )
        before_s = snapshot.stamp_s
        for frame in again:
            self._go_through(frame, frame.stamp_s - before_s, snapshot.all_ids)
            before_s = frame.stamp_s

    def _go_through(
        self, frame: TrackedFrame, dt_s: float, elsewhere: IntArray
    ) -> None:
        """Track a frame again whose pairs are settled.

        Args:
            frame: what was tracked.
            dt_s: time since the frame before.
            elsewhere: cones of the graph, which are not new even if out of reach.
        """
        self.motion.repeat(self.map.filter, dt_s, frame.increment)
        slot = self.map.slots_of(frame.landmark_id)
        here = slot >= 0
        if here.any():
            xy, cov = frame.xy_m[here], frame.cov_m2[here]
            self.map.filter.update_cones(slot[here], xy, cov, None)
        born = ~here & ~np.isin(frame.landmark_id, elsewhere)
        born &= np.isin(frame.landmark_id, self.map.book.id)
        cones = frame.landmark_id[born]
        self.map.add_again(cones, frame.xy_m[born], frame.cov_m2[born])


def _undone_closures(
    revisions: Sequence[Revision],
) -> tuple[LoopClosure, ...]:
    return tuple(
        LoopClosure(r.stamp_s, 0.0, False, f"undone: residual d2 {np.median(r.d2):.0f}")
        for r in revisions
        if r.closure
    )
