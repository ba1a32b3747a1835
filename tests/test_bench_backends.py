"""The benchmark names its streams, resumes, and judges each figure by its target."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import typer

from conegraph.bench.accuracy_figures import accuracy_figures
from conegraph.bench.backends import figures_of, measure_all
from conegraph.bench.figure import Figure, at_most
from conegraph.bench.journal import Journal
from conegraph.bench.lap_truth import true_lap_ends
from conegraph.bench.latency_figures import latency_figures
from conegraph.bench.memory import PeakMemory
from conegraph.bench.plan import ACCURACY, KNOWN, LONG, LONG_LAPS, SIZES, Plan
from conegraph.bench.pose_figures import pose_figures
from conegraph.bench.rows import AnyRow, CostRow, Job, LapRow, ReferenceRow, RunRow
from conegraph.bench.run import as_they_came
from conegraph.bench.run_log import RunLog
from conegraph.bench.streams import Stream, drives, sized_course, track_names
from conegraph.bench.worker import Task, reference_of, work
from conegraph.bench.workers import Processes
from conegraph.cli import main
from conegraph.cli.bench_backends import _seeds
from conegraph.errors import SourceError
from conegraph.sources import open_source
from conegraph.types import (
    Associations,
    ConeObservations,
    Estimate,
    FrameRecord,
    Recording,
)

STREAM = Stream(track="oval", laps=1, sensor="lidar")
JOB = Job(group=ACCURACY, stream=STREAM, backend="ekf")


def run(backend: str = "ekf", **figures: object) -> RunRow:
    """A perfect run, but for what is given; `track` tells streams apart."""
    track = str(figures.pop("track", "oval"))
    group = str(figures.pop("group", ACCURACY))
    job = Job(group=group, stream=Stream(track=track, odometry=False), backend=backend)
    perfect = {
        "map_rmse_m": 0.05,
        "batch_rmse_m": 0.05,
        "pose_rmse_m": 0.1,
        "pose_max_m": 0.3,
        "batch_pose_rmse_m": 0.1,
        "ate_m": 0.1,
        "ate_2_laps_m": 0.1,
        "precision": 1.0,
        "recall": 1.0,
        "pose_nees": 1.0,
        "map_nees": 1.0,
    }
    return RunRow.model_validate({"job": job, **perfect, **figures})


def named(figures: list[Figure], *words: str) -> Figure:
    (found,) = (f for f in figures if all(word in f.name for word in words))
    return found


def test_a_streams_source_opens_the_same_stream() -> None:
    stream = Stream(
        track="random:3", seed=5, laps=1, sensor="lidar", odometry=False, missed=0.1
    )
    assert stream.source == (
        "sim:random:3?laps=1&seed=5&sensor=lidar&odometry=off&missed=0.1"
    )
    ours, theirs = stream.recording(), open_source(stream.source)
    assert isinstance(theirs, Recording)
    assert len(ours.stream) == len(theirs.stream)
    for a, b in zip(ours.stream[:50], theirs.stream[:50], strict=True):
        assert a.stamp_s == b.stamp_s
        np.testing.assert_array_equal(getattr(a, "xy_m", 0), getattr(b, "xy_m", 0))


def test_wrong_colours_have_the_same_optimum_and_missed_cones_do_not() -> None:
    painted = STREAM.model_copy(update={"wrong_colour": 0.1})
    thinned = STREAM.model_copy(update={"missed": 0.1})
    keys = [
        reference_of(JOB.model_copy(update={"stream": s})).key
        for s in (STREAM, painted, thinned)
    ]
    assert keys[0] == keys[1] != keys[2]


@pytest.mark.parametrize("cones", [100, 400])
def test_courses_come_in_the_size_asked_for(cones: int) -> None:
    assert cones <= len(sized_course(cones)) <= 1.03 * cones + 2


def test_tracks_of_a_folder_are_its_closed_ones(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    turn = np.arange(0, 2 * np.pi, 0.3)
    lines = ["x,y,class"]
    for radius, colour in ((12, "blue"), (15, "yellow")):
        lines += [f"{radius * np.cos(a)},{radius * np.sin(a)},{colour}" for a in turn]
    (tmp_path / "ring.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "line.csv").write_text("x_m,y_m\n1,2\n", encoding="utf-8")
    names = track_names(f"{tmp_path}, random:4")
    assert "line.csv" in caplog.text
    assert names == (str(tmp_path / "ring.csv"), "random:4")
    assert drives(names, (7, 8, 9))[2] == (names[0], 9)
    with pytest.raises(SourceError, match="--tracks"):
        track_names(" , ")


def test_true_laps_end_at_the_gate() -> None:
    recording = Stream(track="oval", laps=2, sensor="lidar").recording()
    ends, path = true_lap_ends(recording), recording.truth_trajectory
    assert path is not None
    assert len(ends) == 2
    # The oval's timing line crosses the lane 6 m ahead of where the car waits.
    x = np.interp(ends, path.stamp_s, path.pose[:, 0])
    y = np.interp(ends, path.stamp_s, path.pose[:, 1])
    np.testing.assert_allclose(x, 6.0, atol=0.05)
    assert np.abs(y).max() < 1.0


def test_a_closure_is_false_when_most_of_its_matches_are() -> None:
    log = RunLog()
    for landmark, true_id in (
        ([0, 1, 2], [10, 11, 12]),
        ([0, 1, 2], [10, 11, 12]),
        ([0, 1, 2], [10, 12, 11]),
        ([0, 1, 2], [10, 11, 30]),
    ):
        log.landmark.append(np.array(landmark))
        log.true_id.append(np.array(true_id))
    log.closed = [1, 3]
    assert log.false_closures() == 0
    log.closed = [1, 2]
    assert log.false_closures() == 1


def test_peak_memory_is_that_since_the_last_look() -> None:
    memory = PeakMemory()
    if np.isnan(memory.take_mb()):
        pytest.skip("this system keeps no high-water marks")
    quiet = memory.take_mb()
    block = np.ones(8_000_000)
    del block
    loud = memory.take_mb()
    assert loud > quiet + 50.0
    assert memory.take_mb() < loud - 30.0


def test_a_median_is_judged_and_what_failed_is_infinitely_bad() -> None:
    assert at_most("a", [1.0, 1.04, 9.0], 1.05).met is True
    assert at_most("a", [1.0, 1.06, 9.0], 1.05).met is False
    failed = at_most("a", [1.0, float("nan")], 1.05)
    assert failed.met is False
    assert failed.values["worst"] == np.inf
    assert at_most("a", [], 1.05).met is None


def test_figures_of_perfect_runs_are_met_and_of_bad_ones_are_not() -> None:
    fine = [run(b, track=f"random:{n}") for b in ("ekf", "isam2") for n in range(4)]
    known = [
        r.model_copy(update={"job": r.job.model_copy(update={"group": KNOWN})})
        for r in fine
    ]
    runs = [*fine, *known]
    figures = [*accuracy_figures(runs, []), *pose_figures(runs, [])]
    missed = [f.name for f in figures if f.met is False]
    # Equal back ends cannot differ by 0.6.
    assert missed == [named(figures, "hardest quarter").name]
    bad = run(
        "ekf",
        track="random:9",
        map_rmse_m=0.5,
        pose_max_m=2.5,
        precision=0.8,
        duplicates=3,
        false_closures=1,
    )
    worse = accuracy_figures([*fine, *known, bad], [])
    for words in (
        ("ekf", "divergences, all"),
        ("ekf", "duplicates"),
        ("ekf", "false closures"),
        ("ekf", "cone precision"),
    ):
        assert named(worse, *words).met is False
    assert named(worse, "ekf", "duplicates").values["total"] == 3
    assert named(worse, "isam2", "duplicates").met is True
    crashed = RunRow(job=fine[0].job, reason="boom")
    assert crashed.diverged


def test_hard_streams_are_those_where_the_filter_errs_most() -> None:
    ekf = [
        run("ekf", track=f"random:{n}", ate_2_laps_m=0.1 * (n + 1)) for n in range(8)
    ]
    isam2 = [
        run("isam2", track=f"random:{n}", ate_2_laps_m=0.1 if n < 6 else 0.04 * (n + 1))
        for n in range(8)
    ]
    hard = named(pose_figures([*ekf, *isam2], []), "hardest quarter")
    assert hard.values == {
        "median": pytest.approx(0.4),
        "worst": pytest.approx(0.4),
        "n": 2.0,
    }
    assert hard.met


def test_the_yardstick_is_judged_by_its_own_spread() -> None:
    rows = [
        ReferenceRow(key=str(n), map_rmse_m=0.1, map_bound_m=0.1, map_bound_sigma=0.2)
        for n in range(16)
    ]
    fine = named(accuracy_figures([], rows), "batch optimum / Cram")
    # Two standard deviations of the mean square: 2 * 0.2 / 4.
    assert fine.values["high"] == pytest.approx(np.sqrt(1.1))
    assert fine.met
    twice = [row.model_copy(update={"map_rmse_m": 0.2}) for row in rows]
    assert named(accuracy_figures([], twice), "batch optimum / Cram").met is False


def test_what_the_bound_allows_is_said() -> None:
    """Half of the frames at three times, half at four times the whole drive's bound."""
    rows = [run("ekf", track=str(n)) for n in range(3)]
    references = [
        ReferenceRow(
            key=reference_of(row.job).key,
            causal_bound_m=(0.3, 0.4),
            pose_bound_m=0.1,
        )
        for row in rows
    ]
    least = named(pose_figures(rows, references), "bound: pose", "camera, vision only")
    assert least.values["median"] == pytest.approx(np.sqrt(12.5))
    assert least.met is None


