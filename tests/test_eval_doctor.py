"""The doctor names what was done to a run whose every number is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conegraph.eval.doctor import HEALTHY, UNCLEAR, UNEXPLAINED, diagnose
from conegraph.eval.doctor_case import open_case
from conegraph.eval.doctor_fit import NAMES
from conegraph.eval.doctor_tracks import linked
from conegraph.eval.odometry_gap import odometry_gap
from conegraph.eval.run_warnings import run_warnings
from conegraph.geometry import between, to_child, to_parent
from conegraph.io.run_folder import (
    AssociationRows,
    ConsistencyRows,
    MotionRows,
    ObservationRows,
    PoseCovariances,
    RunFolder,
    StatusRows,
)
from conegraph.types import Array, ConeClass, ConeMap, IntArray, Trajectory

RATE_HZ, LAPS, LAP_S, RADIUS_M = 10.0, 2, 12.0, 12.0
SIGMA_M = 0.02
N = int(RATE_HZ * LAPS * LAP_S) + 1
STAMPS = np.arange(N) / RATE_HZ


def true_pose(stamp_s: Array) -> Array:
    """Two laps of an oval whose curvature and speed change all the time."""
    phase = 2 * np.pi * (stamp_s / LAP_S + 0.05 * np.sin(2 * np.pi * stamp_s / 4.0))
    xy = np.column_stack([1.5 * RADIUS_M * np.sin(phase), -RADIUS_M * np.cos(phase)])
    ahead = np.arctan2(RADIUS_M * np.sin(phase), 1.5 * RADIUS_M * np.cos(phase))
    return np.column_stack([xy, ahead])


def cones() -> Array:
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.column_stack(
        [1.5 * RADIUS_M * np.sin(around), -RADIUS_M * np.cos(around)]
    )
    return np.vstack([0.85 * ring, 1.15 * ring])


def drive(
    *,
    scale: float = 0.0,
    bias: float = 0.0,
    yaw: float = 0.0,
    late: float = 0.0,
    ranges: float = 1.0,
    noise: float = 1.0,
) -> RunFolder:
    """A run that knows its pose and closes both loops, fed as is asked for."""
    rng = np.random.default_rng(0)
    pose = true_pose(STAMPS)
    step = between(pose[:-1], pose[1:]) * [1 + scale, 1 + scale, 1.0]
    step[:, 2] += bias / RATE_HZ
    frame, ids, xy = sights(true_pose(STAMPS - late), yaw, ranges)
    xy = xy + noise * SIGMA_M * rng.standard_normal(xy.shape)
    row = np.arange(len(frame)) - np.searchsorted(frame, frame)
    n, t = len(frame), STAMPS[frame]
    closures = [
        {"stamp_s": lap * LAP_S, "accepted": True, "reason": "", "distance_m": 90.0}
        for lap in range(1, LAPS + 1)
    ]
    return RunFolder(
        folder=Path("run"),
        trajectory=Trajectory(STAMPS, pose),
        smoothed=None,
        cone_map=ConeMap.empty(),
        associations=AssociationRows(t, row, np.full(n, "matched"), ids, np.zeros(n)),
        timing_ms={},
        status=StatusRows(STAMPS, np.full(N, "OK"), N * ("",), np.zeros(N, np.int64)),
        summary={"frames": N, "loop_closures": closures},
        consistency=ConsistencyRows(STAMPS, np.full(N, 10.0), np.full(N, 10)),
        pose_cov=PoseCovariances(STAMPS, np.tile(0.01 * np.eye(3), (N, 1, 1))),
        motion=MotionRows(STAMPS, np.vstack([[3 * [np.nan]], step]), np.zeros(N)),
        observations=ObservationRows(
            t, row, xy, np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1)), ids % 2
        ),
    )


def sights(pose: Array, yaw: float, ranges: float) -> tuple[IntArray, IntArray, Array]:
    """Return frame, cone and place of every sight within 12 m ahead."""
    frame, ids, xy = [], [], []
    for k in range(len(pose)):
        seen = to_child(pose[k], cones())
        near = np.flatnonzero((np.hypot(*seen.T) < 12.0) & (seen[:, 0] > 1.0))
        frame.append(np.full(len(near), k))
        ids.append(near)
        xy.append(to_parent(np.array([0.0, 0.0, yaw]), ranges * seen[near]))
    return np.concatenate(frame), np.concatenate(ids), np.vstack(xy)


def test_a_good_run_is_healthy() -> None:
    diagnosis = diagnose(drive())
    assert diagnosis.cause == HEALTHY
    assert diagnosis.notes == ()


@pytest.mark.parametrize(
    ("fault", "name", "value"),
    [
        ({"scale": 0.05}, "scale", 0.05),
        ({"scale": -0.05}, "scale", -0.05),
        ({"ranges": 0.95}, "scale", 1 / 0.95 - 1),
        ({"bias": 0.1}, "yaw_rate_bias", 0.1),
        ({"yaw": -0.05}, "sensor_yaw", -0.05),
        ({"late": 0.1}, "stamp_offset", 0.1),
    ],
)
def test_faults_are_estimated_as_they_were_made(
    fault: dict[str, float], name: str, value: float
) -> None:
    case = open_case(drive(**fault), None)
    assert case.fit is not None
    k = NAMES.index(name)
    assert case.fit.value[k] == pytest.approx(value, rel=0.05)
    others = np.delete(case.fit.value, k)
    assert (np.abs(others) < 0.1 * abs(value)).all()
    assert case.fit.noise < 1.6


def test_faults_are_told_apart_when_there_are_two() -> None:
    case = open_case(drive(scale=0.04, yaw=0.03), None)
    assert case.fit is not None
    np.testing.assert_allclose(case.fit.value, [0.04, 0, 0.03, 0], atol=2e-3)


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ({"scale": 0.05}, "scale"),
        ({"ranges": 1.05}, "scale"),
        ({"bias": -0.1}, "yaw_rate_bias"),
        ({"yaw": 0.05}, "sensor_yaw"),
        ({"late": 0.1}, "stamp_offset"),
        ({"noise": 3.0}, "sensor_noise"),
    ],
)
def test_what_a_sensor_does_wrong_comes_first(
    fault: dict[str, float], cause: str
) -> None:
    run = drive(**fault)
    run = replace(run, consistency=replace(run.consistency, nis=np.full(N, 30.0)))
    found = diagnose(run).findings
    assert found[0].cause == cause
    assert found[-1].cause == "overconfidence"
    assert found[-1].measured == pytest.approx(3.0)
    assert found[0].score == pytest.approx(found[0].measured / found[0].limit)


@pytest.mark.parametrize(
    ("fault", "cause"),
    [({"scale": 0.05}, "wheel_scale"), ({"ranges": 1.05}, "range_scale")],
)
def test_truth_tells_wheels_from_ranges(fault: dict[str, float], cause: str) -> None:
    truth = Trajectory(STAMPS, true_pose(STAMPS))
    assert diagnose(drive(**fault), truth).cause == cause


def test_noise_is_what_it_is_beside_what_is_reported() -> None:
    case = open_case(drive(noise=2.5), None)
    assert case.fit is not None
    assert case.fit.noise == pytest.approx(2.5, rel=0.08)


def test_a_jump_that_nothing_allows_is_a_false_closure() -> None:
    run = drive()
    moved = run.trajectory.pose.copy()
    moved[100:, 0] += 4.0
    found = diagnose(replace(run, trajectory=Trajectory(STAMPS, moved))).findings
    assert found[0].cause == "false_closure"
    assert found[0].measured == pytest.approx(4.0, abs=1e-6)
    assert found[0].at_s == STAMPS[100]


def test_a_jump_in_which_the_car_was_found_again_is_none() -> None:
    run = drive()
    moved = run.trajectory.pose.copy()
    moved[100:, 0] += 4.0
    resets = (np.arange(N) >= 100).astype(np.int64)
    status = replace(run.status, reset_counter=resets)
    run = replace(run, trajectory=Trajectory(STAMPS, moved), status=status)
    assert "false_closure" not in [f.cause for f in diagnose(run).findings]


def test_visits_to_the_start_without_a_closure_are_missed_closures() -> None:
    found = diagnose(replace(drive(), summary={"frames": N})).findings
    assert [f.cause for f in found] == ["missed_closure"]
    assert found[0].measured == 1.0
    assert f"of {LAPS} times" in found[0].evidence
    assert found[0].at_s == pytest.approx(LAP_S, abs=0.2)
    refused = {"stamp_s": 12.0, "accepted": False, "reason": "only 9 % agree"}
    run = replace(drive(), summary={"frames": N, "loop_closures": [refused]})
    assert "only 9 % agree" in diagnose(run).findings[0].evidence


def test_an_estimate_that_doubts_its_place_has_drifted() -> None:
    run = drive()
    cov = run.pose_cov.cov.copy()
    cov[100, :2, :2] = 4.5 * np.eye(2)
    found = diagnose(replace(run, pose_cov=PoseCovariances(STAMPS, cov))).findings
    assert [f.cause for f in found] == ["drift"]
    assert found[0].measured == pytest.approx(3.0)
    assert found[0].at_s == STAMPS[100]


def test_wrong_colours_are_counted() -> None:
    run = drive()
    named = run.observations.cone_class.copy()
    wrong = np.random.default_rng(1).random(len(named)) < 0.3
    named[wrong] = int(ConeClass.ORANGE)
    observations = replace(run.observations, cone_class=named)
    found = diagnose(replace(run, observations=observations)).findings
    assert [f.cause for f in found] == ["wrong_colours"]
    assert found[0].measured == pytest.approx(wrong.mean(), abs=0.02)


def only(run: RunFolder, rng: np.random.Generator, share: float) -> RunFolder:
    """A run that saw but a share of what it saw."""
    keep = rng.random(len(run.observations)) < share
    seen, made = run.observations, run.associations
    return replace(
        run,
        observations=ObservationRows(
            seen.stamp_s[keep],
            seen.observation[keep],
            seen.xy_m[keep],
            seen.cov_m2[keep],
            seen.cone_class[keep],
        ),
        associations=AssociationRows(
            made.stamp_s[keep],
            made.observation[keep],
            made.status[keep],
            made.landmark_id[keep],
            made.d2[keep],
        ),
    )


def test_few_sights_are_no_false_detections() -> None:
    run = drive()
    few = only(run, np.random.default_rng(2), 0.05)
    assert [f.cause for f in diagnose(few).findings] == ["few_sights"]


def test_associations_in_vain_are_counted_unless_the_car_is_lost() -> None:
    run = drive()
    idle = replace(run.associations, status=np.full(len(run.associations), "ambiguous"))
    found = diagnose(replace(run, associations=idle)).findings
    assert [f.cause for f in found] == ["starved_associations"]
    assert found[0].measured == 1.0
    lost = replace(run.status, status=np.full(N, "LOST"))
    assert diagnose(replace(run, associations=idle, status=lost)).cause == HEALTHY


@pytest.mark.parametrize(
    ("matched", "greatest_id", "causes"),
    [
        ("matched", 47, []),
        ("matched", 10, ["wrong_map"]),
        ("rejected", 47, ["wrong_map"]),
    ],
)
def test_a_map_whose_cones_are_not_seen_is_of_another_place(
    matched: str, greatest_id: int, causes: list[str]
) -> None:
    """Its cones come first; those that the run found itself have greater ids."""
    run = drive()
    status = replace(run.status, status=np.full(N, "LOST"))
    made = replace(run.associations, status=np.full(len(run.associations), matched))
    known = {"cones": greatest_id + 1, "greatest_id": greatest_id}
    run = replace(run, status=status, associations=made)
    assert diagnose(run).cause == HEALTHY
    findings = diagnose(
        replace(run, summary={**run.summary, "known_map": known})
    ).findings
    assert [f.cause for f in findings] == causes
    if causes:
        strange = (made.landmark_id > greatest_id) | (made.status != "matched")
        assert findings[0].measured == pytest.approx(strange.mean())


def test_odometry_that_stopped_is_named_with_its_time() -> None:
    run = drive()
    silent = run.motion.odometry.copy()
    silent[101:] = np.nan
    stopped = replace(run, motion=replace(run.motion, odometry=silent))
    (found,) = diagnose(stopped).findings
    assert (found.cause, found.at_s) == ("odometry_stopped", STAMPS[100])
    assert found.measured == pytest.approx(STAMPS[-1] - STAMPS[100])
    assert "stopped at 10.0 s, to the end" in found.evidence
    assert found.evidence in run_warnings(stopped, None, None)
    back = run.motion.odometry.copy()
    back[101:115] = np.nan
    assert odometry_gap(replace(run, motion=replace(run.motion, odometry=back))) is None
    back[101:131] = np.nan
    gap = odometry_gap(replace(run, motion=replace(run.motion, odometry=back)))
    assert gap is not None
    assert gap.length_s == pytest.approx(3.0)
    assert not gap.to_the_end


def test_a_car_that_stands_needs_no_odometry() -> None:
    run = drive()
    silent, pose = run.motion.odometry.copy(), run.trajectory.pose.copy()
    silent[101:], pose[101:] = np.nan, pose[100]
    motion = replace(run.motion, odometry=silent)
    assert odometry_gap(replace(run, motion=motion)) is not None
    stood = replace(run, motion=motion, trajectory=Trajectory(STAMPS, pose))
    assert odometry_gap(stood) is None


def test_a_time_without_frames_is_none_without_odometry() -> None:
    run = drive()
    later = STAMPS + 20.0 * (np.arange(N) > 100)
    run = replace(run, motion=replace(run.motion, stamp_s=later))
    assert odometry_gap(run) is None


def test_a_cone_with_two_landmarks_is_split() -> None:
    run = drive()
    ids = run.associations.landmark_id + 1000 * (run.associations.stamp_s % 2 > 1)
    split = replace(run.associations, landmark_id=ids)
    assert diagnose(replace(run, associations=split)).cause == "split_cones"


def test_a_run_whose_input_was_left_out_is_not_called_healthy() -> None:
    run = drive()
    lost = {"frame: stamp leaps ahead": N, "cone: too far": 3, "odometry: late": 9 * N}
    diagnosis = diagnose(replace(run, summary={**run.summary, "rejected": lost}))
    assert diagnosis.cause == HEALTHY
    lost["frame: stamp leaps ahead"] = N + 1
    diagnosis = diagnose(replace(run, summary={**run.summary, "rejected": lost}))
    assert (diagnosis.cause, diagnosis.findings) == (UNCLEAR, ())
    assert diagnosis.unclear.startswith(f"{N + 1} of {2 * N + 1} frames were left out")
    assert "milliseconds" in diagnosis.unclear


def test_frames_that_are_too_slow_for_any_sensor_are_of_another_unit() -> None:
    run = drive()
    slow = Trajectory(1e3 * STAMPS, run.trajectory.pose)
    assert "frames are 100 s apart" in diagnose(replace(run, trajectory=slow)).unclear


def test_a_run_that_never_knew_its_place_is_not_called_healthy() -> None:
    run = drive()
    why = N * ("no place leads clearly",)
    status = replace(run.status, status=np.full(N, "INIT"), reason=why)
    diagnosis = diagnose(replace(run, status=status))
    assert diagnosis.cause == UNCLEAR
    assert diagnosis.unclear == "the status was INIT to the end: no place leads clearly"


def test_without_odometry_it_says_what_it_cannot_see() -> None:
    run = drive(scale=0.05)
    none = np.full((N, 3), np.nan)
    run = replace(run, motion=MotionRows(STAMPS, none, none[:, 0]))
    diagnosis = diagnose(run)
    assert diagnosis.cause == HEALTHY
    assert "without odometry" in diagnosis.notes[0]


@pytest.mark.parametrize(
    ("error_m", "precision", "recall", "cause"),
    [
        (0.05, 1.0, 1.0, HEALTHY),
        (0.5, 1.0, 1.0, UNEXPLAINED),
        (0.05, 1.0, 0.7, UNEXPLAINED),
        (0.05, 0.7, 1.0, UNEXPLAINED),
    ],
)
def test_a_bad_map_without_an_explanation_is_not_healthy(
    error_m: float, precision: float, recall: float, cause: str
) -> None:
    cones = {"rmse_aligned_m": error_m, "precision": precision, "recall": recall}
    run = drive()
    judged = {**run.summary, "metrics": {"map": cones}}
    diagnosis = diagnose(replace(run, summary=judged))
    assert diagnosis.cause == cause
    assert bool(diagnosis.harm) == (cause == UNEXPLAINED)


def test_cones_that_are_mostly_missed_are_few_sights() -> None:
    """Two thirds are missed, but a cone that is missed too long is taken for two."""
    found = diagnose(only(drive(), np.random.default_rng(3), 1 / 3)).findings
    assert found[0].cause == "few_sights"
    assert found[0].name == "looks at a cone that miss it"
    assert found[0].measured == pytest.approx(2 / 3, abs=0.1)
    half = diagnose(only(drive(), np.random.default_rng(3), 0.6))
    assert "few_sights" not in [f.cause for f in half.findings]


def test_a_map_without_colours_is_said_after_all_else() -> None:
    run = drive()
    ids = np.arange(len(cones()))
    cov = np.tile(np.eye(2), (len(ids), 1, 1))
    prob = np.tile(np.eye(5)[ConeClass.UNKNOWN], (len(ids), 1))
    grey = ConeMap(ids, cones(), cov, prob, ids)
    (found,) = diagnose(replace(run, cone_map=grey)).findings
    assert (found.cause, found.measured, found.follows) == (
        "colourless_map",
        1.0,
        False,
    )


def test_what_barely_exceeds_its_limit_explains_nothing_that_is_far_beyond() -> None:
    """Sensors come before loops, unless there is next to nothing wrong with them."""

    def said(doubt_m: float, noise: float) -> list[str]:
        run = drive(noise=noise)
        cov = np.tile(0.5 * doubt_m**2 * np.eye(3), (N, 1, 1))
        run = replace(run, pose_cov=PoseCovariances(STAMPS, cov))
        return [f.cause for f in diagnose(run).findings]

    assert said(3.0, 1.7) == ["drift", "sensor_noise"]
    assert said(1.5, 1.7) == ["sensor_noise", "drift"]
    assert said(3.0, 2.5) == ["sensor_noise", "drift"]


def test_what_comes_of_a_cause_follows_from_it() -> None:
    run = replace(drive(bias=0.1), summary={"frames": N})
    found = {f.cause: f.follows for f in diagnose(run).findings}
    assert found["yaw_rate_bias"] is False
    assert found["missed_closure"] is True


@pytest.mark.filterwarnings("error")
def test_a_run_of_an_older_version_or_without_frames_is_looked_at() -> None:
    run = drive()
    old = replace(run, motion=MotionRows.empty(), observations=ObservationRows.empty())
    assert diagnose(old).cause == HEALTHY
    assert "kept no observations" in diagnose(old).notes[0]
    none = replace(run, trajectory=Trajectory(np.zeros(0), np.zeros((0, 3))))
    assert diagnose(none).cause == UNCLEAR
    assert "no path" in diagnose(none).unclear


def test_estimates_of_later_stamps_than_their_frames_do_no_harm() -> None:
    late_s = 0.2
    run = drive()
    ahead = Trajectory(STAMPS + late_s, true_pose(STAMPS + late_s))
    assert diagnose(replace(run, trajectory=ahead)).cause == HEALTHY


def test_a_run_that_was_killed_is_looked_at_as_far_as_it_got() -> None:
    run = drive(scale=0.05)
    seen, n = run.observations, len(run.observations)
    torn = replace(run, summary={}, observations=seen.first(n - 30))
    torn = replace(torn, motion=run.motion.first(N - 2))
    diagnosis = diagnose(torn)
    assert diagnosis.cause == "scale"
    assert "did not finish" in diagnosis.notes[0]


def test_a_killed_run_is_not_blamed_for_closures_that_it_could_not_write_down() -> None:
    run = drive()
    unclosed = replace(run, summary={"frames": N})
    assert [f.cause for f in diagnose(unclosed).findings] == ["missed_closure"]
    assert diagnose(replace(run, summary={})).findings == ()


def test_a_run_that_was_killed_before_its_first_status_has_no_path_to_look_at() -> None:
    run = drive()
    killed = replace(run, summary={}, status=run.status.first(0))
    diagnosis = diagnose(killed)
    assert (diagnosis.cause, diagnosis.findings) == (UNCLEAR, ())


@pytest.mark.parametrize("count", [3, "many", float("nan"), float("inf")])
def test_a_run_without_observations_did_not_leave_most_of_them_out(
    count: object,
) -> None:
    """Older runs did not write them; counts may be none at all."""
    run = replace(drive(), observations=ObservationRows.empty())
    run = replace(run, summary={**run.summary, "rejected": {"cone: too far": count}})
    assert diagnose(run).unclear == ""


def test_sights_are_linked_to_the_nearest_end() -> None:
    frame = np.array([0, 0, 1, 1, 2, 9], dtype=np.int64)
    way = np.linspace(0.0, 9.0, 10)
    world = np.array([[0, 0], [3, 0], [3.1, 0], [0.2, 0], [0.1, 0], [0.1, 0]], float)
    stamps = np.linspace(0.0, 0.9, 10)
    assert linked(frame, world, stamps, way).tolist() == [0, 1, 1, 0, 0, 5]
    assert linked(frame, world, stamps, np.zeros(10)).tolist() == [0, 1, 1, 0, 0, 0]
