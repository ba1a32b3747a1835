"""A car that stands stays where it is, and so does its map."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conegraph.backends import make_backend
from conegraph.backends.car_motion import CarMotion
from conegraph.backends.landmark_filter import LandmarkFilter
from conegraph.backends.motion import OdometryIncrement
from conegraph.backends.standstill import (
    SIGMAS,
    STILL_MPS,
    WINDOW_S,
    StandstillWatch,
    standing,
)
from conegraph.backends.tracker import Tracker
from conegraph.config import MotionConfig, resolve_config
from conegraph.sim.cone_sensor import CAMERA, LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.sim.vehicle import VehicleModel
from conegraph.types import Array, Recording, VelocityObservation

STAND_S = 60.0
COV = np.diag([0.05**2, 0.005**2])


def watch(speed: Array, yaw_rate: Array, step_s: float = 0.01) -> StandstillWatch:
    result = StandstillWatch()
    for n, (u, r) in enumerate(zip(speed.tolist(), yaw_rate.tolist(), strict=True)):
        result.add(VelocityObservation(n * step_s, u, r, COV))
    return result


def noisy(n: int, u: float, r: float, seed: int = 0) -> StandstillWatch:
    rng = np.random.default_rng(seed)
    return watch(u + 0.05 * rng.standard_normal(n), r + 0.005 * rng.standard_normal(n))


def test_standing_is_told_from_creeping_and_turning() -> None:
    for seed in range(20):
        assert noisy(51, 0.0, 0.003, seed).stands(0.5)
        # The mean of 51 samples has a sigma of 7 mm/s; 0.06 is 5 of them beyond.
        assert not noisy(51, 0.06, 0.0, seed).stands(0.5)
        assert not noisy(51, 0.0, 0.05, seed).stands(0.5)


def test_setting_off_is_noticed_within_a_tenth_of_a_second() -> None:
    t = np.arange(60) * 0.01
    speed: Array = np.maximum(3.0 * (t - 0.5), 0.0).astype(np.float64)
    found = [watch(speed[: n + 1], np.zeros(n + 1)).stands(0.01 * n) for n in range(60)]
    assert found[50]
    # By sample (4 sigmas and the limit at 3 m/s²) or by mean, whichever comes first.
    by_sample = (SIGMAS * 0.05 + STILL_MPS) / 3.0
    assert not any(found[50 + int(np.ceil(by_sample / 0.01)) + 1 :])
    assert not found[59]


def test_too_little_too_old_or_too_noisy_odometry_says_nothing() -> None:
    zero = np.zeros(51)
    assert watch(zero, zero).stands(0.5)
    assert not watch(zero[:3], zero[:3]).stands(0.02)
    assert not watch(zero, zero).stands(0.5 + WINDOW_S)
    assert not StandstillWatch().stands(0.0)
    loud = StandstillWatch()
    for n in range(51):
        loud.add(VelocityObservation(0.01 * n, 0.0, 0.0, np.diag([1.0, 1.0])))
    assert not loud.stands(0.5)


def test_a_standing_increment_is_none_and_says_so_sharply() -> None:
    measured = OdometryIncrement(
        0.1, np.ones(3), np.eye(3), np.ones(3), np.array([0.01, 0.002]), COV
    )
    stood = standing(measured)
    assert not stood.delta.any()
    assert not stood.bias_jacobian.any()
    # A millimetre per square root of second.
    assert np.sqrt(stood.cov[0, 0]) == pytest.approx(1e-3 * np.sqrt(0.1))
    np.testing.assert_array_equal(stood.velocity, measured.velocity)
    # A turn of 1 ± 1 rad in a tenth of a second was the gyro's bias.
    assert stood.bias is not None
    np.testing.assert_allclose(stood.bias, (10.0, 10.0))


def test_a_step_in_which_the_car_turned_and_stopped_is_not_one_of_standing() -> None:
    """One frame a second: half of it the car turns at 1 rad/s, half of it it stands."""
    config = MotionConfig()
    motion, filter_ = CarMotion(config), LandmarkFilter()
    motion.advance(filter_, 0.0)
    for n in range(101):
        turning = 1.0 if n < 50 else 0.0
        motion.queue.push(VelocityObservation(0.01 * n, 0.0, turning, COV))
    motion.advance(filter_, 1.0)
    assert filter_.vehicle[2] == pytest.approx(0.5, abs=0.01)
    assert motion.frames_standing == 0


@cache
def stand(sensor: str) -> Recording:
    recording = simulate(
        built_in_track("oval", 0),
        laps=1,
        seed=1,
        sensor=LIDAR if sensor == "lidar" else replace(CAMERA, rate_hz=15.0),
        vehicle=VehicleModel(stand_s=STAND_S),
        odometry=OdometrySensor(rate_hz=50.0),
        origin="start",
    )
    stream = tuple(e for e in recording.stream if e.stamp_s < STAND_S)
    return replace(recording, stream=stream)


@pytest.mark.parametrize("kind", ["ekf", "isam2"])
@pytest.mark.parametrize("sensor", ["camera", "lidar"])
def test_a_minute_of_standing_changes_nothing(kind: str, sensor: str) -> None:
    recording = stand(sensor)
    config = resolve_config({"backend": {"kind": kind}})
    backend = make_backend(config.backend, config, sensor=recording.sensor)
    poses, cones, laps = [], {}, 0
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        elif backend.observe_cones(event) is not None:
            poses.append(backend.estimate().pose)
            laps += len(backend.last_events.laps)
            laps += sum(c.accepted for c in backend.last_events.closures)
            cones[event.stamp_s] = len(backend.cone_map())
    pose = np.array(poses)
    assert np.hypot(pose[:, 0], pose[:, 1]).max() < 0.02
    assert np.rad2deg(np.abs(pose[:, 2])).max() < 0.2
    assert laps == 0
    # All that is in view is known after five seconds, and nothing comes to it.
    early = max(n for stamp, n in cones.items() if stamp < 5.0)
    assert cones[max(cones)] == early
    assert backend.estimate().status == "OK"


def biased(bias_radps: float) -> Recording:
    """Return a short drive after two seconds of standing, its gyro off by a bias."""
    recording = simulate(
        built_in_track("oval", 0),
        laps=1,
        seed=4,
        sensor=replace(CAMERA, rate_hz=10.0),
        vehicle=VehicleModel(stand_s=2.0),
        odometry=OdometrySensor(rate_hz=50.0, gyro_bias_sigma_radps=0.0),
        origin="start",
    )
    stream = tuple(
        replace(e, r_radps=e.r_radps + bias_radps)
        if isinstance(e, VelocityObservation)
        else e
        for e in recording.stream
        if e.stamp_s < 12.0
    )
    return replace(recording, stream=stream)


@pytest.mark.parametrize("kind", ["ekf", "isam2"])
@pytest.mark.parametrize("still", [True, False])
def test_the_gyro_bias_converges_within_its_own_sigma(kind: str, still: bool) -> None:
    true = 0.01
    recording = biased(true)
    config = resolve_config(
        {"backend": {"kind": kind}, "motion": {"standstill": still}}
    )
    backend = make_backend(config.backend, config, sensor=recording.sensor)
    assert isinstance(backend, Tracker)
    found = []
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        elif backend.observe_cones(event) is not None:
            car = backend.map.filter
            sigma = float(np.sqrt(car.vehicle_cov[5, 5]))
            found.append((event.stamp_s, float(car.vehicle[5]), sigma))
    stamp, bias, sigma = np.array(found).T
    assert sigma[0] == pytest.approx(0.01, rel=0.01)
    # The graph's tracker is told how far the bias is known where the car is: once the
    # car has seen some cones twice, that is how far it is known.
    known = stamp > (0.0 if kind == "ekf" else 4.0)
    assert (np.abs(bias - true) < 3.0 * sigma)[known].all()
    assert abs(bias[-1] - true) < 3.0 * sigma[-1]
    assert sigma[-1] < 0.2 * sigma[0]
    if still:
        # White noise of 0.005 rad/s at 50 Hz over 1.5 s, and the walk of the bias.
        stood = np.searchsorted(stamp, 2.0) - 1
        expected = 0.005 / np.sqrt(75.0)
        assert sigma[stood] < 1.5 * expected
        assert abs(bias[stood] - true) < 3.0 * expected