def test_growth_and_cost() -> None:
    laps = tuple(
        LapRow(number=n, p50_ms=1.0, p99_ms=1.5 + 0.05 * n, max_ms=3.0, peak_mb=100 + n)
        for n in range(1, LONG_LAPS + 1)
    )
    long = run("ekf", group=LONG, laps=laps)
    cost_job = Job(group=SIZES, stream=STREAM, backend="cost")
    costs = [
        CostRow(job=cost_job, cones=n, frame_ms=1e-4 * n**1.5) for n in (100, 200, 800)
    ]
    figures = latency_figures([long], costs)
    p99 = named(figures, "EKF: frame p99")
    assert p99.values["p99_ms"] == pytest.approx(2.0)
    assert p99.met
    assert named(figures, "ekf: frame p99, lap").values["ratio"] == pytest.approx(
        2.0 / 1.55
    )
    assert named(figures, "ekf: frame p99, lap").met is False
    assert named(figures, "ekf: peak memory").met
    assert named(figures, "exponent").values["p"] == pytest.approx(1.5)
    assert named(figures, "iSAM2: frame p99, 225").met is None


def test_rows_survive_a_kill(tmp_path: Path) -> None:
    kinds = (ReferenceRow, CostRow, RunRow)
    file = Journal[AnyRow](tmp_path / "rows.jsonl", kinds)
    fine = run("ekf", map_nees=float("nan"))
    failed = RunRow(job=Job(group=KNOWN, stream=STREAM, backend="ekf"), reason="boom")
    file.add(fine)
    file.add(failed)
    with (tmp_path / "rows.jsonl").open("a", encoding="utf-8") as rows:
        rows.write('{"job": {"group": "acc')
    again = Journal[AnyRow](tmp_path / "rows.jsonl", kinds)
    # What failed, and what was cut off, is done again.
    assert list(again.rows) == [fine.job.key]
    row = again.rows[fine.job.key]
    assert isinstance(row, RunRow)
    assert np.isnan(row.map_nees)
    assert row.model_dump_json() == fine.model_dump_json()
    # A row after one that was cut off is not lost with it.
    again.add(failed.model_copy(update={"reason": ""}))
    assert len(Journal[AnyRow](tmp_path / "rows.jsonl", kinds).rows) == 2


