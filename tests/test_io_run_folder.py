"""What a run leaves behind, also when it is killed, torn or out of space."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conegraph.errors import ConegraphError, FileFormatError
from conegraph.io.plain import to_plain
from conegraph.io.run_folder import RunWriter, read_run
from conegraph.types import (
    Associations,
    ConeClass,
    ConeMap,
    ConeObservations,
    Estimate,
    FrameRecord,
    LoopClosure,
    MatchStatus,
    OdometryStep,
    Status,
    Trajectory,
)

FULL = Path("/dev/full")
NAN = float("nan")
POSE_COV = np.array([[4.0, 0.5, -0.25], [0.5, 2.0, 0.125], [-0.25, 0.125, 1.0]])

YELLOW = np.array([0.1, 0.6, 0.1, 0.1, 0.1])


def record(k: int, n: int = 3) -> FrameRecord:
    """Frame k with n cones: the first matched, the others new without a distance."""
    t = k / 30.0
    eye = np.tile(np.eye(2), (n, 1, 1))
    status = (MatchStatus.MATCHED, *[MatchStatus.NEW] * (n - 1))[:n]
    d2 = np.array([1.25, *[NAN] * (n - 1)])[:n]
    pose = np.array([0.5 * k, -0.25 * k, 0.01 * k])
    return FrameRecord(
        ConeObservations(
            t, np.tile([1.5, -0.25], (n, 1)), eye, np.tile(YELLOW, (n, 1))
        ),
        Associations(t, status, np.arange(n), d2, *((1.25, 2) if n and k else ())),
        Estimate(t, pose, POSE_COV, np.zeros(2), Status.DEGRADED, reset_counter=2),
        reason="few cones, one\nof them odd",
        stage_ms={"associate": 0.5, "frame": 1.5 + k},
        odometry=OdometryStep(0.5 * pose, 0.25 * k) if k else None,
    )


def cones(n: int = 4) -> ConeMap:
    rng = np.random.default_rng(5)
    cov = rng.normal(size=(n, 2, 2))
    prob = rng.dirichlet(np.ones(5), n)
    symmetric = cov @ cov.transpose(0, 2, 1)
    return ConeMap(
        np.arange(7, 7 + n), rng.normal(size=(n, 2)), symmetric, prob, np.full(n, 3)
    )


def write_run(folder: Path, frames: int = 5) -> None:
    with RunWriter(folder, "seed = 1\n") as writer:
        for k in range(frames):
            writer.frame(record(k))
        smoothed = Trajectory(np.array([0.0, 1.0]), np.array([[0, 0, 0], [1, 2, 3.0]]))
        writer.finish(cones(), smoothed, {"frames": frames, "peak": NAN})


def test_a_finished_run_reads_back_as_it_was_written(tmp_path: Path) -> None:
    write_run(tmp_path / "new" / "run")
    run = read_run(tmp_path / "new" / "run")
    k = np.arange(5)
    np.testing.assert_allclose(run.trajectory.stamp_s, k / 30.0, atol=5e-10)
    pose = np.stack([0.5 * k, -0.25 * k, 0.01 * k], axis=-1)
    np.testing.assert_allclose(run.trajectory.pose, pose, atol=2e-9)
    assert run.smoothed is not None
    np.testing.assert_allclose(run.smoothed.pose[1], [1, 2, 3], atol=2e-9)
    made = run.associations
    assert made.observation.tolist() == [0, 1, 2] * 5
    assert made.status.tolist() == ["matched", "new", "new"] * 5
    assert made.landmark_id.tolist() == [0, 1, 2] * 5
    np.testing.assert_array_equal(made.d2, [1.25, NAN, NAN] * 5)
    np.testing.assert_array_equal(run.timing_ms["frame"], 1.5 + k)
    assert run.status.status.tolist() == ["DEGRADED"] * 5
    assert run.status.reason[0] == "few cones; one of them odd"
    assert run.status.reset_counter.tolist() == [2] * 5
    np.testing.assert_allclose(run.pose_cov.stamp_s, k / 30.0, atol=5e-10)
    np.testing.assert_array_equal(run.pose_cov.cov, np.tile(POSE_COV, (5, 1, 1)))
    np.testing.assert_allclose(run.motion.stamp_s, np.arange(5) / 30.0, atol=1e-9)
    assert np.isnan(run.motion.odometry[0]).all()
    np.testing.assert_array_equal(
        run.motion.odometry[1:], np.outer(np.arange(1, 5), (0.25, -0.125, 0.005))
    )
    np.testing.assert_array_equal(
        run.motion.yaw_rate_bias_radps, [NAN, 0.25, 0.5, 0.75, 1]
    )
    seen = run.observations
    assert seen.observation.tolist() == 5 * [0, 1, 2]
    np.testing.assert_array_equal(seen.xy_m, np.tile([[1.5, -0.25]], (15, 1)))
    np.testing.assert_array_equal(seen.cov_m2, np.tile(np.eye(2), (15, 1, 1)))
    assert (seen.cone_class == ConeClass.YELLOW).all()
    # The first frame had nothing to compare with.
    np.testing.assert_allclose(run.consistency.stamp_s, k[1:] / 30.0, atol=5e-10)
    assert run.consistency.nis.tolist() == [1.25] * 4
    assert run.consistency.dof.tolist() == [2] * 4
    assert run.finished
    assert run.summary == {"schema_version": 1, "frames": 5, "peak": None}


def test_the_map_reads_back_bit_by_bit(tmp_path: Path) -> None:
    write_run(tmp_path)
    found, written = read_run(tmp_path).cone_map, cones()
    for name in ("id", "xy_m", "cov_m2", "class_prob", "observations"):
        np.testing.assert_array_equal(getattr(found, name), getattr(written, name))


def test_a_finished_run_without_the_tables_of_consistency_is_read(
    tmp_path: Path,
) -> None:
    write_run(tmp_path)
    (tmp_path / "consistency.csv").unlink()
    (tmp_path / "pose_cov.csv").unlink()
    (tmp_path / "motion.csv").unlink()
    (tmp_path / "observations.csv").unlink()
    run = read_run(tmp_path)
    assert (len(run.trajectory), len(run.consistency), len(run.pose_cov)) == (5, 0, 0)
    assert (len(run.motion), len(run.observations)) == (0, 0)


def test_files_are_laid_out_as_documented(tmp_path: Path) -> None:
    write_run(tmp_path, frames=1)
    text = {p.name: p.read_text() for p in tmp_path.iterdir()}
    assert sorted(text) == [
        "associations.csv",
        "config.toml",
        "consistency.csv",
        "map.csv",
        "motion.csv",
        "observations.csv",
        "pose_cov.csv",
        "status.csv",
        "summary.json",
        "timing.csv",
        "trajectory.tum",
        "trajectory_smoothed.tum",
    ]
    assert text["config.toml"] == "seed = 1\n"
    assert text["trajectory.tum"] == (
        "0.000000000 0.000000000 0.000000000 0 0 0 0.000000000 1.000000000\n"
    )
    assert text["associations.csv"].splitlines() == [
        "t,observation,status,landmark,d2",
        "0.000000000,0,matched,0,1.25",
        "0.000000000,1,new,1,",
        "0.000000000,2,new,2,",
    ]
    assert text["timing.csv"].splitlines() == [
        "t,stage,ms",
        "0.000000000,associate,0.5000",
        "0.000000000,frame,1.5000",
    ]
    assert text["status.csv"].splitlines() == [
        "t,status,reason,reset_counter",
        "0.000000000,DEGRADED,few cones; one of them odd,2",
    ]
    assert text["map.csv"].splitlines()[0] == (
        "id,x,y,class,p_blue,p_yellow,p_orange,p_big_orange,p_unknown,"
        "cov_xx,cov_xy,cov_yy,observations"
    )


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    write_run(tmp_path / "a")
    write_run(tmp_path / "b")
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_large_stamps_keep_their_nanoseconds(tmp_path: Path) -> None:
    stamp = 1248272272.841
    with RunWriter(tmp_path, "") as writer:
        first = record(0)
        estimate = Estimate(stamp, np.array([1, 2, -3.0]), np.eye(3), np.zeros(2))
        writer.frame(FrameRecord(first.observations, first.associations, estimate))
    run = read_run(tmp_path)
    assert run.trajectory.stamp_s[0] == stamp
    np.testing.assert_allclose(run.trajectory.pose[0], [1, 2, -3], atol=2e-9)


def test_a_run_that_ended_in_nan_can_be_read(tmp_path: Path) -> None:
    with RunWriter(tmp_path, "") as writer:
        first = record(0)
        estimate = Estimate(0.0, np.full(3, NAN), np.eye(3), np.zeros(2))
        writer.frame(FrameRecord(first.observations, first.associations, estimate))
        broken = cones(2)
        xy = np.array([[NAN, 1.0], [2.0, 3.0]])
        writer.finish(replace(broken, xy_m=xy), None, {"frames": 1})
    run = read_run(tmp_path)
    assert np.isnan(run.trajectory.pose[0]).all()
    np.testing.assert_array_equal(run.cone_map.xy_m, xy)


def test_an_observation_without_a_colour_is_unknown(tmp_path: Path) -> None:
    made = record(1, n=1)
    frame = replace(made.observations, class_prob=np.full((1, 5), 0.2))
    with RunWriter(tmp_path, "") as writer:
        writer.frame(replace(made, observations=frame))
    assert read_run(tmp_path).observations.cone_class.tolist() == [ConeClass.UNKNOWN]


def test_an_older_run_leaves_nothing_in_a_newer_one(tmp_path: Path) -> None:
    write_run(tmp_path)
    with RunWriter(tmp_path, "") as writer:
        writer.frame(record(0, n=0))
    run = read_run(tmp_path)
    assert not run.finished
    assert run.smoothed is None
    assert len(run.cone_map) == 0
    assert (len(run.trajectory), len(run.associations)) == (1, 0)


def test_a_checkpoint_shows_the_map_while_the_run_goes_on(tmp_path: Path) -> None:
    with RunWriter(tmp_path, "") as writer:
        writer.checkpoint(cones(2))
        assert len(read_run(tmp_path).cone_map) == 2
        writer.checkpoint(cones(9))
        assert len(read_run(tmp_path).cone_map) == 9


KILLED_WRITER = """
import runpy, sys
from pathlib import Path
test = runpy.run_path(sys.argv[1])
with test["RunWriter"](Path(sys.argv[2]), "") as writer:
    for k in range(10**9):
        writer.frame(test["record"](k))
        print(k, flush=True)
