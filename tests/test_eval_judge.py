"""The judge on whole runs, with and without truth."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conegraph import Pipeline, load_config
from conegraph.eval import Truth, evaluate
from conegraph.eval.trajectory_metrics import trajectory_metrics
from conegraph.geometry import compose, inverse, to_child
from conegraph.io.run_folder import (
    AssociationRows,
    PoseCovariances,
    RunFolder,
    StatusRows,
)
from conegraph.io.tum_trajectory import read_tum
from conegraph.types import Array, ConeMap, Trajectory, TruthMap

START = np.array([30.0, -12.0, 2.0])
LAPS = 3


def true_path(frames: int) -> Trajectory:
    """Laps of an ellipse, from the start pose on, 30 frames a second."""
    t = np.arange(frames) / 30.0
    a = 2 * np.pi * LAPS * np.arange(frames) / frames
    x, y = 40 * np.sin(a), 20 * (1 - np.cos(a))
    heading = np.arctan2(20 * np.sin(a), 40 * np.cos(a))
    return Trajectory(t, compose(START, np.stack([x, y, heading], -1)))


def true_cones(n: int = 200) -> TruthMap:
    """Cones 2 m to both sides of the path."""
    path = true_path(3 * n).pose[: n // 2 * 2 : 2]
    side = np.array([[0.0, 2.0, 0.0], [0.0, -2.0, 0.0]])
    xy = compose(path[:, None, :], side[None]).reshape(-1, 3)[:, :2]
    return TruthMap(np.arange(len(xy)), xy, np.tile([0, 1], len(xy) // 2))


def perfect_run(frames: int = 900, per_frame: int = 6) -> tuple[RunFolder, Truth]:
    """A run without any error, in its own frame, and the truth that it saw."""
    path, cones = true_path(frames), true_cones()
    seen = (np.arange(frames * per_frame) // 4) % len(cones)
    first = np.zeros(len(seen), dtype=np.bool_)
    first[np.unique(seen, return_index=True)[1]] = True
    n = len(cones)
    prob = np.full((n, 5), 0.1)
    prob[np.arange(n), cones.cone_class] = 0.6
    run = RunFolder(
        folder=Path("run"),
        trajectory=Trajectory(path.stamp_s, compose(inverse(START), path.pose)),
        smoothed=None,
        cone_map=ConeMap(
            np.arange(n) + 50,
            to_child(START, cones.xy_m),
            np.tile(0.01 * np.eye(2), (n, 1, 1)),
            prob,
            np.full(n, 10),
        ),
        associations=AssociationRows(
            np.repeat(path.stamp_s, per_frame),
            np.tile(np.arange(per_frame), frames),
            np.where(first, "new", "matched"),
            seen + 50,
            np.full(len(seen), 1.0),
        ),
        timing_ms={"frame": np.arange(1.0, 101.0)},
        status=StatusRows(
            path.stamp_s, np.full(frames, "OK"), ("",) * frames, np.zeros(frames, int)
        ),
        summary={
            "laps": [{"number": 1, "duration_s": 10.0}, {"number": 2}],
            "loop_closures": [{"accepted": True}, {"accepted": False}],
        },
    )
    return run, Truth(path, cones, seen)


def shifted(run: RunFolder, error_m: Array) -> RunFolder:
    pose = run.trajectory.pose + np.array([*error_m, 0.0])
    return replace(run, trajectory=Trajectory(run.trajectory.stamp_s, pose))


def test_a_perfect_run_has_no_error_anywhere() -> None:
    run, truth = perfect_run()
    m = evaluate(run, truth)
    assert m.map is not None
    assert m.map.start_frame is not None
    assert m.trajectory is not None
    assert m.association is not None
    assert m.map.rmse_aligned_m == pytest.approx(0.0, abs=1e-9)
    assert m.map.start_frame.rmse_m == pytest.approx(0.0, abs=1e-9)
    assert (m.map.precision, m.map.recall) == (1.0, 1.0)
    assert m.map.colour is not None
    assert (m.map.colour.checked, m.map.colour.errors) == (200, 0)
    assert m.trajectory.ate_first_pose.max_m == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(m.trajectory.pose_truth_start, START, atol=1e-12)
    assert (m.association.precision, m.association.recall) == (1.0, 1.0)
    assert (m.warnings, m.alarms) == ((), ())


def test_figures_that_need_no_truth() -> None:
    run, _ = perfect_run()
    m = evaluate(run, Truth())
    assert (m.trajectory, m.smoothed, m.map, m.association) == (None,) * 4
    frame = m.latency_ms["frame"]
    assert frame.count == 100
    assert (frame.p50, frame.max) == (50.5, 100.0)
    assert (frame.p95, frame.p99) == pytest.approx((95.05, 99.01))
    assert (m.closures.laps, m.closures.lap_times_s) == (2, (10.0,))
    assert (m.closures.accepted, m.closures.rejected) == (1, 1)
    assert m.status.by_status == {"INIT": 0, "OK": 900, "DEGRADED": 0, "LOST": 0}


def test_parts_of_the_truth_may_be_missing() -> None:
    run, truth = perfect_run()
    path_only = evaluate(run, Truth(trajectory=truth.trajectory))
    assert path_only.map is None
    assert path_only.trajectory is not None
    in_run_frame = TruthMap(np.arange(200), run.cone_map.xy_m, run.cone_map.cone_class)
    map_only = evaluate(run, Truth(cones=in_run_frame))
    assert map_only.trajectory is None
    assert map_only.map is not None
    assert map_only.map.recall == 1.0
    assert map_only.map.start_frame is None


def test_recall_does_not_ask_for_cones_that_were_never_reported() -> None:
    run, truth = perfect_run()
    assert truth.cones is not None
    assert truth.observation_ids is not None
    hidden = TruthMap(
        np.arange(201),
        np.concatenate([truth.cones.xy_m, [[500.0, 500.0]]]),
        np.append(truth.cones.cone_class, 0),
    )
    m = evaluate(run, Truth(truth.trajectory, hidden, truth.observation_ids)).map
    assert m is not None
    assert (m.recall, m.observable, m.missed) == (1.0, 200, 0)
    assert m.recall_all == pytest.approx(200 / 201)


def test_an_error_of_the_smoothed_path_is_not_one_of_the_causal() -> None:
    run, truth = perfect_run()
    sign = np.where(np.arange(900) % 2 == 0, 0.5, -0.5)
    wobble = run.trajectory.pose + np.outer(sign, [0.0, 1.0, 0.0])
    both = replace(run, smoothed=Trajectory(run.trajectory.stamp_s, wobble))
    m = evaluate(both, truth)
    assert m.smoothed is not None
    assert m.trajectory is not None
    assert m.smoothed.ate_se2.rmse_m == pytest.approx(0.5, rel=1e-3)
    assert m.trajectory.ate_se2.rmse_m == pytest.approx(0.0, abs=1e-9)


def test_faulty_truth_is_noticed_and_said_and_not_held_against_the_run() -> None:
    """Cone 3 stands twice in the file, and both ids were reported by turns."""
    run, truth = perfect_run()
    assert truth.cones is not None
    assert truth.observation_ids is not None
    cones = TruthMap(
        np.append(truth.cones.id, 900),
        np.concatenate(
            [truth.cones.xy_m, truth.cones.xy_m[3:4] + np.array([0.06, 0.08])]
        ),
        np.append(truth.cones.cone_class, 1 - truth.cones.cone_class[3]),
    )
    ids = truth.observation_ids.copy()
    ids[np.flatnonzero(ids == 3)[1::2]] = 900
    m = evaluate(run, Truth(truth.trajectory, cones, ids))
    assert len(m.warnings) == 1
    assert m.warnings[0].startswith(
        "the truth is faulty: 1 of its pairs of cones stand closer"
    )
    assert "(ids 3 and 900)" in m.warnings[0]
    (fault,) = m.truth_faults
    assert fault.ids == (3, 900)
    assert fault.distance_m == pytest.approx(0.1)
    assert m.map is not None
    assert (m.map.recall, m.map.precision, m.map.observable) == (1.0, 1.0, 200)
    assert m.map.rmse_aligned_m == pytest.approx(0.0, abs=1e-9)
    assert m.association is not None
    assert (m.association.precision, m.association.recall) == (1.0, 1.0)
    assert m.association.split_cones == 0


def test_laps_are_judged_by_those_that_were_driven() -> None:
    """Three laps from the start line on, the run's clock 0.2 s slow in the second."""
    run, truth = perfect_run()
    timed = {
        "laps": [
            {"number": 1, "end_s": 10.0, "duration_s": 10.0},
            {"number": 2, "end_s": 20.2, "duration_s": 10.2},
        ],
        "loop_closures": [{"stamp_s": 10.2, "accepted": True}],
    }
    m = evaluate(replace(run, summary=timed), truth)
    # The gate is 1 m ahead of the start, which the last lap does not reach again.
    assert m.closures.laps_true == 2
    assert (m.closures.laps, m.closures.in_time) == (2, 1)
    assert m.closures.delay_s == pytest.approx(0.2, abs=0.1)
    assert m.closures.lap_time_error_s == pytest.approx(0.2 / np.sqrt(2), abs=0.02)
    assert m.closures.precision == 1.0
    assert m.lap_drift is not None
    assert [lap.number for lap in m.lap_drift.laps] == [1, 2]
    assert m.lap_drift.rms_m == pytest.approx(0.0, abs=1e-9)


