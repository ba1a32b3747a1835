"""Drives whose detections lie about colours, hide cones and invent them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from conegraph.backends import make_backend
from conegraph.backends.closure import AT_GATE_M
from conegraph.config import resolve_config
from conegraph.eval.map_metrics import MapMetrics, map_metrics
from conegraph.sim.cone_sensor import CAMERA, LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.faults import StreamFaults
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import (
    Array,
    ConeClass,
    ConeMap,
    ConeObservations,
    Lap,
    LoopClosure,
    Recording,
    TrackLayout,
    VelocityObservation,
)

SENSORS = {"camera": CAMERA, "lidar": LIDAR}

UNKNOWN = np.array([0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Outcome:
    """What a drive left behind."""

    cone_map: ConeMap
    laps: list[Lap]
    closures: list[LoopClosure]
    metrics: MapMetrics


def with_second_gate(layout: TrackLayout) -> TrackLayout:
    """Return the oval with the start's big cones once more, across its far side."""
    big = layout.cone_class == ConeClass.BIG_ORANGE
    middle = 0.5 * (layout.xy_m.min(axis=0) + layout.xy_m.max(axis=0))
    return replace(
        layout,
        xy_m=np.vstack([layout.xy_m, 2.0 * middle - layout.xy_m[big]]),
        cone_class=np.concatenate([layout.cone_class, layout.cone_class[big]]),
    )


@cache
def drive(sensor: str, faults: StreamFaults, *, second: bool) -> Recording:
    layout = built_in_track("oval", 0)
    return simulate(
        with_second_gate(layout) if second else layout,
        laps=1,
        seed=6,
        sensor=SENSORS[sensor],
        odometry=OdometrySensor(),
        origin="start",
        faults=faults,
    )


def run(kind: str, recording: Recording, *, colours: bool = True) -> Outcome:
    settings = resolve_config({"backend": {"kind": kind}})
    backend = make_backend(settings.backend, settings, sensor=recording.sensor)
    laps: list[Lap] = []
    closures: list[LoopClosure] = []
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        elif isinstance(event, ConeObservations):
            prob = event.class_prob
            if not colours:
                prob = np.tile(UNKNOWN, (len(event), 1))
            backend.observe_cones(replace(event, class_prob=prob))
            laps += backend.last_events.laps
            closures += backend.last_events.closures
    backend.finish()
    assert recording.truth_map is not None
    cone_map = backend.cone_map()
    metrics = map_metrics(cone_map, recording.truth_map, start_pose=np.zeros(3))
    return Outcome(cone_map, laps, closures, metrics)


def passes(recording: Recording, x_m: float) -> tuple[Array, Array]:
    """Return when the true car passes x in the start's direction, and how far on."""
    path = recording.truth_trajectory
    assert path is not None
    x, y = path.pose[:, 0] - x_m, path.pose[:, 1]
    k = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0) & (np.abs(y[1:]) < 6.0))
    share = x[k] / (x[k] - x[k + 1])
    odometer = np.append(0.0, np.hypot(*np.diff(path.pose[:, :2], axis=0).T).cumsum())
    return path.stamp_s[k] + share * np.diff(path.stamp_s)[k], odometer[k]


def accepted(outcome: Outcome) -> list[LoopClosure]:
    return [c for c in outcome.closures if c.accepted]


@pytest.mark.parametrize(("kind", "sensor"), [("ekf", "camera"), ("isam2", "lidar")])
def test_wrong_colours_misses_clutter_and_a_second_gate_are_survived(
    kind: str, sensor: str
) -> None:
    faults = StreamFaults(
        wrong_colour=0.05, unknown_colour=0.2, missed=0.1, false_cones=0.05
    )
    recording = drive(sensor, faults, second=True)
    outcome = run(kind, recording)
    metrics = outcome.metrics
    assert metrics.precision >= 0.99
    assert metrics.recall >= 0.99
    assert metrics.duplicates == 0
    assert metrics.rmse_aligned_m < 0.1
    assert metrics.colour is not None
    wrong = metrics.colour.errors + metrics.colour.orange_size + metrics.colour.unknown
    assert wrong <= 0.02 * metrics.colour.checked
    # A lap and a closure where the car is back, and nothing at the second gate.
    _, lap_m = passes(recording, 1.0)
    assert len(outcome.laps) == 1
    (closure,) = accepted(outcome)
    # It comes into view before it is reached, and is passed before three are matched.
    assert closure.distance_m == pytest.approx(lap_m[-1], abs=AT_GATE_M)


@pytest.mark.parametrize(("kind", "sensor"), [("ekf", "lidar"), ("isam2", "camera")])
def test_without_any_colour_the_lap_closes_at_the_place_of_the_start(
    kind: str, sensor: str
) -> None:
    recording = drive(sensor, StreamFaults(), second=False)
    outcome = run(kind, recording, colours=False)
    metrics = outcome.metrics
    assert (metrics.precision, metrics.recall) == (1.0, 1.0)
    assert metrics.colour is not None
    assert metrics.colour.unknown == metrics.colour.checked
    assert len(accepted(outcome)) == 1
    # With no start cones to see the gate is a metre ahead of the start.
    crossed_s, _ = passes(recording, 1.0)
    (lap,) = outcome.laps
    # Frames are up to 0.1 s apart; what is left is the pose's own error at some 15 m/s.
    assert lap.start_s == pytest.approx(crossed_s[0], abs=0.02)
    assert lap.end_s == pytest.approx(crossed_s[1], abs=0.02)
