"""The frame path that every back end shares: predict, associate, correct, keep.

One class, so that a comparison of back ends compares estimators and not their
helpers. The EKF lets it hold the whole map; the factor graph lets it hold the
cones near the car and replaces its contents whenever the graph has been solved.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from conegraph.backends.base import FrameEvents
from conegraph.backends.car_motion import CarMotion
from conegraph.backends.closure import (
    ClosureResult,
    ClosureWatch,
    forced_start_pairs,
)
from conegraph.backends.consistency import WINDOW_S, ConsistencyMonitor
from conegraph.backends.gate import InputGate
from conegraph.backends.health import HealthMonitor
from conegraph.backends.landmark_filter import Innovation
from conegraph.backends.laps import LapCounter
from conegraph.backends.local_map import TOGETHER_M, LocalMap
from conegraph.backends.local_window import LocalWindow, window_config
from conegraph.backends.map_cleaner import MapCleaner
from conegraph.backends.pairing import (
    FramePairer,
    Pairs,
)
from conegraph.backends.recovery import Recovery, no_pairs
from conegraph.backends.sensor_noise import (
    effective_sensor,
    transport_covariance,
    with_configured_noise,
    with_scaled_odometry,
)
from conegraph.backends.tracked_frame import TrackedFrame, Unclaimed
from conegraph.backends.velocity import cone_velocity
from conegraph.config import Config
from conegraph.types import (
    Array,
    Associations,
    ConeMap,
    ConeObservations,
    Consistency,
    Estimate,
    IntArray,
    MatchStatus,
    OdometryStep,
    SensorModel,
    Status,
    VelocityObservation,
)

STATUS = (
    MatchStatus.REJECTED,
    MatchStatus.AMBIGUOUS,
    MatchStatus.TENTATIVE,
    MatchStatus.MATCHED,
    MatchStatus.NEW,
)

RETURN_M = 5.0
"""A cone not seen over this distance has come back into view."""

LONG_LOOK = 60
"""Frames of one view after which it holds no cone that is not known: what appears
later in front of a car that stands are false detections."""

SURPRISE = 8.0
"""Factor on the process noise that a jointly improbable frame adds."""


class Tracker:
    """Car, nearby cones and everything that decides what belongs to what.

    Attributes:
        has_mapper: whether each frame is described for one, in `tracked`.
    """

    has_mapper: ClassVar[bool] = True

    def __init__(
        self,
        config: Config,
        sensor: SensorModel | None,
        known_map: ConeMap | None = None,
        *,
        add_cones: bool = True,
    ) -> None:
        """Start at the origin, on a known map if one is given."""
        self._config = config
        self.sensor = effective_sensor(config.sensor, sensor)
        self.map = LocalMap(config)
        if known_map is not None:
            self.map.start_from(known_map)
            self.map.filter.place_car(np.zeros(3), np.diag([0.25, 0.25, 0.01]))
        self._add_cones = add_cones
        self._fixed_map = None if add_cones else known_map
        self.gate = InputGate(config.gate)
        self.motion = CarMotion(config.motion)
        self.laps = LapCounter(config.start_line)
        self._pairer = FramePairer(config, self.sensor)
        self._cleaner = MapCleaner(config, self.sensor, self._pairer)
        self._closures = ClosureWatch(config.start_line, self._pairer, self.sensor)
        self._health = HealthMonitor(config.status)
        self._consistency = ConsistencyMonitor(config.status)
        self._recovery = Recovery(
            config,
            self.sensor,
            known_map,
            add_cones=add_cones,
            make_window=lambda: LocalWindow(
                Tracker(window_config(config), self.sensor)
            ),
        )
        self._placed = self._recovery.trusted
        self._asked_s = -np.inf
        self.last_frame: ConeObservations | None = None
        self.last_ids: IntArray = np.zeros(0, dtype=np.int64)
        self.last_events = FrameEvents()
        self.tracked: TrackedFrame | None = None

    @property
    def rejected(self) -> Mapping[str, int]:
        """Inputs that the gate rejected, counted by reason."""
        return self.gate.rejected

    def predict(self, stamp_s: float) -> None:
        """Ask for estimates at this stamp from now on."""
        if stamp_s > self._asked_s:
            self._asked_s = stamp_s

    def observe_velocity(self, sample: VelocityObservation) -> None:
        """Keep a velocity until the next frame asks for it."""
        if not self._config.motion.use_odometry:
            return
        accepted = self.gate.velocity(sample)
        if accepted is not None:
            scaled = with_scaled_odometry(accepted, self._config.motion)
            self._recovery.velocity(accepted)
            self.motion.queue.push(scaled)
            self.predict(accepted.stamp_s)

    def observe_cones(self, frame: ConeObservations) -> Associations | None:
        """Take a frame; return what became of its cones, None if it was stale."""
        ticks = [time.perf_counter()]
        accepted = self.gate.cones(frame)
        if accepted is None:
            return None
        accepted = with_configured_noise(accepted, self._config.sensor, self.sensor)
        before_s = self.motion.stamp_s
        moved_m = self.motion.advance(self.map.filter, accepted.stamp_s)
        dt_s = 0.0 if before_s is None else accepted.stamp_s - before_s
        self._recover(accepted, moved_m)
        ticks.append(time.perf_counter())
        pairs, closure = self._pair(accepted)
        ticks.append(time.perf_counter())
        seen = self._settle(accepted, pairs, dt_s)
        ticks.append(time.perf_counter())
        self._recovery.watch(self.map, accepted, whole_map=self.laps.count > 0)
        result = self._keep_map(accepted, pairs, seen, closure.accepted)
        lap = self.laps.advance(accepted.stamp_s, self.map.filter.vehicle, moved_m)
        ticks.append(time.perf_counter())
        self._health.frame(accepted.stamp_s, int(pairs.matched.sum()), pairs.n_known)
        stages = ("predict", "associate", "update", "manage")
        consistency = self._consistency.frame(accepted.stamp_s, seen.nis, seen.dof)
        self.last_events = FrameEvents(
            closure.events,
            () if lap is None else (lap,),
            self._reason(accepted.stamp_s, consistency),
            dict(zip(stages, (1e3 * np.diff(ticks)).tolist(), strict=True)),
            consistency,
            odometry=self._odometry_step(),
        )
        return result

    def _odometry_step(self) -> OdometryStep | None:
        """Return what odometry said since the frame before, and its bias."""
        increment = self.motion.increment
        if increment is None:
            return None
        return OdometryStep(increment.delta, float(self.map.filter.vehicle[5]))

    def _recover(self, frame: ConeObservations, moved_m: float) -> None:
        """Look for a car that is lost, and start anew where it is found."""
        self.map = self._recovery.search(self.map, frame, moved_m)
        if self._recovery.jumped:
            self.motion.take_noise()
            if not self._placed:
                self.laps.restart()
        self._placed = self._placed or self._recovery.trusted
        if self._recovery.jumped or self._recovery.lost:
            self.laps.interrupt()

    def _judge(self, stamp_s: float) -> tuple[Status, str]:
        """Return how far the estimate can be trusted, and why."""
        judged = self._health.judge(stamp_s, self.motion.queue.newest_s)
        return self._recovery.verdict() or judged

    def _reason(self, stamp_s: float, consistency: Consistency) -> str:
        """Say why the status is what it is, and what else is wrong."""
        reason = self._judge(stamp_s)[1]
        if not consistency.overconfident:
            return reason
        ratio = f"NIS/dof {consistency.nis_per_dof:.1f} over {WINDOW_S:g} s"
        return "; ".join(filter(None, (reason, f"overconfident: {ratio}")))

    def _pair(self, frame: ConeObservations) -> tuple[Pairs, ClosureResult]:
        """Associate a frame; a loop closure corrects the filter on the way."""
        if self._recovery.lost:
            return no_pairs(len(frame)), ClosureResult()
        pairs = self._pairer.pair(self.map, frame, self.motion.noise)
        if self._config.start_line.forced:
            pairs = forced_start_pairs(self._pairer, self.map, frame, pairs)
        gate, driven_m = self.laps.gate, self.laps.driven_m
        closure = self._closures.check(self.map, frame, pairs, gate, driven_m)
        if closure.match is not None:
            row = closure.match.row
            self._correct(frame.xy_m[row], frame.cov_m2[row], closure.match.slot)
            again = self._pairer.pair(self.map, frame, self.motion.noise)
            pairs = again.with_used(closure.match.row, closure.match.slot)
        return pairs, closure

    def cone_map(self) -> ConeMap:
        """Return the confirmed cones; when only localising, the map that was given."""
        return self.map.publish() if self._fixed_map is None else self._fixed_map

    def estimate(self) -> Estimate:
        """Return the estimate at the newest stamp asked for or observed."""
        state, cov = self.map.filter.vehicle, self.map.filter.vehicle_cov
        stamp_s = self.motion.stamp_s
        if stamp_s is None:
            stamp_s = max(self._asked_s, 0.0)
        elif self._asked_s > stamp_s:
            step = self.motion.look_ahead(state, self._asked_s)
            state, cov = step.state, step.F @ cov @ step.F.T + step.Q
            stamp_s = self._asked_s
        status, _ = self._judge(stamp_s)
        return Estimate(
            stamp_s,
            state[:3],
            cov[:3, :3],
            state[3:5],
            status,
            self._recovery.resets,
        )

    def _correct(self, xy_m: Array, cov_m2: Array, slot: IntArray) -> None:
        self.map.filter.update_cones(slot, xy_m, cov_m2, self._noise_model())

    def _settle(self, frame: ConeObservations, pairs: Pairs, dt_s: float) -> Innovation:
        """Correct with the frame's matches; return their joint innovation."""
        if self._config.motion.cone_velocity:
            self._correct_with_cone_velocity(frame, pairs, dt_s)
        row = np.flatnonzero(pairs.matched & pairs.update).astype(np.int64)
        matched = bool(pairs.matched.any())
        noise = self.motion.take_noise() if matched else self.motion.noise
        if len(row) == 0:
            return Innovation(float("nan"), 0)
        slot = pairs.slot[row]
        cov = frame.cov_m2[row]
        nearest = self._config.association.method == "nearest"
        if self._config.association.method == "known":
            # Known ids are never refused; a gross error among them must not pull hard.
            excess = np.maximum(pairs.d2[row] / self._config.association.gate_d2, 1.0)
            cov = cov * excess[:, None, None]
        cov = cov + pairs.cluster.spread_m2[row]
        doubt = None if nearest else SURPRISE * noise
        try:
            return self.map.filter.update_cones(
                slot, frame.xy_m[row], cov, self._noise_model(), doubt
            )
        except np.linalg.LinAlgError:
            self.gate.rejected["frame: too uncertain to correct with"] += 1
            return Innovation(float("nan"), 0)

    def _noise_model(self) -> SensorModel | None:
        """Return the model that moves noise to the predicted range, None for none."""
        return None if self._config.sensor.noise_at == "measured" else self.sensor

    def _correct_with_cone_velocity(
        self, frame: ConeObservations, pairs: Pairs, dt_s: float
    ) -> None:
        """Measure the velocity from the cones that the last frame showed too."""
        last = self.last_frame
        row = np.flatnonzero(pairs.matched)
        ids = self.map.book.id[self.map.row[pairs.slot[row]]]
        _, now, then = np.intersect1d(ids, self.last_ids, return_indices=True)
        if last is None or len(now) < 3:
            return
        now = row[now]
        sample = cone_velocity(
            last.xy_m[then],
            last.cov_m2[then],
            frame.xy_m[now],
            frame.cov_m2[now],
            dt_s,
            frame.stamp_s,
        )
        if sample is not None:
            self.map.filter.update_velocity(sample.u_mps, sample.r_radps, sample.cov)

    def _keep_map(
        self,
        frame: ConeObservations,
        pairs: Pairs,
        seen: Innovation,
        closure: bool,
    ) -> Associations:
        """Record sightings, births, misses and twins; return what became of each."""
        map_, book, driven_m = self.map, self.map.book, self.laps.driven_m
        row = np.flatnonzero(pairs.matched & ~pairs.cluster.soft)
        book_row = map_.row[pairs.slot[row]]
        confirmed = book.published[book_row]
        returned = driven_m - book.last_seen_m[book_row] > RETURN_M
        book.hit(book_row, frame.class_prob[row], driven_m, frame.evidence[row])
        missed = self._cleaner.missed(map_, frame, pairs)
        watched = self.motion.frames_standing > LONG_LOOK
        trusted = self._recovery.trusted
        adds = self._add_cones and trusted and not watched
        born = np.flatnonzero(pairs.birth & adds)
        self._pairer.note_appearances(len(born), int(returned.sum()))
        slot = pairs.slot.copy()
        if len(born):
            slot[born] = map_.add(frame.subset(born), driven_m)
        has_id = slot >= 0
        beside = has_id & (pairs.matched | pairs.cluster.beside)
        book.note_together(map_.row[slot[beside]], frame.xy_m[beside], TOGETHER_M)
        ids = np.full(len(frame), -1, dtype=np.int64)
        ids[has_id] = book.id[map_.row[slot[has_id]]]
        status = np.zeros(len(frame), dtype=np.int64)
        status[pairs.ambiguous | pairs.cluster.soft] = 1
        status[row] = 2
        status[row[confirmed]] = 3
        status[born] = 4
        tracked = None
        if self.has_mapper:
            tracked = self._describe(frame, pairs, slot, ids, closure)
        merged, deleted = self._cleaner.clean(map_, missed, self.laps)
        if tracked is not None:
            gone = tuple(sorted(deleted.tolist()))
            self.tracked = replace(tracked, merged=merged, deleted=gone)
        self.last_frame, self.last_ids = frame, ids
        d2 = np.where(np.isfinite(pairs.d2), pairs.d2, np.nan)
        return Associations(
            frame.stamp_s,
            tuple(STATUS[i] for i in status.tolist()),
            np.where(status == 1, -1, ids),
            d2,
            seen.nis,
            seen.dof,
        )

    def _describe(
        self,
        frame: ConeObservations,
        pairs: Pairs,
        slot: IntArray,
        ids: IntArray,
        closure: bool,
    ) -> TrackedFrame:
        """Return what a mapper is told of a frame, save what is then cleaned away."""
        trusted, filter_ = self._recovery.trusted, self.map.filter
        # A pair that may be wrong corrects the filter; the graph would keep it.
        sure = (slot >= 0) & ~pairs.cluster.soft & trusted
        # Doubt deserves a second look; a lost car's pose and given ids leave none.
        doubtful = trusted and self._config.association.method != "known"
        aside = np.flatnonzero(~sure & doubtful).astype(np.int64)
        reported, spread = frame.cov_m2[sure], pairs.cluster.spread_m2[sure]
        noise, model = reported, self._noise_model()
        if model is not None:
            there = filter_.cones_in_car_frame()[slot[sure]]
            noise = transport_covariance(reported, frame.xy_m[sure], there, model)
        return TrackedFrame(
            frame.stamp_s,
            self.motion.increment,
            filter_.vehicle,
            filter_.vehicle_cov[3:5, 3:5],
            ids[sure],
            np.flatnonzero(sure).astype(np.int64),
            frame.xy_m[sure],
            noise + spread,
            reported + spread,
            pairs.vague[sure],
            closure or self._recovery.jumped,
            jump=self._recovery.jumped,
            unclaimed=Unclaimed(aside, frame.xy_m[aside], frame.cov_m2[aside]),
        )
