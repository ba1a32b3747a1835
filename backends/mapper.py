"""The factor graph behind the tracker: every frame, solved by iSAM2.

Recent frames are in the graph one by one. Once the map has closed on itself, older
ones are summed up in one factor on the cones, so that an update costs the same in
every lap. The journal keeps all that was ever said, for the final solution.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from conegraph.backends.graph_builder import (
    Factors,
    GraphBuilder,
    first_values,
    pose_array,
)
from conegraph.backends.journal import Entry, Journal
from conegraph.backends.reviewer import (
    LOOP_D2,
    REVIEW_AFTER_S,
    SUSPECT_D2,
    Loop,
    LoopWatch,
    residual_d2,
)
from conegraph.backends.second_look import second_look
from conegraph.backends.solver import (
    UNSOLVABLE,
    kind,
    new_isam,
    number,
    restricted,
    solve,
    summarise,
)
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.config import Isam2Config, MotionConfig
from conegraph.geometry import to_child, to_parent
from conegraph.types import (
    Array,
    ConeMap,
    IntArray,
    Revision,
    SensorModel,
    Trajectory,
)

log = logging.getLogger(__name__)

KEEP = 30
"""Newest poses that stay in the graph when older ones are summed up."""

SUM_UP_EVERY = 300
"""Poses that come between two times of summing up."""

LONGEST_EXACT = 8000
"""Poses after which old ones are summed up even though no loop has closed."""

POLISH_ROUNDS = 2
"""Batch solutions in a row: odometry with a bias is linearised, and the sensor's noise
evaluated, where the one before ended."""


class Mapper:
    """Feeds tracked frames into iSAM2, doubts them, and sums up what is settled."""

    def __init__(
        self,
        config: Isam2Config,
        motion: MotionConfig,
        known: ConeMap | None = None,
        sensor: SensorModel | None = None,
    ) -> None:
        """Start with an empty graph, or with the cones of a known map.

        Args:
            config: how the graph is solved.
            motion: how the car moves.
            known: cones of a given map.
            sensor: what makes noise follow the range as the map settles; None
                leaves it where the tracker predicted it.
        """
        self._builder = GraphBuilder(config, motion, known, sensor)
        self._bounded = config.bounded
        self._sensor = sensor
        self.isam = new_isam()
        self.journal = Journal([] if known is None else known.id.tolist())
        self.cones: dict[int, None] = {}
        self.rebuilt = 0
        self.failed = False
        self._present: set[int] = set()
        self._loops = LoopWatch(known is not None)
        self._base: Factors = self._builder.start()
        self._first_exact = 0
        self._reviewed = 0
        self._archive = gtsam.Values()
        self._first = gtsam.Values()
        self._slot: dict[tuple[int, int], int] = {}
        self._n_slots = 0
        self._new = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._push(self._base)
        if known is not None:
            for cone, xy in zip(known.id.tolist(), known.xy_m, strict=True):
                self._insert_cone(cone, xy)

    @property
    def has_bias(self) -> bool:
        """Whether odometry's yaw-rate bias is estimated."""
        return self._builder.has_bias

    @property
    def newest(self) -> Entry:
        """The last frame taken in."""
        return self.journal.entries[-1]

    @property
    def window(self) -> list[Entry]:
        """Frames whose poses are in the graph one by one."""
        return self.journal.entries[self._first_exact :]

    def pose(self, k: int) -> Array:
        """(3,) pose of frame k of the window as the graph has it now."""
        return pose_array(self.isam.calculateEstimatePose2(X(k)))

    def cone_m(self, cone: int) -> Array:
        """(2,) a cone as the graph has it now."""
        return np.asarray(self.isam.calculateEstimatePoint2(L(cone)))

    def cone_cov_m2(self, cone: int) -> Array:
        """(2, 2) covariance of a cone in the world."""
        return np.asarray(self.isam.marginalCovariance(L(cone)))

    def update(self, frames: Sequence[TrackedFrame]) -> list[Revision]:
        """Add frames and solve; return what had to be taken back.

        A solver that throws is thrown away: the graph is solved anew in batch from
        the last good values, and if that fails too, without the frames' cones.
        """
        begin = len(self.journal)
        for frame in frames:
            self._add(frame)
        self._first.insert(self._new_values)
        try:
            self.isam.update(self._new, self._new_values)
            self.isam.calculateEstimatePose2(X(self.newest.k))
        except RuntimeError as error:
            log.warning("iSAM2: %s; solving the graph anew", _short(error))
            self._rebuild(begin)
        self._new = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        if self.failed:
            return []
        revisions = self._review(begin)
        if self._should_sum_up():
            revisions += self._sum_up()
        return revisions

    def _add(self, frame: TrackedFrame) -> None:
        entry = self.journal.append(frame)
        self._loops.note(entry)
        self._new_values.insert(first_values(entry, has_bias=self.has_bias))
        pose = frame.state[:3]
        for cone, xy in zip(frame.landmark_id.tolist(), frame.xy_m, strict=True):
            self.cones[cone] = None
            if cone not in self._present:
                self._insert_cone(cone, to_parent(pose, xy[None])[0])
        before = np.zeros(3) if entry.before is None else entry.before.frame.state[:3]
        self._push(self._builder.motion(entry, before, float(frame.state[5])))
        self._slot |= self._slots_of(entry, self._n_slots)
        self._push(self._builder.cones(entry))
        self._push(self._builder.merges(entry, self._present))
        for gone in (*frame.deleted, *(g for _, g in frame.merged)):
            self.cones.pop(gone, None)

    def _push(self, factors: Factors) -> None:
        for factor in factors:
            self._new.add(factor)
        self._n_slots += len(factors)

    @staticmethod
    def _slots_of(entry: Entry, first: int) -> dict[tuple[int, int], int]:
        """Number the factors of an entry's kept sightings from a first slot on."""
        kept = np.flatnonzero(entry.kept).tolist()
        return {(entry.k, i): first + n for n, i in enumerate(kept)}

    def _insert_cone(self, cone: int, xy_m: Array) -> None:
        self.cones[cone] = None
        self._present.add(cone)
        self._new_values.insert(L(cone), xy_m)

    def _graph(
        self, base: Factors, entries: Sequence[Entry], values: gtsam.Values
    ) -> tuple[gtsam.NonlinearFactorGraph, dict[tuple[int, int], int]]:
        """Return a graph linearised anew where it is linear, and its sightings' slots.

        Where the tracker was when a frame came, odometry with a bias is off by half
        the square of the turn that closures have given the map since.
        """
        graph = gtsam.NonlinearFactorGraph()
        slot: dict[tuple[int, int], int] = {}
        present = {number(key) for key in list(values.keys()) if kind(key) == "l"}
        for factor in base:
            graph.add(factor)
        for entry in entries:
            for factor in self._builder.motion_at(entry, values):
                graph.add(factor)
            slot |= self._slots_of(entry, graph.size())
            for factor in self._builder.cones_at(entry, values):
                graph.add(factor)
            for factor in self._builder.merges(entry, present):
                graph.add(factor)
        return graph, slot

    def _solved(
        self, base: Factors, entries: Sequence[Entry], values: gtsam.Values
    ) -> gtsam.Values:
        """Solve a graph in batch, starting from values that hold all its variables."""
        for _ in range(POLISH_ROUNDS):
            graph, _ = self._graph(base, entries, values)
            values = solve(graph, restricted(values, graph.keyVector()))
        return values

    def _converged(
        self, base: Factors, entries: Sequence[Entry], values: gtsam.Values
    ) -> tuple[gtsam.Values, list[Revision]]:
        """Solve in batch; solve again without what does not fit and with what does."""
        values = self._solved(base, entries, values)
        revised: list[Revision] = []
        for entry in entries:
            pose = pose_array(values.atPose2(X(entry.k)))
            cones = np.array([values.atPoint2(L(c)) for c in entry.cones.tolist()])
            revised += self._doubt(entry, residual_d2(entry, pose, cones))
        revised += self._second_look(entries, values)
        if revised:
            values = self._solved(base, entries, values)
        return values, revised

    def _second_look(
        self, entries: Sequence[Entry], values: gtsam.Values
    ) -> list[Revision]:
        """Give sightings that had been left aside to the cones that they now fit."""
        if self._sensor is None:
            return []
        cones = np.array(list(self.cones), dtype=np.int64)
        xy_m = np.array([values.atPoint2(L(c)) for c in cones.tolist()]).reshape(-1, 2)
        united = {gone: kept for e in entries for kept, gone in e.frame.merged}
        found = []
        for entry in entries:
            if len(entry.frame.unclaimed) == 0:
                continue
            there_m = to_child(pose_array(values.atPose2(X(entry.k))), xy_m)
            shown = entry.cones
            while np.isin(shown, list(united)).any():
                shown = np.array([united.get(c, c) for c in shown.tolist()])
            free = ~np.isin(cones, shown)
            index, which, d2 = second_look(
                entry.frame.unclaimed, there_m, free, self._sensor
            )
            if len(index):
                found.append(self.journal.adopt(entry, index, cones[which], d2))
        return found

    def _start_anew(self, values: gtsam.Values) -> None:
        """Let a new solver hold the base and the window, linearised at values.

        Raises:
            RuntimeError: they have no solution near the values.
        """
        graph, slot = self._graph(self._base, self.window, values)
        values = restricted(values, graph.keyVector())
        if not np.isfinite(graph.error(values)):
            raise RuntimeError("a factor is not a number")
        isam = new_isam(careful=self.rebuilt > 0)
        isam.update(graph, values)
        self.isam, self._first = isam, values
        self._slot, self._n_slots = slot, graph.size()
        self._present = {c for c in self._present if values.exists(L(c))}
        self.cones = {c: None for c in self.cones if c in self._present}

    def _rebuild(self, begin: int) -> None:
        """Solve everything again, at worst without the newest frames' cones.

        If even that fails the graph is given up: `failed` is set, and what it last
        believed is all that it will ever say.
        """
        self.rebuilt += 1
        for without in (False, True):
            if without:
                for entry in self.journal.entries[begin:]:
                    self.journal.drop(entry)
            try:
                self._start_anew(self._solved(self._base, self.window, self._first))
            except UNSOLVABLE as error:
                log.warning("batch: %s", _short(error))
            else:
                return
        log.warning("the factor graph has no solution; going on without it")
        self.failed = True

    def mend(self) -> None:
        """Replace a solver that turned out to be unusable when it was read."""
        self._rebuild(len(self.journal))

    def _review(self, begin: int) -> list[Revision]:
        """Take back what does not fit: fresh closures, ripe loops, ripe sightings.

        What iSAM2 has just closed it has not yet settled: then, and before anything
        is held against a sighting, the window is solved to convergence.

        Args:
            begin: the first frame of this update.
        """
        entries, now_s = self.journal.entries, self.newest.frame.stamp_s
        closing = [e for e in entries[begin:] if e.frame.closure]
        loops = [Loop([e], set(e.cones.tolist())) for e in closing]
        ripe = self._loops.ripe(now_s)
        loops += [] if ripe is None else [ripe]
        end = max(self._reviewed, self._first_exact)
        while (
            end < len(entries) and now_s - entries[end].frame.stamp_s > REVIEW_AFTER_S
        ):
            end += 1
        doubted = entries[max(self._reviewed, self._first_exact) : end]
        undone: list[Revision] = []
        taken: list[Revision] = []
        off = any(self._is_off(loop) for loop in loops)
        if closing or off or self._suspects(doubted):
            self._settle(self.isam.calculateEstimate())
            undone = [r for loop in loops for r in self._doubt_loop(loop)]
            if undone:
                # What a wrong loop has bent says nothing against other sightings.
                self._settle(self.isam.calculateEstimate())
            for entry in doubted:
                taken += self._doubt(entry, self._residual_d2(entry))
            self._remove(self.window)
        self._reviewed = end
        if undone:
            self._loops.open = None
        elif ripe is not None:
            self._loops.stands |= ripe.closed and not self._is_off(ripe)
        return undone + taken

    def _settle(self, values: gtsam.Values) -> None:
        """Solve the window to convergence from values and go on from there."""
        self._start_anew(self._solved(self._base, self.window, values))

    def _suspects(self, entries: Sequence[Entry]) -> bool:
        return any((self._residual_d2(e) > SUSPECT_D2).any() for e in entries)

    def _doubt(self, entry: Entry, d2: Array) -> list[Revision]:
        """Take sightings of an entry back that are far off in the solution."""
        bad = d2 > SUSPECT_D2
        return self.journal.retract(entry, np.flatnonzero(entry.kept)[bad], d2[bad])

    def _off_d2(self, loop: Loop) -> list[tuple[Entry, IntArray, Array]]:
        """Return places and d2 of a loop's sightings, by entry of the window."""
        found = []
        for entry in loop.entries:
            if entry.k >= self._first_exact:
                of_loop = loop.sightings(entry)
                d2 = self._residual_d2(entry)[of_loop[entry.kept]]
                found.append((entry, np.flatnonzero(of_loop), d2))
        return found

    def _is_off(self, loop: Loop) -> bool:
        """Whether a loop's sightings are far outside their noise."""
        d2 = [off for _, _, off in self._off_d2(loop)]
        return any(map(len, d2)) and bool(np.median(np.concatenate(d2)) > LOOP_D2)

    def _doubt_loop(self, loop: Loop) -> list[Revision]:
        """Undo a loop that does not fit.

        A wrong loop that the graph could not be bent to shows as residuals far
        outside their noise, where a right one has been pulled together.
        """
        if not self._is_off(loop):
            return []
        found = self._off_d2(loop)
        return [
            revision
            for entry, i, d2 in found
            for revision in self.journal.retract(
                entry, i, d2, closure=entry.frame.closure
            )
        ]

    def _residual_d2(self, entry: Entry) -> Array:
        cones = np.array([self.cone_m(c) for c in entry.cones.tolist()])
        return residual_d2(entry, self.pose(entry.k), cones)

    def _remove(self, entries: Sequence[Entry]) -> None:
        """Take the sightings of entries that are not kept out of the solver."""
        gone = [
            self._slot.pop((entry.k, i))
            for entry in entries
            for i in np.flatnonzero(~entry.kept).tolist()
            if (entry.k, i) in self._slot
        ]
        if gone:
            self.isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), gone)

    def _should_sum_up(self) -> bool:
        if not self._bounded or self._loops.open is not None:
            return False
        if not self._loops.stands:
            return len(self.window) >= LONGEST_EXACT
        enough = KEEP + (SUM_UP_EVERY if self._first_exact else 1)
        return len(self.window) >= enough

    def _sum_up(self) -> list[Revision]:
        """Sum all but the newest poses up in one factor on the cones.

        The window is first solved to convergence and doubted once more: what is
        summed up is linear at these values for good.
        """
        estimate = self.isam.calculateEstimate()
        values, taken = self._converged(self._base, self.window, estimate)
        last = len(self.journal) - 1 - KEEP
        old = self.journal.entries[self._first_exact : last + 1]
        graph, _ = self._graph(self._base, old, values)
        gone = self._settled_keys(graph, last)
        self._base = [summarise(graph, restricted(values, graph.keyVector()), gone)]
        self._archive.insert_or_assign(restricted(values, gone))
        self._first_exact = last + 1
        self._start_anew(values)
        return taken

    def _settled_keys(self, graph: gtsam.NonlinearFactorGraph, last: int) -> list[int]:
        """Keys that no frame after ``last`` asks for: old poses, cones given up."""
        boundary = self.journal.entries[last]
        needed = set(self.cones)
        for entry in self.journal.entries[last + 1 :]:
            needed.update(entry.cones.tolist(), *entry.frame.merged)
        first = {"x": boundary.k, "v": boundary.k, "b": boundary.segment}
        return [
            key
            for key in graph.keyVector()
            if (
                number(key) not in needed
                if kind(key) == "l"
                else number(key) < first[kind(key)]
            )
        ]

    def settle(self, *, polish: bool) -> tuple[Trajectory | None, list[Revision]]:
        """Solve to convergence if asked; return the whole path, None if failed.

        iSAM2 ends where its thresholds let it, and what was summed up is linear;
        the journal has everything as it was said. Sightings that are far off in the
        solution are taken back, and it is solved once more.
        """
        taken: list[Revision] = []
        if self.failed:
            return None, taken
        values = gtsam.Values(self._archive)
        values.insert_or_assign(self.isam.calculateEstimate())
        if polish:
            try:
                values, taken = self._polished(values)
            except UNSOLVABLE as error:
                log.warning("batch: %s; keeping what iSAM2 had", _short(error))
        entries = self.journal.entries
        poses = [pose_array(values.atPose2(X(e.k))) for e in entries]
        stamps = np.array([e.frame.stamp_s for e in entries])
        return Trajectory(stamps, np.array(poses).reshape(-1, 3)), taken

    def _polished(self, values: gtsam.Values) -> tuple[gtsam.Values, list[Revision]]:
        base = self._builder.start()
        values, taken = self._converged(base, self.journal.entries, values)
        self._base, self._first_exact = base, 0
        self._start_anew(values)
        return values, taken


def _short(error: Exception) -> str:
    """Return gtsam's complaint without its page of advice."""
    text = " ".join(str(error).split())
    return text.split(" Thrown when")[0]