def test_a_run_of_the_simulator_has_every_figure(tmp_path: Path) -> None:
    """One lap of the oval with a lidar: the road is found, the closure in time."""
    config = load_config(None, [], backend="ekf")
    source = "sim:oval?laps=2&seed=1&sensor=lidar&odometry=on"
    result = Pipeline(config, source).run(tmp_path)
    m = result.metrics
    assert m is not None
    assert (m.closures.laps_true, m.closures.in_time, m.closures.precision) == (2, 2, 1)
    assert m.closures.lap_time_error_s < 0.5
    assert m.track is not None
    assert (m.track.edges_right, m.track.edges_found) == (1.0, 1.0)
    assert m.track.road_iou > 0.98
    assert m.track.lateral_rmse_m < 0.05
    assert m.innovation_consistency is not None
    assert 0.7 < m.innovation_consistency.nis_per_dof < 1.3
    assert m.cost.real_time_factor > 1.0
    assert m.cost.peak_memory_mb > 20.0
    assert len(m.cost.lap_p99_ms) == 2
    written = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert written["metrics"] == m.to_dict()
    # What evo would compare: one true pose for each of the path's.
    true, path = read_tum(tmp_path / "truth.tum"), read_tum(tmp_path / "trajectory.tum")
    np.testing.assert_array_equal(true.stamp_s, path.stamp_s)
    again = trajectory_metrics(path, true)
    assert again is not None
    assert m.trajectory is not None
    assert again.ate_se2.rmse_m == pytest.approx(m.trajectory.ate_se2.rmse_m, abs=1e-9)


