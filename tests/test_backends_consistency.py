"""When an estimator is called overconfident, and when chance explains it."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from conegraph.backends import make_backend
from conegraph.backends.consistency import (
    FALSE_ALARM,
    WINDOW_S,
    ConsistencyMonitor,
    judge_window,
)
from conegraph.config import StatusConfig, resolve_config
from conegraph.sim.cone_sensor import CAMERA, LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Consistency, Recording, VelocityObservation

CONFIG = StatusConfig()
KINDS = ["ekf", "isam2"]
SENSORS = {"camera": CAMERA, "lidar": LIDAR}


@pytest.mark.parametrize("dof", [2, 10, 50, 300, 3000])
def test_the_limit_is_the_quantile_or_the_ratio_that_is_greater(dof: int) -> None:
    quantile = float(chi2.isf(FALSE_ALARM, dof)) / dof
    limit = max(quantile, CONFIG.overconfident_ratio)
    assert judge_window(float(dof), dof, 1.25).limit == pytest.approx(limit)
    assert not judge_window(0.999 * limit * dof, dof, 1.25).overconfident
    assert judge_window(1.001 * limit * dof, dof, 1.25).overconfident


def test_the_ratio_counts_from_some_seven_hundred_degrees_of_freedom_on() -> None:
    # 1 + 4.75 sqrt(2 / n) = 1.25 at n = 722: the normal limit of the quantile.
    dofs = np.arange(2, 2000)
    limits = np.array([judge_window(1.0, int(n), 1.25).limit for n in dofs])
    first = dofs[limits == 1.25][0]
    assert 700 < first < 850


def test_the_window_is_five_seconds_and_frames_without_matches_change_nothing() -> None:
    monitor = ConsistencyMonitor(CONFIG)
    assert not monitor.frame(0.0, float("nan"), 0).overconfident
    values = [(0.1 * n, 4.0 if n < 50 else 12.0, 8) for n in range(100)]
    seen = [monitor.frame(*value).nis_per_dof for value in values]
    np.testing.assert_allclose(seen[:50], 0.5)
    # After five seconds the first fifty frames have left.
    assert seen[98] < 1.5
    assert seen[99] == pytest.approx(1.5)
    assert monitor.frame(9.95, float("nan"), 0).nis_per_dof == pytest.approx(1.5)
    late = monitor.frame(9.9 + WINDOW_S, float("nan"), 0)
    assert not late.overconfident
    assert np.isnan(late.nis_per_dof)


def test_false_alarms_are_as_rare_as_promised() -> None:
    rng = np.random.default_rng(1)
    dof = rng.integers(2, 20, 60_000)
    nis = rng.chisquare(dof)
    monitor = ConsistencyMonitor(StatusConfig(overconfident_ratio=1.0))
    # An hour at 17 Hz: 0.06 false alarms are expected without the ratio's help.
    alarms = sum(
        monitor.frame(0.06 * n, float(nis[n]), int(dof[n])).overconfident
        for n in range(len(dof))
    )
    assert alarms == 0


@cache
def drive(sensor: str, odometry: bool) -> Recording:
    recording = simulate(
        built_in_track("oval", 0),
        laps=1,
        seed=11,
        sensor=SENSORS[sensor],
        odometry=OdometrySensor() if odometry else None,
        origin="start",
    )
    stream = tuple(e for e in recording.stream if e.stamp_s < 12.0)
    return replace(recording, stream=stream)


def run(kind: str, recording: Recording, scale: float) -> list[tuple[Consistency, str]]:
    config = resolve_config({"backend": {"kind": kind}, "sensor": {"scale": scale}})
    backend = make_backend(config.backend, config, sensor=recording.sensor)
    seen = []
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        elif backend.observe_cones(event) is not None:
            events = backend.last_events
            seen.append((events.consistency, events.reason))
    return seen


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("sensor", "odometry"), [("camera", True), ("camera", False), ("lidar", True)]
)
def test_noise_understated_by_two_is_found_and_right_noise_is_not(
    kind: str, sensor: str, odometry: bool
) -> None:
    recording = drive(sensor, odometry)
    right = run(kind, recording, 1.0)
    assert not any(c.overconfident for c, _ in right)
    assert not any("overconfident" in reason for _, reason in right)
    wrong = run(kind, recording, 0.5)
    # At a ratio near 2.3 some seventy degrees of freedom are enough, and a frame has
    # ten. Without odometry such noise soon loses the way, which is then the reason.
    for consistency, reason in wrong[len(wrong) // 8 :]:
        if not re.search("cones match|no cone matched", reason):
            ratio = consistency.nis_per_dof
            assert reason == f"overconfident: NIS/dof {ratio:.1f} over 5 s"
            assert 1.5 < ratio < 4.0
