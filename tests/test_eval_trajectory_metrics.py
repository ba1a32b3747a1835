"""Path errors: closed forms, gaps, and the figures that evo prints."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from conegraph.eval.pose_pairs import pair_with_truth
from conegraph.eval.trajectory_metrics import trajectory_metrics
from conegraph.geometry import compose, inverse
from conegraph.io.tum_trajectory import write_tum
from conegraph.types import Array, Trajectory


def circle(radius_m: float = 10.0, n: int = 629) -> Trajectory:
    """One lap at 1 m/s and 10 Hz around the origin."""
    t = 0.1 * np.arange(n, dtype=np.float64)
    a = t / radius_m
    pose = np.stack([radius_m * np.cos(a), radius_m * np.sin(a), a + np.pi / 2], -1)
    return Trajectory(t, pose)


def moved(path: Trajectory, motion: Array) -> Trajectory:
    return Trajectory(path.stamp_s, compose(motion, path.pose))


def test_a_rotated_and_shifted_path_has_no_error_but_as_written() -> None:
    """A circle about the origin, turned by a and shifted by d, is off by (R - 1) p + d.

    Over a whole lap the mean square of that is 2 r^2 (1 - cos a) + d^2.
    """
    truth = circle(n=629)
    whole = Trajectory(truth.stamp_s[:628], truth.pose[:628])
    a, d = 0.4, np.array([3.0, -1.0])
    m = trajectory_metrics(moved(whole, np.array([*d, a])), truth)
    assert m is not None
    expected = np.sqrt(2 * 100.0 * (1 - np.cos(a)) + 10.0)
    assert m.ate_as_written.rmse_m == pytest.approx(expected, rel=1e-3)
    assert m.ate_first_pose.max_m == pytest.approx(0.0, abs=1e-12)
    assert m.ate_se2.max_m == pytest.approx(0.0, abs=1e-12)
    assert m.yaw_rmse_deg == pytest.approx(0.0, abs=1e-10)
    assert m.final_drift_m == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(m.pose_truth_run, inverse(np.array([*d, a])), atol=1e-12)


def test_a_constant_offset_in_the_car_frame_is_measured_as_such() -> None:
    """Reported 0.3 m left of and 2 degrees off the truth all around the circle.

    The best alignment of the concentric circle, 0.3 m smaller, moves nothing.
    """
    truth = circle()
    slip = np.array([0.0, 0.3, np.deg2rad(2.0)])
    m = trajectory_metrics(Trajectory(truth.stamp_s, compose(truth.pose, slip)), truth)
    assert m is not None
    assert m.ate_as_written.rmse_m == pytest.approx(0.3, abs=1e-12)
    assert m.ate_se2.mean_m == pytest.approx(0.3, abs=1e-3)
    assert m.yaw_rmse_deg == pytest.approx(2.0, abs=1e-2)


def test_a_scale_error_shows_as_relative_error_per_metre() -> None:
    """Odometry that reads 2 % long, a pose each 0.25 m of a straight 50 m.

    Segments that end with the path may be up to 10 % short: four of 10 m are.
    """
    t = np.linspace(0.0, 50.0, 201)
    truth = Trajectory(t, np.stack([t, 0 * t, 0 * t], -1))
    long = Trajectory(t, np.stack([1.02 * t, 0 * t, 0 * t], -1))
    m = trajectory_metrics(long, truth)
    assert m is not None
    one, ten = m.rpe
    assert (one.length_m, one.segments) == (1.0, 197)
    assert one.rmse_m == pytest.approx(0.02)
    lengths = np.array([10.0] * 161 + [9.75, 9.5, 9.25, 9.0])
    assert (ten.length_m, ten.segments) == (10.0, 165)
    assert ten.rmse_m == pytest.approx(0.02 * np.sqrt(np.mean(lengths**2)))
    assert ten.per_metre == pytest.approx(ten.rmse_m / 10.0)
    assert m.path_m == pytest.approx(50.0)
    assert m.final_drift_m == pytest.approx(1.0)
    assert m.final_drift_percent == pytest.approx(2.0)
    # At 1 m/s a second is a metre; what the end cuts short is left out here.
    second, ten_s = m.rpe_time
    assert (second.duration_s, second.intervals, ten_s.intervals) == (1.0, 197, 161)
    assert ten_s.rmse_m == pytest.approx(0.2)
    assert ten_s.per_second == pytest.approx(0.02)


def test_stamps_outside_or_in_a_gap_are_left_out_and_counted() -> None:
    """Truth at 0..1 s and 2..3 s each 0.25 s; estimates at 10 Hz from -0.2 to 3.2 s."""
    stamps = np.concatenate([np.arange(0, 1.01, 0.25), np.arange(2, 3.01, 0.25)])
    truth = Trajectory(stamps, np.stack([stamps, 0 * stamps, 0 * stamps], -1))
    t = np.round(np.arange(-0.2, 3.21, 0.1), 9)
    pairs = pair_with_truth(Trajectory(t, np.zeros((len(t), 3))), truth)
    assert pairs.left_out == 2 + 2 + 9
    np.testing.assert_allclose(pairs.truth[:, 0], pairs.stamp_s, atol=1e-12)
    assert 1.0 in pairs.stamp_s
    assert 2.0 in pairs.stamp_s
    assert pairs.stretch[pairs.stamp_s <= 1.0].max() == 0
    assert pairs.stretch[pairs.stamp_s >= 2.0].min() == 1


def test_no_segment_spans_a_gap_in_the_truth() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    gone = (t > 8.0) & (t < 12.0)
    truth = Trajectory(t[~gone], np.stack([t, 0 * t, 0 * t], -1)[~gone])
    jump = np.where(t > 10.0, 5.0, 0.0)
    m = trajectory_metrics(Trajectory(t, np.stack([t + jump, 0 * t, 0 * t], -1)), truth)
    assert m is not None
    assert m.rpe[0].rmse_m == pytest.approx(0.0, abs=1e-9)
    assert m.rpe[0].segments > 100


def test_yaw_is_interpolated_along_the_shorter_arc() -> None:
    truth = Trajectory(np.array([0.0, 0.4]), np.array([[0, 0, 3.1], [0, 0, -3.1]]))
    pairs = pair_with_truth(Trajectory(np.array([0.2]), np.zeros((1, 3))), truth)
    assert pairs.truth[0, 2] == pytest.approx(np.pi)


def test_nothing_in_common_is_no_metric() -> None:
    path = circle()
    later = Trajectory(path.stamp_s + 1000.0, path.pose)
    assert trajectory_metrics(later, path) is None
    assert trajectory_metrics(Trajectory(np.zeros(0), np.zeros(0)), path) is None


def recorded_pair() -> tuple[Trajectory, Trajectory]:
    """An estimate that wavers about its truth, a figure of eight, in another frame."""
    t = 0.1 * np.arange(601, dtype=np.float64)
    yaw = np.arctan2(2 * np.cos(0.2 * t), 2 * np.cos(0.1 * t))
    truth = np.stack([20 * np.sin(0.1 * t), 10 * np.sin(0.2 * t), yaw], -1)
    slip = np.stack(
        [0.05 * np.sin(0.9 * t), 0.08 * np.cos(0.5 * t), 0.02 * np.sin(0.3 * t)], -1
    )
    estimate = compose(np.array([1.5, -0.7, 0.3]), compose(truth, slip))
    return Trajectory(t, estimate), Trajectory(t, truth)


def test_agrees_with_evo() -> None:
    """The figures are what evo 1.38.1 printed for this very pair of paths.

    Written as ``truth.tum`` and ``est.tum``, and asked with ``evo_ape tum truth.tum
    est.tum`` plain, with ``--align_origin``, with ``--align`` and with ``--align -r
    angle_deg``; then ``evo_rpe tum truth.tum est.tum --delta D --delta_unit m
    --all_pairs --pairs_from_reference`` for D of 1 and 10, and ``-r angle_deg``; and
    ``--delta D --delta_unit f --all_pairs``, ten frames a second, for 10 and 100.
    """
    m = trajectory_metrics(*recorded_pair())
    assert m is not None
    evo = {
        m.ate_as_written: (5.084589, 4.725431, 5.083318, 7.362970),
        m.ate_first_pose: (0.108057, 0.099723, 0.103974, 0.168502),
        m.ate_se2: (0.066272, 0.062867, 0.064588, 0.099101),
    }
    for ours, printed in evo.items():
        values = (ours.rmse_m, ours.mean_m, ours.median_m, ours.max_m)
        assert values == pytest.approx(printed, abs=6e-7)
    assert m.yaw_rmse_deg == pytest.approx(0.821049, abs=6e-7)
    one, ten = m.rpe
    assert (one.segments, ten.segments) == (546, 557)
    assert one.rmse_m == pytest.approx(0.028420, abs=6e-7)
    assert ten.rmse_m == pytest.approx(0.166306, abs=6e-7)
    assert ten.yaw_rmse_deg == pytest.approx(1.209377, abs=6e-7)
    second, ten_s = m.rpe_time
    assert (second.intervals, ten_s.intervals) == (591, 501)
    assert second.rmse_m == pytest.approx(0.052275, abs=6e-7)
    assert second.yaw_rmse_deg == pytest.approx(0.238081, abs=6e-7)
    assert ten_s.rmse_m == pytest.approx(0.255038, abs=6e-7)
    assert ten_s.yaw_rmse_deg == pytest.approx(1.638633, abs=6e-7)


@pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo is not installed")
def test_evo_reads_our_files(tmp_path: Path) -> None:
    estimate, truth = recorded_pair()
    write_tum(tmp_path / "truth.tum", truth)
    write_tum(tmp_path / "trajectory.tum", estimate)
    said = subprocess.run(
        ["evo_ape", "tum", "truth.tum", "trajectory.tum", "--align"],
        cwd=tmp_path,
        env={**os.environ, "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found = re.search(r"rmse\s+([\d.]+)", said)
    assert found is not None
    m = trajectory_metrics(estimate, truth)
    assert m is not None
    assert float(found[1]) == pytest.approx(m.ate_se2.rmse_m, abs=6e-7)
