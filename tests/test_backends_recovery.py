"""Cars that start anywhere, are carried away, and must be found again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from conegraph.backends import Backend, make_backend
from conegraph.backends.isam2 import Isam2Backend
from conegraph.backends.recovery import UNOPPOSED_M
from conegraph.bench.relocalisation_trials import cone_map, true_pose
from conegraph.bench.symmetric import circle
from conegraph.config import resolve_config
from conegraph.eval.map_metrics import map_metrics
from conegraph.geometry import between, to_child
from conegraph.sim.cone_sensor import CAMERA, LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import (
    Array,
    ConeMap,
    Event,
    Recording,
    Status,
    VelocityObservation,
)

KINDS = ["ekf", "isam2"]
SENSORS = {"camera": CAMERA, "lidar": LIDAR}


@cache
def drive(sensor: str, laps: int, *, odometry: bool = True) -> Recording:
    return simulate(
        built_in_track("autocross" if laps == 1 else "oval", 0),
        laps=laps,
        seed=5,
        sensor=SENSORS[sensor],
        odometry=OdometrySensor() if odometry else None,
        origin="start",
    )


def pieces(
    recording: Recording, begin_s: float, cut_s: float, gone_s: float, end_s: float
) -> Iterator[tuple[Event, float]]:
    """Yield a stream out of which a piece is cut, and each event's true stamp.

    A car that is driven on while the computer sleeps is a car that is carried away.
    """
    for event in recording.events():
        true_s = event.stamp_s
        if begin_s <= true_s < cut_s:
            yield event, true_s
        elif cut_s + gone_s <= true_s < end_s:
            yield replace(event, stamp_s=true_s - gone_s), true_s


@dataclass(frozen=True)
class Log:
    """What a back end said at each frame."""

    backend: Backend
    stamp_s: Array
    error_m: Array
    status: tuple[Status, ...]
    resets: Array

    def when(self, status: Status, after_s: float) -> float:
        """Return the first stamp after a time with a status."""
        stamps: list[float] = self.stamp_s.tolist()
        return next(
            t
            for t, s in zip(stamps, self.status, strict=True)
            if t > after_s and s is status
        )


def follow(
    backend: Backend, recording: Recording, events: Iterator[tuple[Event, float]]
) -> Log:
    stamps, errors, status, resets = [], [], [], []
    for event, true_s in events:
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
            continue
        assert backend.observe_cones(event) is not None
        estimate = backend.estimate()
        truth = true_pose(recording, true_s)
        stamps.append(event.stamp_s)
        errors.append(float(np.hypot(*(estimate.pose - truth)[:2])))
        status.append(estimate.status)
        resets.append(estimate.reset_counter)
    return Log(
        backend, np.array(stamps), np.array(errors), tuple(status), np.array(resets)
    )


def on_map(
    recording: Recording, known: ConeMap, kind: str = "ekf", *, add_cones: bool = False
) -> Backend:
    """Return a back end that starts on a map, and localises only or adds to it."""
    config = resolve_config({"backend": {"kind": kind}})
    return make_backend(
        config.backend,
        config,
        sensor=recording.sensor,
        known_map=known,
        add_cones=add_cones,
    )


def true_map(recording: Recording) -> ConeMap:
    truth = recording.truth_map
    assert truth is not None
    return cone_map(truth.xy_m, truth.cone_class)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("sensor", "odometry"), [("camera", True), ("lidar", False)])
def test_on_a_given_map_the_car_starts_anywhere_and_may_be_carried_away(
    kind: str, sensor: str, odometry: bool
) -> None:
    recording = drive(sensor, 1, odometry=odometry)
    known = true_map(recording)
    backend = on_map(recording, known, kind)
    begin_s, cut_s = 8.0, 13.0
    log = follow(backend, recording, pieces(recording, begin_s, cut_s, 6.0, 24.0))
    assert log.error_m[0] > 20.0
    # Nothing but INIT and LOST until it is found, then OK and right.
    found_s = log.when(Status.OK, 0.0)
    assert found_s < begin_s + 4.0
    before, uncut = log.stamp_s < found_s, log.stamp_s < cut_s
    assert set(np.array(log.status)[before]) <= {Status.INIT, Status.LOST}
    assert log.error_m[uncut & ~before].max() < 0.5
    lost_s = log.when(Status.LOST, cut_s)
    assert lost_s < cut_s + 1.0
    again_s = log.when(Status.OK, lost_s)
    assert again_s < cut_s + 10.0
    assert log.error_m[log.stamp_s > again_s + 0.5].max() < 0.3
    assert log.resets[-1] == log.resets[uncut][-1] + 1 == 2
    assert backend.cone_map() is known


@pytest.mark.parametrize("begin_s", [4.0, 8.0])
def test_a_map_that_is_updated_gains_nothing_from_a_car_elsewhere(
    begin_s: float,
) -> None:
    """On a straight the lane far from the origin resembles that at the origin."""
    recording = drive("camera", 1)
    known = true_map(recording)
    backend = on_map(recording, known, add_cones=True)
    end_s = begin_s + 5.0
    log = follow(backend, recording, pieces(recording, begin_s, end_s, 0.0, end_s))
    assert log.error_m[0] > 10.0
    believed = np.isin(np.array(log.status), [Status.OK, Status.DEGRADED])
    assert believed[-1]
    assert log.error_m[believed].max() < 0.5
    assert recording.truth_map is not None
    assert map_metrics(backend.cone_map(), recording.truth_map).precision == 1.0


def test_what_a_lost_car_saw_gets_no_second_look() -> None:
    recording = drive("camera", 2)
    config = resolve_config({"backend": {"kind": "isam2"}})
    tracker = Isam2Backend(config, recording.sensor)
    end_s = recording.stream[-1].stamp_s
    cut_s, aside = 0.6 * end_s, {True: 0, False: 0}
    for event, _ in pieces(recording, 0.0, cut_s, 5.0, cut_s + 8.0):
        if isinstance(event, VelocityObservation):
            tracker.observe_velocity(event)
        elif tracker.observe_cones(event) is not None and tracker.tracked is not None:
            lost = tracker.estimate().status is Status.LOST
            aside[lost] += len(tracker.tracked.unclaimed)
    assert tracker.estimate().reset_counter == 1
    assert aside[True] == 0 < aside[False]


def test_a_pause_of_half_a_minute_ends_neither_the_graph_nor_the_map() -> None:
    """Nothing is told for so long that the car may have gone anywhere."""
    recording = drive("camera", 2)
    truth = recording.truth_map
    assert truth is not None
    config = resolve_config({"backend": {"kind": "isam2"}})
    backend = make_backend(config.backend, config, sensor=recording.sensor)
    cut_s = 0.6 * recording.stream[-1].stamp_s
    for event in recording.events():
        late_s = 30.0 if event.stamp_s > cut_s else 0.0
        event = replace(event, stamp_s=event.stamp_s + late_s)
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        else:
            backend.observe_cones(event)
    assert backend.estimate().reset_counter == 1
    assert backend.finish() is not None
    judged = map_metrics(backend.cone_map(), truth)
    assert judged.precision == 1.0
    assert judged.rmse_aligned_m < 0.03


@pytest.mark.parametrize("kind", KINDS)
def test_while_mapping_a_carried_car_adds_nothing_until_it_is_found(kind: str) -> None:
    recording = drive("lidar", 2)
    truth = recording.truth_map
    assert truth is not None
    config = resolve_config({"backend": {"kind": kind}})
    backend = make_backend(config.backend, config, sensor=recording.sensor)
    end_s = recording.stream[-1].stamp_s
    cut_s = 0.6 * end_s
    log = follow(backend, recording, pieces(recording, 0.0, cut_s, 5.0, end_s))
    lost_s = log.when(Status.LOST, cut_s)
    assert lost_s < cut_s + 1.0
    again_s = log.when(Status.OK, lost_s)
    assert again_s < cut_s + 10.0
    assert (log.resets[log.stamp_s < again_s] == 0).all()
    assert log.resets[-1] == 1
    assert log.error_m[log.stamp_s > again_s + 0.5].max() < 0.5
    backend.finish()
    judged = map_metrics(backend.cone_map(), truth)
    assert judged.precision == 1.0
    assert judged.duplicates == 0
    assert judged.rmse_aligned_m < 0.1


def test_on_a_symmetric_map_the_start_is_believed_only_after_a_while() -> None:
    """No search can tell; the prior at the origin fits and nothing contradicts it."""
    layout = circle()
    recording = simulate(layout, laps=1, seed=1, sensor=LIDAR, origin="start")
    assert layout.start_pose is not None
    known = cone_map(to_child(layout.start_pose, layout.xy_m), layout.cone_class)
    backend = on_map(recording, known)
    log = follow(backend, recording, pieces(recording, 0.0, 12.0, 0.0, 12.0))
    assert set(log.status) == {Status.INIT, Status.OK}
    path = recording.truth_trajectory
    assert path is not None
    row = int(np.searchsorted(path.stamp_s, log.when(Status.OK, 0.0)))
    steps = np.hypot(*np.diff(path.pose[: row + 1, :2], axis=0).T)
    assert steps.sum() == pytest.approx(UNOPPOSED_M, abs=2.0)
    assert (log.resets == 0).all()
    assert log.error_m.max() < 0.5


def test_thesis_and_known_ids_never_look_for_the_car() -> None:
    recording = drive("lidar", 1)
    known = true_map(recording)
    for tree in (
        {"backend": {"profile": "thesis"}},
        {"association": {"method": "known"}},
        {"recovery": {"enabled": False}},
    ):
        config = resolve_config(tree)
        backend = make_backend(
            config.backend, config, sensor=recording.sensor, known_map=known
        )
        log = follow(backend, recording, pieces(recording, 8.0, 9.0, 0.0, 9.0))
        assert (log.resets == 0).all()


def test_the_pose_found_is_known_relative_to_the_cones_around() -> None:
    """After a jump, car and cones agree to the sensor's noise, not to a guess."""
    recording = drive("lidar", 1)
    backend = on_map(recording, true_map(recording))
    log = follow(backend, recording, pieces(recording, 8.0, 10.0, 0.0, 10.0))
    found = int(np.flatnonzero(log.resets == 1)[0])
    # Dozens of cones at 5 cm on the map and 2 cm seen.
    assert log.error_m[found] < 0.1
    estimate = backend.estimate()
    gap = between(true_pose(recording, estimate.stamp_s), estimate.pose)
    assert abs(gap[2]) < 0.01
    assert np.sqrt(np.diag(estimate.pose_cov)[:2]).max() < 0.1
