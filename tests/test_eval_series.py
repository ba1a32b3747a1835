"""What happened along a run, from drives whose errors are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conegraph.eval import Truth, evaluate
from conegraph.eval.series import (
    FRAME_MS_EDGES,
    MAX_SAMPLES,
    placed_map,
    run_series,
)
from conegraph.geometry import compose, to_parent
from conegraph.io.run_folder import (
    AssociationRows,
    PoseCovariances,
    RunFolder,
    StatusRows,
)
from conegraph.types import ConeMap, Trajectory, TruthMap

N = 1000
START = np.array([30.0, -20.0, 2.0])
CONES = np.array([[0.0, 3.0], [20.0, 3.0], [20.0, -3.0], [70.0, -3.0]])


def drive() -> tuple[RunFolder, Truth]:
    """Straight on at 10 m/s for 100 s; the estimate creeps 1 cm to the left a second.

    The truth lives in a frame of its own, the run where it started.
    """
    stamp_s = np.linspace(0.0, 99.9, N)
    straight = np.column_stack([10.0 * stamp_s, np.zeros(N), np.zeros(N)])
    estimate = straight + np.column_stack([np.zeros(N), 0.01 * stamp_s, np.zeros(N)])
    none, ints = np.zeros(0), np.zeros(0, dtype=np.int64)
    ids, prob = np.arange(len(CONES)), np.full((len(CONES), 5), 0.2)
    run = RunFolder(
        folder=Path("run"),
        trajectory=Trajectory(stamp_s, estimate),
        smoothed=None,
        cone_map=ConeMap(ids, CONES, np.tile(np.eye(2), (4, 1, 1)), prob, ids),
        associations=AssociationRows(none, ints, np.array([], np.str_), ints, none),
        timing_ms={"frame": np.repeat([2.0, 30.0], N // 2)},
        status=StatusRows(
            stamp_s, np.full(N, "OK"), ("",) * N, np.zeros(N, dtype=np.int64)
        ),
        summary={
            "laps": [
                {"number": 1, "end_s": 49.95, "duration_s": 49.95},
                {"number": 2, "end_s": 99.9, "duration_s": 49.95},
            ]
        },
        pose_cov=PoseCovariances(stamp_s, np.tile(0.04 * np.eye(3), (N, 1, 1))),
    )
    truth = Truth(
        Trajectory(stamp_s, compose(START, straight)),
        TruthMap(ids, to_parent(START, CONES), np.zeros(4, dtype=np.int64)),
    )
    return run, truth


def test_errors_are_from_the_first_pose_on() -> None:
    series = run_series(*drive())
    assert len(series.stamp_s) == MAX_SAMPLES
    assert (series.stamp_s[0], series.stamp_s[-1]) == (0.0, pytest.approx(99.9))
    np.testing.assert_allclose(series.distance_m, 10.0 * series.stamp_s, atol=1e-9)
    np.testing.assert_allclose(
        series.position_error_m, 0.01 * series.stamp_s, atol=1e-9
    )
    np.testing.assert_allclose(series.heading_error_rad, 0.0, atol=1e-12)
    # One error of 1 cm a second, with a variance of (20 cm)^2.
    np.testing.assert_allclose(
        series.nees, (0.01 * series.stamp_s / 0.2) ** 2, atol=1e-9
    )


def test_a_run_whose_world_is_turned_has_the_same_errors() -> None:
    run, truth = drive()
    turned = Trajectory(
        run.trajectory.stamp_s, compose(np.array([5.0, 6.0, -2.5]), run.trajectory.pose)
    )
    series = run_series(replace(run, trajectory=turned), truth)
    np.testing.assert_allclose(
        series.position_error_m, 0.01 * series.stamp_s, atol=1e-9
    )


def test_times_are_counted_and_told_by_lap() -> None:
    series = run_series(*drive())
    assert series.frame_ms_counts.sum() == N
    for ms in (2.0, 30.0):
        place = int(np.searchsorted(FRAME_MS_EDGES, ms, side="right")) - 1
        assert series.frame_ms_counts[place] == N // 2
    np.testing.assert_allclose(series.lap_p99_ms, [2.0, 30.0])


def test_without_truth_only_times_are_left() -> None:
    run, _ = drive()
    series = run_series(run, Truth())
    assert len(series.stamp_s) == len(series.nees) == 0
    assert series.frame_ms_counts.sum() == N


def test_poses_without_a_covariance_have_no_nees() -> None:
    run, truth = drive()
    some = PoseCovariances(run.pose_cov.stamp_s[5::2], run.pose_cov.cov[5::2])
    cov = some.at(run.trajectory.stamp_s)
    known = np.isfinite(cov).all(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(known), np.arange(5, N, 2))
    assert np.isnan(run_series(replace(run, pose_cov=some), truth).nees[0])
    without = replace(run, pose_cov=PoseCovariances.empty())
    assert np.isnan(run_series(without, truth).nees).all()


def test_poses_before_the_car_was_found_are_left_out() -> None:
    run, truth = drive()
    status = StatusRows(
        run.status.stamp_s,
        np.repeat(["INIT", "OK"], N // 2),
        ("",) * N,
        np.repeat([0, 1], N // 2),
    )
    series = run_series(replace(run, status=status), truth)
    # From half of the way on, where the path begins anew.
    assert series.distance_m[-1] == pytest.approx(10.0 * 49.9)
    assert series.position_error_m[0] == pytest.approx(0.0, abs=1e-9)


def test_a_map_is_placed_where_it_fits_the_truth() -> None:
    run, truth = drive()
    placed = placed_map(run, truth, evaluate(run, truth))
    assert placed.true_xy_m is not None
    np.testing.assert_allclose(placed.xy_m, placed.true_xy_m, atol=1e-6)
    alone = placed_map(run, Truth(), evaluate(run, Truth()))
    np.testing.assert_allclose(alone.xy_m, CONES)
    assert alone.true_xy_m is None
