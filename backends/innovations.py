"""A stream with its associations settled, filtered again under other noise.

Which observation belongs to which cone is decided once, by a run. With that held
fixed the innovations are smooth functions of the noise that is assumed, and a
filter without any decisions computes them fast.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.backends.car_motion import CarMotion
from conegraph.backends.consistency import ConsistencyMonitor
from conegraph.backends.gate import InputGate
from conegraph.backends.landmark_filter import LandmarkFilter
from conegraph.backends.motion import yaw_rate_bias_sigma
from conegraph.backends.sensor_noise import (
    effective_sensor,
    transport_covariance,
    with_configured_noise,
    with_scaled_odometry,
)
from conegraph.backends.tracker import Tracker
from conegraph.config import Config
from conegraph.geometry import to_child
from conegraph.types import (
    Array,
    ConeObservations,
    Event,
    IntArray,
    Mask,
    MatchStatus,
    SensorModel,
    VelocityObservation,
)

SETTLED = (MatchStatus.MATCHED, MatchStatus.TENTATIVE, MatchStatus.NEW)


@dataclass(frozen=True, slots=True)
class SettledFrame:
    """The cones of a frame whose landmark is known.

    Attributes:
        observations: as the source reports them.
        landmark_id: (k,) whose they are.
        xy_m: (k, 2) where they were in the car frame as the run in the end had it.
    """

    observations: ConeObservations
    landmark_id: IntArray
    xy_m: Array


SettledEvent = SettledFrame | VelocityObservation


@dataclass(frozen=True, slots=True)
class FrameInnovation:
    """The joint innovation of one frame.

    Attributes:
        residual: (2k,) measured less predicted positions, m.
        cov: (2k, 2k) the covariance that the filter gives them.
        landmark_id: (k,) whose they are.
    """

    residual: Array
    cov: Array
    landmark_id: IntArray


@dataclass(frozen=True, slots=True)
class Settled:
    """What a run made of a stream.

    Attributes:
        events: velocities and frames as the source gave them, with landmarks.
        nis: (F, 2) sum of the run's own NIS and degrees of freedom, frame by frame.
        overconfident: (F,) frames that ended an overconfident window.
    """

    events: tuple[SettledEvent, ...]
    nis: Array
    overconfident: Mask


def settle(
    events: Iterable[Event], config: Config, sensor: SensorModel | None
) -> Settled:
    """Run the shared frame path over a stream and keep its associations.

    Cones that were seen too seldom to be published are left out: some of them are
    false detections.
    """
    tracker, gate = Tracker(config, sensor), InputGate(config.gate)
    monitor = ConsistencyMonitor(config.status)
    kept: list[VelocityObservation | _Seen] = []
    nis: list[tuple[float, int]] = []
    stays: dict[int, int] = {}
    alarms: list[bool] = []
    for event in events:
        if isinstance(event, VelocityObservation):
            sample = gate.velocity(event)
            if sample is not None and config.motion.use_odometry:
                kept.append(sample)
                tracker.observe_velocity(sample)
            continue
        frame = gate.cones(event)
        made = None if frame is None else tracker.observe_cones(frame)
        if frame is None or made is None:
            continue
        known = np.array([s in SETTLED for s in made.status], dtype=np.bool_)
        known &= made.landmark_id >= 0
        pose = tracker.map.filter.vehicle[:3]
        ids = made.landmark_id[known].tolist()
        kept.append(_Seen(frame.subset(known), ids, pose))
        if tracker.tracked is not None:
            stays |= {gone: kept_id for kept_id, gone in tracker.tracked.merged}
        nis.append((made.nis, made.nis_dof) if made.nis_dof else (0.0, 0))
        alarms.append(monitor.frame(made.stamp_s, *nis[-1]).overconfident)
    book = tracker.map.book
    tracker.map.release()
    places = dict(zip(book.id.tolist(), book.xy_m, strict=True))
    settled = _often_seen(kept, stays, places, config.landmarks.publish_hits)
    return Settled(
        settled, np.array(nis).reshape(-1, 2), np.array(alarms, dtype=np.bool_)
    )


@dataclass(frozen=True, slots=True)
class _Seen:
    """A frame on its way: observations, their cones, and the car's pose (3,)."""

    observations: ConeObservations
    landmark_id: list[int]
    pose: Array


def _often_seen(
    events: Sequence[VelocityObservation | _Seen],
    stays: Mapping[int, int],
    places: Mapping[int, Array],
    often: int,
) -> tuple[SettledEvent, ...]:
    """Give merged cones one id; leave out those seen less often, or not kept."""

    def final(cone: int) -> int:
        while cone in stays:
            cone = stays[cone]
        return cone

    frames = [e for e in events if isinstance(e, _Seen)]
    count = Counter(final(i) for frame in frames for i in frame.landmark_id)
    good = {cone for cone, n in count.items() if n >= often and cone in places}
    result: list[SettledEvent] = []
    for event in events:
        if isinstance(event, VelocityObservation):
            result.append(event)
            continue
        rows = {final(i): row for row, i in enumerate(event.landmark_id)}
        ids = [cone for cone in rows if cone in good]
        keep = np.array([rows[cone] for cone in ids], dtype=np.int64)
        xy = np.array([places[cone] for cone in ids]).reshape(-1, 2)
        result.append(
            SettledFrame(
                event.observations.subset(keep),
                np.array(ids, dtype=np.int64),
                to_child(event.pose, xy),
            )
        )
    return tuple(result)


def innovations(
    events: Iterable[SettledEvent], config: Config, sensor: SensorModel | None
) -> list[FrameInnovation]:
    """Filter a settled stream; return the innovation of each frame with matches.

    The filter is the back ends' own (`LandmarkFilter`, `CarMotion`), without gates:
    the same frames and cones give innovations whatever the noise. A cone's sigma is
    taken at the range where the run in the end had it: at the measured one, the first
    sight of a cone gets the wrong weight, and the likelihood blames the odometry.
    """
    model = effective_sensor(config.sensor, sensor)
    motion = CarMotion(config.motion)
    filter_ = LandmarkFilter(
        yaw_rate_bias_sigma(config.motion),
        config.motion.start_speed_sigma_mps,
        invariant=config.backend.invariant,
    )
    slots: dict[int, int] = {}
    result = []
    for event in events:
        if isinstance(event, VelocityObservation):
            motion.queue.push(with_scaled_odometry(event, config.motion))
            continue
        frame = with_configured_noise(event.observations, config.sensor, model)
        xy, cov = frame.xy_m, frame.cov_m2
        if config.sensor.noise_at == "predicted":
            cov = transport_covariance(cov, xy, event.xy_m, model)
        motion.advance(filter_, frame.stamp_s)
        slot = np.array([slots.get(i, -1) for i in event.landmark_id.tolist()], int)
        old = np.flatnonzero(slot >= 0)
        if len(old):
            z, Z = filter_.residual(slot[old], xy[old], cov[old], None)
            result.append(FrameInnovation(z, Z, event.landmark_id[old]))
            filter_.update_cones(slot[old], xy[old], cov[old], None)
        new = np.flatnonzero(slot < 0)
        if len(new):
            added = filter_.add_cones(xy[new], cov[new])
            ids = event.landmark_id[new].tolist()
            slots |= dict(zip(ids, added.tolist(), strict=True))
    return result