def test_what_is_odd_about_a_run_is_said() -> None:
    run, truth = perfect_run()
    pose = run.trajectory.pose.copy()
    pose[-1] = np.nan
    late = Trajectory(run.trajectory.stamp_s + 1.0, pose)
    said = evaluate(replace(run, trajectory=late, summary={}), truth).warnings
    assert [w.split(":")[0] for w in said] == [
        "the run did not finish",
        "1 pose of the trajectory with numbers that are not finite",
        "30 of 900 poses have no truth",
    ]
    years_later = Trajectory(run.trajectory.stamp_s + 1e8, run.trajectory.pose)
    said = evaluate(replace(run, trajectory=years_later), truth).warnings
    assert said == ("no pose of the run lies within the true trajectory's time",)


def test_poses_before_the_car_was_found_on_its_map_are_left_out() -> None:
    run, truth = perfect_run()
    assert run.trajectory is not None
    pose = run.trajectory.pose.copy()
    pose[:20] += [50.0, 0.0, 1.0]
    path = Trajectory(run.trajectory.stamp_s, pose)
    status = replace(
        run.status,
        status=np.repeat(["INIT", "LOST", "OK"], [15, 5, 880]),
        reset_counter=np.repeat([0, 1], [20, 880]),
    )
    found = evaluate(replace(run, trajectory=path, smoothed=path, status=status), truth)
    for errors in (found.trajectory, found.smoothed):
        assert errors is not None
        assert errors.poses == 880
        assert errors.ate_first_pose.max_m == pytest.approx(0.0, abs=1e-9)
    assert found.status.by_status["INIT"] == 15
    assert found.warnings == (
        "20 of 900 frames passed until the car was found on the map: their poses are "
        "not judged",
        "the car was LOST in 5 of 900 frames",
    )
    # A car that was trusted before it jumped was wrong, and that counts.
    trusted = replace(status, status=np.repeat(["INIT", "OK"], [10, 890]))
    jumped = evaluate(replace(run, trajectory=path, status=trusted), truth)
    assert jumped.trajectory is not None
    assert jumped.trajectory.poses == 900
    assert jumped.trajectory.ate_as_written.max_m > 40.0


