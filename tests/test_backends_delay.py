"""Frames that arrive late are applied at their stamps; the pose is led on to now."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conegraph.backends import make_backend
from conegraph.config import resolve_config
from conegraph.geometry import between, wrap_angle
from conegraph.sim.cone_sensor import LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Array, ConeObservations, Recording, VelocityObservation

DELAY_S = 0.2
ODOMETRY = OdometrySensor()


@cache
def drive(delay_s: float) -> Recording:
    recording = simulate(
        built_in_track("oval", 0),
        laps=1,
        seed=2,
        sensor=replace(LIDAR, delay_s=delay_s),
        odometry=ODOMETRY,
        origin="start",
    )
    # Up to a last frame, and the odometry that comes before it.
    last = next(
        n
        for n, e in enumerate(recording.stream)
        if isinstance(e, ConeObservations) and e.stamp_s == 12.0
    )
    return replace(recording, stream=recording.stream[: last + 1])


@cache
def run(kind: str, delay_s: float) -> tuple[Array, Array, Array]:
    """Return frame stamps, estimates (stamp, pose) and the map's positions."""
    config = resolve_config({"backend": {"kind": kind}})
    recording = drive(delay_s)
    backend = make_backend(config.backend, config, sensor=recording.sensor)
    stamps, estimates = [], []
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        elif backend.observe_cones(event) is not None:
            got = backend.estimate()
            stamps.append(event.stamp_s)
            estimates.append([got.stamp_s, *got.pose])
    backend.finish()
    return np.array(stamps), np.array(estimates), backend.cone_map().xy_m


def true_poses(stamp_s: Array) -> Array:
    path = drive(0.0).truth_trajectory
    assert path is not None
    row = np.searchsorted(path.stamp_s, stamp_s - 1e-9)
    np.testing.assert_allclose(path.stamp_s[row], stamp_s, atol=1e-9)
    return path.pose[row]


@pytest.mark.parametrize("kind", ["ekf", "isam2"])
def test_a_delay_changes_nothing_in_the_map(kind: str) -> None:
    in_time, late = run(kind, 0.0), run(kind, DELAY_S)
    common = min(len(in_time[0]), len(late[0]))
    np.testing.assert_array_equal(in_time[0][:common], late[0][:common])
    np.testing.assert_allclose(late[2], in_time[2], atol=1e-9)


@pytest.mark.parametrize("kind", ["ekf", "isam2"])
def test_the_estimate_is_of_now_and_as_good_as_odometry(kind: str) -> None:
    stamp, at_frame, _ = run(kind, 0.0)
    late_stamp, now, _ = run(kind, DELAY_S)
    n = len(late_stamp)
    np.testing.assert_allclose(at_frame[:, 0], stamp)
    np.testing.assert_allclose(now[:, 0] - late_stamp, DELAY_S, atol=0.011)
    # What was added since the frame, against what the car did since then.
    added = between(at_frame[:n, 1:], now[:, 1:])
    true = between(true_poses(stamp[:n]), true_poses(now[:, 0]))
    error = added - true
    # White noise of a sample, held for 10 ms, summed over 0.2 s; the bias unknown by
    # its sigma turns the car, and the turn moves 2 m of path aside by half of it.
    step_s = 1.0 / ODOMETRY.rate_hz
    along_m = ODOMETRY.speed_sigma_mps * np.sqrt(step_s * DELAY_S)
    white = ODOMETRY.yaw_rate_sigma_radps * np.sqrt(step_s * DELAY_S)
    yaw_rad = np.hypot(white, ODOMETRY.gyro_bias_sigma_radps * DELAY_S)
    aside_m = 0.5 * yaw_rad * 12.0 * DELAY_S
    moving = slice(20, None)
    rms = np.sqrt(np.mean(error[moving] ** 2, axis=0))
    assert rms[0] < 1.5 * along_m
    assert rms[1] < 1.5 * aside_m
    assert np.sqrt(np.mean(wrap_angle(error[moving, 2]) ** 2)) < 1.5 * yaw_rad
    # Without the lead the car would be where it was: two metres behind.
    assert np.hypot(true[moving, 0], true[moving, 1]).mean() > 100.0 * rms[0]
