"""Noise that was put into a stream is found again, whatever was assumed at first."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conegraph.backends.innovations import innovations, settle
from conegraph.backends.noise_parameters import noise_parameters, range_curve
from conegraph.backends.sensor_noise import polar_sigmas
from conegraph.backends.tuning import Tuning, tune
from conegraph.config import resolve_config
from conegraph.errors import SourceError
from conegraph.sim.cone_sensor import CAMERA, LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Recording

NOISY = OdometrySensor(rate_hz=20.0, speed_sigma_mps=0.25, yaw_rate_sigma_radps=0.05)
CAMERA_5_HZ = replace(CAMERA, rate_hz=5.0)


@cache
def drive(sensor: str, odometry: bool) -> Recording:
    return simulate(
        built_in_track("oval", 0),
        laps=1,
        seed=21,
        sensor=LIDAR if sensor == "lidar" else CAMERA_5_HZ,
        odometry=NOISY if odometry else None,
        origin="start",
    )


@cache
def tuned(sensor: str, odometry: bool, scale: float, kind: str) -> Tuning:
    recording = drive(sensor, odometry)
    tree = {"sensor": {"scale": scale}, "motion": {"odometry_scale": [1.0, scale]}}
    return tune(
        list(recording.events()),
        resolve_config(tree),
        recording.sensor,
        frames=80,
        kind="scale" if kind == "scale" else "model",
    )


def tolerance(error: float) -> float:
    """Four sigmas of the estimate, and the 2 % at which the search ends."""
    return 4.0 * error + 0.02


@pytest.mark.parametrize(("scale", "odometry"), [(0.5, True), (2.0, False)])
def test_a_factor_on_all_noise_is_found(scale: float, odometry: bool) -> None:
    result = tuned("camera", odometry, scale, "scale")
    change = result.changes[0]
    assert (change.name, change.before) == ("sensor.scale", scale)
    # 80 frames of five cones: 1 / sqrt(2 * 800) is 2.5 %, and the car takes some.
    assert 0.02 < change.error < 0.06
    assert abs(np.log(change.after)) < tolerance(change.error)
    assert result.converged
    assert result.config.sensor.scale == change.after
    if odometry:
        yaw = result.changes[2]
        assert yaw.before == scale
        assert yaw.error < 0.35
        assert abs(np.log(yaw.after)) < tolerance(yaw.error)


def test_the_sensor_model_is_found() -> None:
    result = tuned("camera", False, 2.0, "model")
    near, far, bearing = result.changes[:3]
    for change in (near, far):
        r = float(change.name.split()[3])
        true, _ = polar_sigmas(np.array([r]), CAMERA.model)
        # The range in the name is rounded to 0.05 m: 2 % of sigma at 5 m.
        off = abs(np.log(change.after / true[0]))
        assert off < tolerance(change.error) + 0.02
    off = abs(np.log(bearing.after / CAMERA.model.bearing_sigma_rad))
    assert off < tolerance(bearing.error)
    sensor = result.config.sensor
    assert (sensor.noise_from, sensor.scale) == ("model", 1.0)
    assert sensor.bearing_sigma_rad == bearing.after


@pytest.mark.parametrize(("scale", "odometry"), [(0.5, True), (2.0, False)])
def test_the_tuned_innovations_are_white_and_as_with_the_true_noise(
    scale: float, odometry: bool
) -> None:
    result = tuned("camera", odometry, scale, "scale")
    recording = drive("camera", odometry)
    truth = settle(recording.events(), resolve_config({}), recording.sensor).nis
    for rows, before, after in (
        (truth[:80], result.before, result.after),
        (truth[80:], result.check_before, result.check_after),
    ):
        assert before is not None
        assert after is not None
        true = rows[:, 0].sum() / rows[:, 1].sum()
        assert abs(np.log(before.nis_per_dof / true)) > 0.3
        # NIS goes with the square of sigma, which is known to 2.5 %; without
        # odometry the car's accelerations, known to a quarter, take as much again.
        assert after.nis_per_dof == pytest.approx(true, rel=0.1 if odometry else 0.2)
    assert abs(result.after.correlation) < 4.0 / np.sqrt(800.0)
    assert result.after.overconfident_frames == 0
    assert result.holds
    worse = replace(result.after, overconfident_frames=81)
    assert not replace(result, check_after=worse).holds
    assert replace(result, check_before=None, check_after=None).holds


def test_tuning_twice_gives_the_same_numbers() -> None:
    first = tuned("camera", False, 2.0, "scale")
    assert tuned.__wrapped__("camera", False, 2.0, "scale") == first


def test_the_replay_has_the_innovations_of_the_run() -> None:
    recording = drive("lidar", True)
    config = resolve_config({"association": {"method": "known"}})
    events = list(recording.events())[:1500]
    settled = settle(events, config, recording.sensor)
    seen = innovations(settled.events, config, recording.sensor)
    nis = [float(f.residual @ np.linalg.solve(f.cov, f.residual)) for f in seen]
    with_matches = settled.nis[settled.nis[:, 1] > 0]
    ran, dof = with_matches.sum(axis=0)
    # The run has false detections and cones that were seen less than three times.
    assert sum(len(f.residual) for f in seen) == pytest.approx(dof, rel=0.02)
    assert sum(nis) == pytest.approx(ran, rel=0.05)


def test_a_log_that_says_nothing_is_refused() -> None:
    recording = drive("camera", False)
    with pytest.raises(SourceError, match="too few cones were seen again"):
        tune(list(recording.events())[:5], resolve_config({}), recording.sensor)
    with pytest.raises(SourceError, match="0 matched sightings in 0 frames"):
        tune([], resolve_config({}), recording.sensor)
    # Matched, but never published: nothing of it is settled.
    strict = resolve_config({"landmarks": {"publish_hits": 1000}})
    with pytest.raises(SourceError, match="0 matched sightings in 80 frames"):
        tune(list(recording.events()), strict, recording.sensor, frames=80)


def test_the_range_curve_goes_through_both_sigmas_where_it_can() -> None:
    for low, high in ((0.04, 0.3), (0.1, 0.1), (0.02, 0.08)):
        c0, c1, c2 = range_curve((3.0, 9.0), (low, high))
        assert min(c0, c1, c2) >= 0.0
        if c0 > 0.0:
            assert c0 + 9.0 * c2 == pytest.approx(low)
        assert c0 + 81.0 * c2 == pytest.approx(high)
    np.testing.assert_allclose(range_curve((3.0, 9.0), (0.3, 0.1)), (0.2, 0.0, 0.0))
    # Rising faster than the square of the range: through the origin and the far one.
    steep = range_curve((3.0, 9.0), (0.001, 0.81))
    np.testing.assert_allclose(steep, (0.0, 0.0, 0.01))


@pytest.mark.parametrize("kind", ["model", "scale"])
@pytest.mark.parametrize("odometry", [True, False])
def test_zero_is_where_one_started(kind: str, odometry: bool) -> None:
    config = resolve_config({})
    parameters = noise_parameters(
        config,
        LIDAR.model,
        np.linspace(2.0, 30.0, 100),
        kind="model" if kind == "model" else "scale",
        has_odometry=odometry,
    )
    zero = np.zeros(len(parameters.names))
    same = parameters.config(zero)
    assert same.motion == config.motion
    assert same.sensor.scale == 1.0
    if kind == "model":
        curve = np.array(same.sensor.range_sigma_m)
        np.testing.assert_allclose(curve, LIDAR.model.range_sigma_m)
        assert same.sensor.floor_m == pytest.approx(LIDAR.model.floor_m)