"""


def test_kill_9_loses_no_frame_that_was_acknowledged(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED_WRITER, __file__, str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        acknowledged = [process.stdout.readline() for _ in range(200)]
        process.kill()
    run = read_run(tmp_path / "run")
    frames = int(acknowledged[-1]) + 1
    assert frames == 200
    assert len(run.trajectory) >= frames
    assert len(run.status) >= frames
    assert len(run.associations) >= 3 * frames
    assert len(run.timing_ms["frame"]) >= frames
    assert not run.finished


@pytest.mark.parametrize(
    "name", ["trajectory.tum", "associations.csv", "timing.csv", "status.csv"]
)
def test_a_torn_last_line_of_an_unfinished_run_is_left_out(
    tmp_path: Path, name: str
) -> None:
    write_run(tmp_path)
    (tmp_path / "summary.json").unlink()
    whole = (tmp_path / name).read_bytes()
    for kept in range(0, len(whole), 3):
        (tmp_path / name).write_bytes(whole[:kept])
        run = read_run(tmp_path)
        rows = {
            "trajectory.tum": len(run.trajectory),
            "associations.csv": 1 + len(run.associations),
            "timing.csv": 1 + sum(map(len, run.timing_ms.values())),
            "status.csv": 1 + len(run.status),
        }
        header = 0 if name == "trajectory.tum" else 1
        assert rows[name] == max(whole[:kept].count(b"\n"), header)


@pytest.mark.parametrize(
    ("name", "old", "new", "line", "reason"),
    [
        ("trajectory.tum", "0.500000000", "half", 2, "'half' is not a number"),
        ("trajectory.tum", " 0 0 0 ", " 0 0 ", 1, "has 7 columns, not 8"),
        ("associations.csv", "matched", "mached", 2, "'mached' is not one of matched"),
        ("associations.csv", "1.25", "1.2.5", 2, "'1.2.5' is not a number"),
        ("associations.csv", "landmark", "mark", 1, "the columns must be t,observat"),
        ("status.csv", "DEGRADED", "FINE", 2, "'FINE' is not one of INIT, OK"),
        ("status.csv", ",2\n", ",2.5\n", 2, "'2.5' is not a whole number"),
        ("timing.csv", "1.5000", "-", 3, "'-' is not a number"),
        ("map.csv", ",3\n", ",3,1\n", 2, "has 14 columns, not 13"),
    ],
)
def test_anything_else_malformed_names_file_and_line(
    tmp_path: Path, name: str, old: str, new: str, line: int, reason: str
) -> None:
    write_run(tmp_path)
    path = tmp_path / name
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FileFormatError) as caught:
        read_run(tmp_path)
    assert str(caught.value).startswith(f"{path}:{line}: {reason}")


@pytest.mark.parametrize("text", ["{", "[]", "{}", "[" * 100_000])
def test_a_summary_that_is_none_is_an_error(tmp_path: Path, text: str) -> None:
    write_run(tmp_path)
    (tmp_path / "summary.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"summary\.json"):
        read_run(tmp_path)


def test_a_finished_run_with_a_torn_file_is_an_error(tmp_path: Path) -> None:
    write_run(tmp_path)
    path = tmp_path / "trajectory.tum"
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(FileFormatError, match="has no end") as caught:
        read_run(tmp_path)
    assert caught.value.line == 5


def test_a_folder_without_a_run_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"trajectory\.tum"):
        read_run(tmp_path)


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    taken = tmp_path / "run"
    taken.write_text("mine")
    with pytest.raises(ConegraphError, match="is a file"), RunWriter(taken, ""):
        pass
    assert taken.read_text() == "mine"


@pytest.mark.skipif(not FULL.exists(), reason="needs the device that is always full")
@pytest.mark.parametrize(
    ("linked", "named"),
    [
        ("trajectory.tum", "trajectory.tum"),
        ("timing.csv", "timing.csv"),
        ("config.toml.part", "config.toml"),
        ("map.csv.part", "map.csv"),
        ("summary.json.part", "summary.json"),
    ],
)
def test_a_full_disk_is_one_error_that_names_the_file(
    tmp_path: Path, linked: str, named: str
) -> None:
    (tmp_path / linked).symlink_to(FULL)
    with pytest.raises(ConegraphError, match=f"{named}: cannot be written: No space"):
        write_run(tmp_path)


def test_plain_values_are_json(tmp_path: Path) -> None:
    plain = to_plain(
        {
            Status.OK: (np.float64(1.5), np.int64(2), math.inf),
            "closure": LoopClosure(1.0, 2.0, True, "seen"),
            "array": np.array([[1.0, NAN]]),
            "path": tmp_path,
        }
    )
    assert json.loads(json.dumps(plain, allow_nan=False)) == {
        "OK": [1.5, 2, None],
        "closure": {
            "stamp_s": 1.0,
            "distance_m": 2.0,
            "accepted": True,
            "reason": "seen",
        },
        "array": [[1.0, None]],
        "path": str(tmp_path),
    }
    with pytest.raises(TypeError, match="set has no plain form"):
        to_plain({1, 2})
