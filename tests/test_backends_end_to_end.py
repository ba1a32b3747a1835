"""Whole drives through both back ends, against the truth and against themselves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from conegraph.backends import Backend, make_backend
from conegraph.config import Config, resolve_config
from conegraph.eval.map_metrics import map_metrics
from conegraph.geometry import compose, constant_twist
from conegraph.sim.cone_sensor import CAMERA, RangeFalloff
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import (
    Array,
    ConeClass,
    ConeMap,
    ConeObservations,
    Event,
    Lap,
    Recording,
    Status,
    Trajectory,
    TruthMap,
    VelocityObservation,
)

KINDS = ["ekf", "isam2"]
PROFILES = ["default", "thesis"]

ONE_SIGHT_M = float(np.sqrt(np.trace(CAMERA.model.covariance(np.array([[5.0, 0]]))[0])))
"""Error of one sight from 5 m: 7.7 cm. Every cone of the lane is seen dozens of times,
and from as near as 2.6 m, so a map must be better than that."""


@dataclass(frozen=True)
class Outcome:
    """What a drive left behind."""

    backend: Backend
    laps: tuple[Lap, ...]
    poses: Array
    smoothed: Trajectory | None
    numbers: bytes


@cache
def oval(laps: int = 1, *, clean: bool = False) -> Recording:
    """Return a drive with odometry; clean has no false cones and no wrong class."""
    sensor = CAMERA
    if clean:
        sure = RangeFalloff(1.0)
        sensor = replace(sensor, false_per_frame=0.0, classification=sure)
    return simulate(
        built_in_track("oval", 0),
        laps=laps,
        seed=3,
        sensor=sensor,
        odometry=OdometrySensor(),
        origin="start",
    )


def truth(recording: Recording) -> tuple[Trajectory, TruthMap]:
    assert recording.truth_trajectory is not None
    assert recording.truth_map is not None
    return recording.truth_trajectory, recording.truth_map


def config(kind: str, profile: str = "default", **motion: object) -> Config:
    return resolve_config(
        {"backend": {"kind": kind, "profile": profile}, "motion": motion}
    )


def first_seconds(events: Iterable[Event], seconds: float) -> list[Event]:
    return [e for e in events if e.stamp_s <= seconds]


def drive(backend: Backend, events: Iterable[Event]) -> Outcome:
    """Feed a stream; keep every number that came out, bit by bit."""
    laps: list[Lap] = []
    poses, parts = [], []
    for event in events:
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
            continue
        matched = backend.observe_cones(event)
        if matched is None:
            continue
        laps += backend.last_events.laps
        got = backend.estimate()
        poses.append([got.stamp_s, *got.pose])
        parts += [got.pose, got.pose_cov, got.velocity, matched.landmark_id, matched.d2]
    smoothed = backend.finish()
    cone_map = backend.cone_map()
    parts += [cone_map.id, cone_map.xy_m, cone_map.cov_m2, cone_map.class_prob]
    if smoothed is not None:
        parts.append(smoothed.pose)
    numbers = b"".join(np.ascontiguousarray(p).tobytes() for p in parts)
    return Outcome(backend, tuple(laps), np.array(poses), smoothed, numbers)


def without_odometry(events: Iterable[Event]) -> list[Event]:
    return [e for e in events if isinstance(e, ConeObservations)]


def position_error(outcome: Outcome, recording: Recording) -> Array:
    """Return the distance (F,) of each causal estimate from the true position."""
    path, _ = truth(recording)
    row = np.searchsorted(path.stamp_s, outcome.poses[:, 0] - 1e-9)
    np.testing.assert_allclose(path.stamp_s[row], outcome.poses[:, 0])
    gap: Array = np.hypot(*(outcome.poses[:, 1:3] - path.pose[row, :2]).T)
    return gap


def true_crossings(recording: Recording) -> Array:
    """Return when the true path crosses the line between the big orange cones."""
    path, cones = truth(recording)
    big = cones.xy_m[cones.cone_class == ConeClass.BIG_ORANGE]
    gate = 0.5 * (big[big[:, 1] > 0].mean(axis=0) + big[big[:, 1] <= 0].mean(axis=0))
    x, y = path.pose[:, 0] - gate[0], path.pose[:, 1] - gate[1]
    cross = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0) & (np.abs(y[1:]) < 6.0))
    share = x[cross] / (x[cross] - x[cross + 1])
    when: Array = path.stamp_s[cross] + share * np.diff(path.stamp_s)[cross]
    return when


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("odometry", [True, False])
def test_a_lap_of_the_oval_is_mapped_and_timed(kind: str, odometry: bool) -> None:
    recording = oval()
    settings = config(kind)
    events = list(recording.events())
    backend = make_backend(settings.backend, settings, sensor=recording.sensor)
    outcome = drive(backend, events if odometry else without_odometry(events))
    _, cones = truth(recording)
    cone_map = backend.cone_map()
    metrics = map_metrics(cone_map, cones, start_pose=np.zeros(3))
    assert (metrics.precision, metrics.recall) == (1.0, 1.0)
    assert metrics.rmse_aligned_m < ONE_SIGHT_M
    assert metrics.colour is not None
    assert metrics.colour.errors == 0
    # In the frame of the start: a sight from 10 m, once, at the far end of a lap.
    assert metrics.start_frame is not None
    assert metrics.start_frame.rmse_m < 0.26
    assert np.sqrt((position_error(outcome, recording) ** 2).mean()) < 0.26
    assert backend.estimate().status == Status.OK
    crossings = true_crossings(recording)
    assert len(outcome.laps) == len(crossings) - 1 == 1
    # At 5 m/s and more, 0.26 m are 50 ms.
    assert outcome.laps[0].start_s == pytest.approx(crossings[0], abs=0.05)
    assert outcome.laps[0].end_s == pytest.approx(crossings[1], abs=0.05)
    if kind == "isam2":
        assert outcome.smoothed is not None
        np.testing.assert_array_equal(outcome.smoothed.stamp_s, outcome.poses[:, 0])
    else:
        assert outcome.smoothed is None


@pytest.mark.parametrize("kind", KINDS)
def test_the_thesis_profile_maps_a_clean_lap_too(kind: str) -> None:
    recording = oval(clean=True)
    settings = config(kind, "thesis")
    backend = make_backend(settings.backend, settings, sensor=recording.sensor)
    outcome = drive(backend, recording.events())
    _, cones = truth(recording)
    # Without merging and deletion it keeps duplicates, but misses nothing, and
    # nothing lies farther off than half a lane.
    metrics = map_metrics(
        backend.cone_map(), cones, start_pose=np.zeros(3), max_distance_m=1.5
    )
    assert metrics.recall == 1.0
    assert metrics.false_cones == 0
    assert len(outcome.laps) == 1


def dirty(events: Sequence[Event], rng: np.random.Generator) -> list[Event]:
    """Strew rubbish into a stream, none of which may have any effect."""
    soiled: list[Event] = []
    nan2 = np.full((2, 2), np.nan)
    for n, event in enumerate(events):
        if isinstance(event, VelocityObservation):
            soiled.append(event)
            if n % 7 == 0:
                soiled.append(replace(event, u_mps=np.nan))
                soiled.append(replace(event, cov=nan2))
                soiled.append(replace(event, stamp_s=event.stamp_s - 0.005, u_mps=9.0))
            continue
        k = 3
        bad = ConeObservations(
            event.stamp_s,
            np.vstack([np.full((k, 2), np.nan), event.xy_m]),
            np.concatenate([np.tile(nan2, (k, 1, 1)), event.cov_m2]),
            np.vstack([np.full((k, 5), 0.2), event.class_prob]),
        )
        soiled.append(bad)
        stale = event.stamp_s - rng.choice([0.0, 0.01, 1.0])
        shifted = event.xy_m + rng.normal(size=2)
        soiled.append(replace(event, stamp_s=float(stale), xy_m=shifted))
        soiled.append(replace(event, stamp_s=float("nan")))
    return soiled


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("profile", PROFILES)
def test_rubbish_in_the_stream_is_counted_and_changes_not_one_bit(
    kind: str, profile: str
) -> None:
    recording = oval()
    settings = config(kind, profile)
    events = first_seconds(recording.events(), 5.0)
    frames = sum(isinstance(e, ConeObservations) for e in events)
    soiled = dirty(events, np.random.default_rng(0))
    pure, strewn = (
        drive(make_backend(settings.backend, settings, sensor=recording.sensor), each)
        for each in (events, soiled)
    )
    assert len(pure.poses) == frames
    assert strewn.numbers == pure.numbers
    assert not pure.backend.rejected
    samples = sum(
        isinstance(e, VelocityObservation) and n % 7 == 0 for n, e in enumerate(events)
    )
    assert dict(strewn.backend.rejected) == {
        "odometry: not a number": 2 * samples,
        "odometry: stamp goes backwards": samples,
        "cone: position is not a number": 3 * frames,
        "frame: stamp does not increase": frames,
        "frame: stamp is not a number": frames,
    }


@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_of_rubbish_alone_is_an_empty_frame(kind: str) -> None:
    recording = oval()
    settings = config(kind)
    streams: list[list[Event]] = [[], []]
    for n, event in enumerate(first_seconds(recording.events(), 3.0)):
        blind = isinstance(event, ConeObservations) and n % 5 == 0
        if not blind or isinstance(event, VelocityObservation):
            for stream in streams:
                stream.append(event)
            continue
        streams[0].append(event.subset(np.zeros(len(event), dtype=bool)))
        streams[1].append(replace(event, xy_m=event.xy_m * np.nan))
    empty, rubbish = (
        drive(make_backend(settings.backend, settings, sensor=recording.sensor), each)
        for each in streams
    )
    assert rubbish.numbers == empty.numbers
    assert rubbish.backend.rejected["cone: position is not a number"] > 0


@pytest.mark.parametrize("kind", KINDS)
def test_switched_off_odometry_is_no_odometry(kind: str) -> None:
    recording = oval()
    settings = config(kind, use_odometry=False)
    events = first_seconds(recording.events(), 3.0)
    off, none = (
        drive(make_backend(settings.backend, settings, sensor=recording.sensor), each)
        for each in (events, without_odometry(events))
    )
    assert off.numbers == none.numbers


def known_map(cones: TruthMap) -> ConeMap:
    n = len(cones)
    return ConeMap(
        cones.id,
        cones.xy_m,
        np.tile(0.02**2 * np.eye(2), (n, 1, 1)),
        np.eye(5)[cones.cone_class],
        np.full(n, 50),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_on_a_known_map_the_car_is_found_and_the_map_does_not_grow(kind: str) -> None:
    recording = oval()
    _, cones = truth(recording)
    settings = config(kind)
    backend = make_backend(
        settings.backend,
        settings,
        sensor=recording.sensor,
        known_map=known_map(cones),
        add_cones=False,
    )
    outcome = drive(backend, first_seconds(recording.events(), 10.0))
    cone_map = backend.cone_map()
    assert set(cone_map.id.tolist()) <= set(cones.id.tolist())
    assert len(cone_map) == len(cones)
    # The map's own error, and what one sight tells of the car.
    moved = np.linalg.norm(cone_map.xy_m - cones.xy_m, axis=1)
    assert np.sqrt((moved**2).mean()) < 0.02 * 2**0.5
    assert np.sqrt((position_error(outcome, recording) ** 2).mean()) < ONE_SIGHT_M


@pytest.mark.parametrize("kind", KINDS)
def test_estimates_look_ahead_over_odometry_and_never_back(kind: str) -> None:
    settings = config(kind)
    backend = make_backend(settings.backend, settings)
    cov = np.diag([0.01, 0.0001])
    for n in range(11):
        backend.observe_velocity(VelocityObservation(0.01 * n, 8.0, 0.5, cov))
        if n in (0, 5):
            empty = np.zeros((0, 2))
            backend.observe_cones(ConeObservations(0.01 * n, empty, empty, empty))
    got = backend.estimate()
    assert got.stamp_s == pytest.approx(0.1)
    np.testing.assert_allclose(got.pose, constant_twist(8.0, 0.5, 0.1), atol=1e-6)
    np.testing.assert_allclose(got.velocity, [8.0, 0.5], atol=1e-6)
    backend.predict(0.02)
    np.testing.assert_array_equal(backend.estimate().pose, got.pose)
    backend.predict(0.2)
    ahead = backend.estimate()
    held = compose(got.pose, constant_twist(8.0, 0.5, 0.1))
    np.testing.assert_allclose(ahead.pose, held, atol=1e-6)
    assert (np.diag(ahead.pose_cov) > np.diag(got.pose_cov)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_after_the_last_frame_the_status_falls(kind: str) -> None:
    recording = oval()
    settings = config(kind)
    backend = make_backend(settings.backend, settings, sensor=recording.sensor)
    events = without_odometry(first_seconds(recording.events(), 1.0))
    assert backend.estimate().status == Status.INIT
    drive(backend, events)
    assert backend.estimate().status == Status.OK
    backend.predict(events[-1].stamp_s + 1.0)
    assert backend.estimate().status == Status.DEGRADED
    backend.predict(events[-1].stamp_s + 3.0)
    assert backend.estimate().status == Status.LOST


def standing(stamps: Sequence[float], *, odometry: bool) -> list[Event]:
    """Return what a car sees that stands before six cones."""
    xy = np.array([[5, 2], [5, -2], [8, 2.2], [8, -2], [11, 3], [11, -1.0]])
    cov = np.tile(0.01 * np.eye(2), (6, 1, 1))
    prob = np.tile(np.eye(5)[0], (6, 1))
    events: list[Event] = []
    for stamp in stamps:
        if odometry:
            still = VelocityObservation(stamp, 0.0, 0.0, np.diag([1e-4, 1e-6]))
            events.append(still)
        events.append(ConeObservations(stamp, xy, cov, prob))
    return events


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("odometry", [True, False])
def test_no_spacing_of_stamps_breaks_an_estimator(
    kind: str, profile: str, odometry: bool
) -> None:
    regular = (np.arange(20) * 0.05).tolist()
    spacings = [
        sorted(regular + [t + d for t in regular[5:8]]) for d in (1e-3, 1e-6, 1e-9)
    ]
    spacings += [regular + [t + gap for t in regular] for gap in (60.0, 1e3, 1e6)]
    spacings.append([1.7e9 + t for t in regular])
    settings = config(kind, profile)
    for stamps in spacings:
        backend = make_backend(settings.backend, settings)
        outcome = drive(backend, standing(stamps, odometry=odometry))
        assert np.isfinite(outcome.poses).all()
        # Nothing ever moved and all measurements agree.
        np.testing.assert_allclose(outcome.poses[:, 1:], 0.0, atol=1e-3)
        assert np.isfinite(backend.cone_map().cov_m2).all()
        assert len(backend.cone_map()) == 6