def test_a_run_says_when_it_did_not_know_where_the_car_was() -> None:
    run, truth = perfect_run()
    lost = replace(run.status, status=np.repeat(["OK", "LOST"], [899, 1]))
    said = evaluate(replace(run, status=lost), truth).warnings
    assert said == ("the car was LOST in 1 of 900 frames",)
    unsure = replace(
        run.status, status=np.full(900, "INIT"), reason=("no cones yet",) * 900
    )
    said = evaluate(replace(run, status=unsure), truth).alarms
    assert said == ("the status was INIT to the end: no cones yet",)


def test_all_figures_become_json() -> None:
    run, truth = perfect_run()
    text = json.dumps(evaluate(run, truth).to_dict(), allow_nan=False)
    assert json.loads(text)["map"]["start_frame"]["recall"] == 1.0


def test_a_run_of_200_cones_and_3_laps_is_judged_in_under_2_s() -> None:
    run, truth = perfect_run(frames=6000)
    rng = np.random.default_rng(1)
    noisy = run.cone_map.xy_m + rng.normal(0.0, 0.1, (200, 2))
    run = replace(run, cone_map=replace(run.cone_map, xy_m=noisy))
    begin = time.perf_counter()
    evaluate(run, truth)
    assert time.perf_counter() - begin < 2.0


def test_importing_the_judge_is_light() -> None:
    code = (
        "import sys, conegraph.eval\n"
        "heavy = {'scipy', 'rich', 'matplotlib', 'pandas', 'numpy'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_pose_covariances_are_judged_in_the_frame_of_the_start() -> None:
    run, truth = perfect_run()
    assert evaluate(run, truth).pose_consistency is None
    n = len(run.trajectory)
    off = np.array([0.3, -0.4, 0.02])
    off_path = Trajectory(
        run.trajectory.stamp_s,
        run.trajectory.pose + off * (np.arange(n) > 0)[:, None],
    )
    cov = np.tile(np.diag(off**2), (n, 1, 1))
    table = PoseCovariances(off_path.stamp_s, cov)
    found = evaluate(replace(run, trajectory=off_path, pose_cov=table), truth)
    assert found.pose_consistency is not None
    # Every error is one sigma, but for the first pose, which has none.
    assert found.pose_consistency.poses == n
    assert found.pose_consistency.nees_per_dof == pytest.approx((n - 1) / n)
    assert found.pose_consistency.share_inside == 1.0
    double = PoseCovariances(off_path.stamp_s, cov / 4.0)
    found = evaluate(replace(run, trajectory=off_path, pose_cov=double), truth)
    assert found.pose_consistency is not None
    assert found.pose_consistency.nees_per_dof == pytest.approx(4.0 * (n - 1) / n)
    assert found.pose_consistency.share_inside == pytest.approx(1.0 / n)