def test_a_worker_says_why_it_failed() -> None:
    job = Job(group=ACCURACY, stream=Stream(track="no-such-track"), backend="ekf")
    with Processes(1) as workers:
        row = workers.call(work, Task(job=job))
    assert isinstance(row, RunRow)
    assert row.reason.startswith("SourceError: sim:no-such-track: neither")


@pytest.mark.parametrize("given", ["0", "", "1,x"])
def test_seeds_that_are_no_drives_are_refused(given: str) -> None:
    with pytest.raises(typer.BadParameter, match="--seeds"):
        _seeds(given)


def test_the_whole_benchmark_and_that_it_resumes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["bench", "backends", "--tracks", "oval", "--seeds", "1"]
    arguments += ["--laps", "1", "--sensors", "lidar", "--odometry", "on"]
    arguments += ["--backends", "ekf", "--no-stress", "--no-latency"]
    out, report = tmp_path / "out", tmp_path / "figures.json"
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--out", str(out), "--json", str(report)])
    assert not ended.value.code
    assert "map RMSE aligned / batch, lidar" in " ".join(
        capsys.readouterr().out.split()
    )
    figures = json.loads(report.read_text(encoding="utf-8"))["figures"]
    values = {f["name"]: f for f in figures}
    ratio = values["ekf: map RMSE aligned / batch, lidar, with odometry, final"]
    assert 0.8 < ratio["values"]["median"] < 1.2
    assert values["ekf: duplicates"]["met"] is True
    assert values["ekf: divergences, all streams"]["values"]["n"] == 1.0
    before = (out / "rows.jsonl").read_text(encoding="utf-8")
    assert len(before.splitlines()) == 3
    plan = Plan(
        drives=(("oval", 0),),
        laps=1,
        sensors=("lidar",),
        odometry=(True,),
        backends=("ekf",),
        stress=False,
        latency=False,
    )
    told: list[int] = []
    rows = measure_all(plan, out, 1, told.append)
    assert (out / "rows.jsonl").read_text(encoding="utf-8") == before
    assert told[0] == 3
    assert len(figures_of(rows)) == len(figures)


def test_a_wrong_option_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    for option, value in (("--sensors", "radar"), ("--seeds", "many")):
        with pytest.raises(SystemExit) as ended:
            main(["bench", "backends", option, value])
        assert ended.value.code == 2
        assert option in capsys.readouterr().err


def test_frames_of_a_live_run_come_when_they_were_seen() -> None:
    records = [
        FrameRecord(
            ConeObservations(stamp_s, np.zeros(0), np.zeros(0), np.zeros(0)),
            Associations(stamp_s, (), np.zeros(0, dtype=np.int64), np.zeros(0)),
            Estimate(stamp_s, np.zeros(3), np.eye(3), np.zeros(2)),
        )
        for stamp_s in (5.0, 5.1, 5.2, 5.3)
    ]
    began = time.perf_counter()
    assert list(as_they_came(iter(records))) == records
    # The first frame starts the clock, and the last is followed by one step more.
    assert time.perf_counter() - began >= 0.39
