"""True laps, and the drift that each adds, on circles with known crossings."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.backends.laps import AHEAD_M
from conegraph.eval.lap_drift import lap_drifts
from conegraph.eval.laps import true_laps
from conegraph.eval.pose_pairs import pair_with_truth
from conegraph.types import Array, Lap, Trajectory

RADIUS_M = 10.0
LAP_S = 2 * np.pi * RADIUS_M
NO_CONES = np.zeros((0, 2))


def circle(laps: float, rate_hz: float = 100.0) -> Trajectory:
    """A circle to the left from the origin at 1 m/s."""
    t = np.arange(0.0, laps * LAP_S, 1.0 / rate_hz)
    a = t / RADIUS_M
    x, y = RADIUS_M * np.sin(a), RADIUS_M * (1.0 - np.cos(a))
    return Trajectory(t, np.stack([x, y, a], axis=-1))


def crossing_s(along_m: float) -> float:
    """When the circle first passes a line so far ahead of its start."""
    return RADIUS_M * float(np.arcsin(along_m / RADIUS_M))


@pytest.mark.parametrize("rate_hz", [2.0, 30.0, 400.0])
def test_laps_are_timed_between_poses_at_any_rate(rate_hz: float) -> None:
    laps = true_laps(circle(3.2, rate_hz), NO_CONES)
    first = crossing_s(AHEAD_M)
    assert [lap.number for lap in laps] == [1, 2, 3]
    for n, lap in enumerate(laps):
        assert lap.start_s == pytest.approx(first + n * LAP_S, abs=5e-3)
        assert lap.duration_s == pytest.approx(LAP_S, abs=5e-3)


def test_the_gate_stands_between_the_true_start_cones() -> None:
    cones = np.array([[4.0, 2.5], [4.0, -1.0]])
    (lap,) = true_laps(circle(1.2), cones)
    assert lap.start_s == pytest.approx(crossing_s(4.0), abs=1e-3)


def test_no_line_is_crossed_in_a_gap_of_the_truth() -> None:
    path = circle(3.2)
    second = crossing_s(AHEAD_M) + LAP_S
    seen = np.abs(path.stamp_s - second) > 2.0
    laps = true_laps(Trajectory(path.stamp_s[seen], path.pose[seen]), NO_CONES)
    assert [lap.duration_s for lap in laps] == pytest.approx([2 * LAP_S, LAP_S], 1e-3)


def test_no_path_has_no_lap() -> None:
    assert true_laps(Trajectory(np.zeros(0), np.zeros((0, 3))), NO_CONES) == ()


def sliding(path: Trajectory, speed_mps: Array) -> Trajectory:
    """An estimate that slides away from a path at a constant velocity (2,)."""
    pose = path.pose.copy()
    pose[:, :2] += path.stamp_s[:, None] * speed_mps
    return Trajectory(path.stamp_s, pose)


def test_drift_is_what_a_lap_adds() -> None:
    """A path that closes after each lap, and an estimate that slides 3 mm/s."""
    path = circle(2.5, rate_hz=1000.0 / LAP_S)
    pairs = pair_with_truth(sliding(path, np.array([0.003, 0.0])), path)
    begin_s = float(path.stamp_s[100])
    laps = [Lap(n + 1, begin_s + n * LAP_S, begin_s + (n + 1) * LAP_S) for n in (0, 1)]
    drifts = lap_drifts(pairs, laps)
    assert drifts is not None
    assert [lap.number for lap in drifts.laps] == [1, 2]
    for n, lap in enumerate(drifts.laps):
        assert lap.drift_m == pytest.approx(0.003 * LAP_S, rel=2e-3)
        assert lap.length_m == pytest.approx(LAP_S, rel=2e-3)
        assert lap.drift_percent == pytest.approx(0.3, rel=1e-3)
        assert lap.drift_yaw_deg == pytest.approx(0.0, abs=1e-9)
        end_s = begin_s + (n + 1) * LAP_S
        assert lap.max_error_m == pytest.approx(0.003 * end_s, rel=2e-3)
    assert drifts.rms_m == pytest.approx(0.003 * LAP_S, rel=2e-3)
    assert drifts.rms_percent == pytest.approx(0.3, rel=1e-3)


def test_a_lap_without_poses_has_no_drift() -> None:
    path = circle(1.0)
    pairs = pair_with_truth(path, path)
    assert lap_drifts(pairs, [Lap(1, 1e4, 2e4)]) is None
    assert lap_drifts(pairs, []) is None
