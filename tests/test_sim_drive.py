"""Whole drives: repeatable, ordered, true, and fast."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conegraph.geometry import between, to_child
from conegraph.io.tracks import read_track
from conegraph.sim.cone_sensor import CAMERA, LIDAR, ConeSensor
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import BUILT_IN_TRACKS, built_in_track
from conegraph.types import (
    Array,
    ConeObservations,
    Recording,
    TrackLayout,
    VelocityObservation,
)

OVAL = built_in_track("oval", 0)
NOISELESS = OdometrySensor(
    speed_sigma_mps=0.0, yaw_rate_sigma_radps=0.0, gyro_bias_sigma_radps=0.0
)


def cone_frames(recording: Recording) -> list[ConeObservations]:
    return [e for e in recording.events() if isinstance(e, ConeObservations)]


def velocities(recording: Recording) -> list[VelocityObservation]:
    return [e for e in recording.events() if isinstance(e, VelocityObservation)]


def all_numbers(recording: Recording) -> Array:
    """Return every number of a recording in a row."""
    truth, cones = recording.truth_trajectory, recording.truth_map
    assert truth is not None
    assert cones is not None
    parts = [truth.stamp_s, truth.pose.ravel(), cones.xy_m.ravel()]
    for event in recording.events():
        if isinstance(event, ConeObservations):
            assert event.truth_id is not None
            parts += [
                event.xy_m.ravel(),
                event.cov_m2.ravel(),
                event.truth_id.astype(float),
            ]
            parts += [event.class_prob.ravel(), np.array([event.stamp_s])]
        else:
            parts.append(np.array([event.stamp_s, event.u_mps, event.r_radps]))
    return np.concatenate(parts)


def poses_at(recording: Recording, stamps: Array) -> Array:
    truth = recording.truth_trajectory
    assert truth is not None
    index = np.searchsorted(truth.stamp_s, stamps)
    np.testing.assert_array_equal(truth.stamp_s[index], stamps)
    chosen: Array = truth.pose[index]
    return chosen


def test_the_same_seed_gives_the_same_numbers_and_another_others() -> None:
    first, again, other = (
        all_numbers(simulate(OVAL, laps=1, seed=s, odometry=OdometrySensor()))
        for s in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert len(first) != len(other) or not np.array_equal(first, other)


def test_switching_odometry_off_changes_nothing_else() -> None:
    with_it = simulate(OVAL, laps=1, seed=5, odometry=OdometrySensor())
    without = simulate(OVAL, laps=1, seed=5)
    assert not velocities(without)
    np.testing.assert_array_equal(
        all_numbers(replace(with_it, stream=tuple(cone_frames(with_it)))),
        all_numbers(without),
    )


def test_another_sensor_sees_the_same_drive() -> None:
    camera, lidar = (simulate(OVAL, laps=1, seed=5, sensor=s) for s in (CAMERA, LIDAR))
    stamps = np.arange(0.0, 10.0, 0.1).round(9)
    np.testing.assert_allclose(poses_at(camera, stamps), poses_at(lidar, stamps))


@pytest.mark.parametrize("name", BUILT_IN_TRACKS)
def test_cones_lie_where_the_truth_puts_them(name: str) -> None:
    """Seen from the true pose each reported cone is within 6 sigma of itself."""
    recording = simulate(built_in_track(name, 2), laps=1, seed=1, sensor=LIDAR)
    cones, frames = recording.truth_map, cone_frames(recording)
    assert cones is not None
    np.testing.assert_array_equal(cones.id, np.arange(len(cones)))
    poses = poses_at(recording, np.array([f.stamp_s for f in frames]))
    for frame, pose in zip(frames, poses, strict=True):
        assert frame.truth_id is not None
        true = frame.truth_id >= 0
        expected = to_child(pose, cones.xy_m[frame.truth_id[true]])
        off = frame.xy_m[true] - expected
        sigma = np.sqrt(np.linalg.eigvalsh(frame.cov_m2[true])[:, 1])
        assert (np.hypot(*off.T) < 6 * sigma + 1e-3).all()


def test_true_speed_and_yaw_rate_are_those_of_the_true_poses() -> None:
    recording = simulate(OVAL, laps=1, seed=1, odometry=NOISELESS)
    truth = recording.truth_trajectory
    assert truth is not None
    read = velocities(recording)
    stamps = np.array([v.stamp_s for v in read])
    step = between(poses_at(recording, stamps[:-1]), poses_at(recording, stamps[1:]))
    u, r = np.array([[v.u_mps, v.r_radps] for v in read]).T
    dt = np.diff(stamps)
    np.testing.assert_allclose(
        np.hypot(step[:, 0], step[:, 1]) / dt, (u[1:] + u[:-1]) / 2, atol=0.02
    )
    np.testing.assert_allclose(step[:, 2] / dt, (r[1:] + r[:-1]) / 2, atol=0.02)


def test_events_come_in_the_order_of_their_arrival() -> None:
    sensor = replace(CAMERA, delay_s=0.105)
    recording = simulate(OVAL, laps=1, sensor=sensor, odometry=OdometrySensor())
    arrival = [
        e.stamp_s + (0.105 if isinstance(e, ConeObservations) else 0.0)
        for e in recording.events()
    ]
    assert arrival == sorted(arrival)
    prompt = simulate(OVAL, laps=1, odometry=OdometrySensor())
    stamps = [e.stamp_s for e in prompt.events()]
    assert stamps == sorted(stamps)
    assert isinstance(prompt.stream[0], VelocityObservation)
    assert isinstance(prompt.stream[1], ConeObservations)


def test_the_start_can_be_the_origin() -> None:
    there = replace(
        OVAL,
        xy_m=OVAL.xy_m + np.array([30.0, -4.0]),
        start_pose=np.array([30.0, -4.0, 0.0]),
        centerline_m=None,
    )
    track = simulate(there, laps=1, seed=2)
    start = simulate(there, laps=1, seed=2, origin="start")
    assert track.truth_trajectory is not None
    assert start.truth_trajectory is not None
    assert start.truth_map is not None
    pose = track.truth_trajectory.pose
    np.testing.assert_allclose(pose[0, :2], [30.0, -4.0], atol=0.5)
    np.testing.assert_allclose(start.truth_trajectory.pose[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        start.truth_trajectory.pose, between(pose[0], pose), atol=1e-12
    )
    np.testing.assert_allclose(start.truth_map.xy_m, to_child(pose[0], there.xy_m))
    np.testing.assert_array_equal(
        np.vstack([f.xy_m for f in cone_frames(track)]),
        np.vstack([f.xy_m for f in cone_frames(start)]),
    )


@pytest.mark.parametrize("laps", [1, 3])
def test_every_lap_crosses_the_start_line_and_runs_on(laps: int) -> None:
    recording = simulate(OVAL, laps=laps)
    truth = recording.truth_trajectory
    assert truth is not None
    x, y, _ = truth.pose.T
    crossing = (x[:-1] < 6.0) & (x[1:] >= 6.0) & (np.abs(y[1:]) < 2.0)
    assert crossing.sum() == laps + 1
    last = truth.stamp_s[np.flatnonzero(crossing)[-1]]
    assert truth.stamp_s[-1] - last == pytest.approx(2.0, abs=0.05)
    standing = truth.pose[truth.stamp_s <= 1.0]
    np.testing.assert_array_equal(standing, np.tile(standing[0], (len(standing), 1)))


def test_the_recording_says_what_its_sensor_is() -> None:
    recording = simulate(OVAL, laps=1, sensor=LIDAR)
    assert recording.name == "oval"
    assert recording.sensor is LIDAR.model
    assert recording.n_frames == len(cone_frames(recording))
    assert recording.truth_trajectory is not None
    spacing = np.diff(recording.truth_trajectory.stamp_s)
    assert spacing.max() <= 0.01 + 1e-9
    assert spacing.min() > 1e-4


@pytest.mark.parametrize("sensor", [CAMERA, LIDAR], ids=["camera", "lidar"])
def test_a_drive_is_simulated_at_fifty_times_real_time(sensor: ConeSensor) -> None:
    layout = built_in_track("autocross", 0)
    began = time.perf_counter()
    recording = simulate(layout, laps=3, sensor=sensor, odometry=OdometrySensor())
    took = time.perf_counter() - began
    assert recording.truth_trajectory is not None
    assert recording.truth_trajectory.stamp_s[-1] > 50.0 * took


def test_real_tracks_can_be_driven(data_dir: Path) -> None:
    """On every layout file a lap sees nearly all cones of the lane."""
    files = sorted(
        p
        for p in data_dir.glob("tracks_*/*")
        if p.suffix in (".yaml", ".csv") and not p.stem.endswith("center_line")
    )
    assert len(files) >= 31
    for path in files:
        layout: TrackLayout = read_track(path)
        frames = cone_frames(simulate(layout, laps=1, sensor=LIDAR))
        seen = np.unique(
            np.concatenate([f.truth_id for f in frames if f.truth_id is not None])
        )
        known = np.flatnonzero(layout.cone_class < 4)
        assert np.isin(known, seen).mean() > 0.97, path.stem
