"""A suite resumes after a kill, gives the same rows again, and runs on a cluster."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from conegraph.bench.journal import Journal
from conegraph.bench.runner import run_chains
from conegraph.bench.suite import FULL, QUICK, SUITES, Suite
from conegraph.bench.suite_bench import JOURNAL, run_suite
from conegraph.bench.suite_run import failed_row, run_job
from conegraph.bench.workers import Processes, WorkerError
from conegraph.cli import main
from conegraph.errors import ConfigError, SourceError
from conegraph.eval.suite_metrics import METRICS
from conegraph.eval.suite_rows import SuiteRow, read_results
from conegraph.eval.suite_series import read_series
from conegraph.sources import open_source

SMALL = Suite(
    "quick", ("oval",), sensors=("lidar",), backends=("ekf",), seeds=3, laps=1
)
OPTIONS = ["--tracks", "oval", "--sensors", "lidar", "--backends", "ekf"]
OPTIONS += ["--seeds", "3", "--laps", "1"]


def command(*arguments: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", *arguments])
    assert not ended.value.code


def steady(rows: tuple[SuiteRow, ...]) -> list[dict[str, object]]:
    """Rows without times, memory, and the commit that somebody may be working on."""
    varying = {metric.name for metric in METRICS if metric.varies}
    return [
        {
            **row.model_dump(exclude={"metrics", "code_version"}),
            **{k: v for k, v in row.metrics.items() if k not in varying},
        }
        for row in sorted(rows, key=lambda row: row.key)
    ]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A suite that was run in one go."""
    out = tmp_path_factory.mktemp("suite")
    with Processes(2) as workers:
        run_suite(SMALL, out, workers, lambda _: None)
    return out


def test_quick_is_what_it_is_called_and_needs_no_files() -> None:
    jobs = [job for chain in QUICK.chains() for job in chain]
    assert len(jobs) == len({job.key for job in jobs}) == 4 * 2 * 2 * 5
    assert {job.stream.laps for job in jobs} == {2}
    assert set(SUITES) == {"quick", "full"}
    assert len(FULL.chains()) == 12 * 2 * 2 * 2 * 5


def test_back_ends_share_streams_and_commands_replay_them() -> None:
    suite = Suite(
        "x", ("oval",), faults=("missed=0.1&wrong_colour=0.02",), settings=("seed=3",)
    )
    for chain in suite.chains():
        assert len({job.source for job in chain}) == 1
        assert [job.backend for job in chain] == ["ekf", "isam2"]
    job = suite.chains()[0][0]
    assert job.source.endswith("odometry=on&missed=0.1&wrong_colour=0.02")
    assert "--backends ekf --set seed=3 --out" in job.command
    assert f"'{job.source}'" in job.command
    assert len({job.config_hash for job in suite.chains()[0]}) == 2


def test_a_killed_suite_loses_only_what_was_in_progress(
    tmp_path: Path, finished: Path
) -> None:
    journal = tmp_path / JOURNAL
    arguments = [*OPTIONS, "--jobs", "1", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [sys.executable, "-m", "conegraph", "bench", *arguments],
        start_new_session=True,
    )
    give_up = time.monotonic() + 120
    while not journal.exists() or journal.read_text(encoding="utf-8").count("\n") < 2:
        assert time.monotonic() < give_up
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = journal.read_text(encoding="utf-8")
    kept = before.count("\n")
    assert kept == 2
    assert not (tmp_path / "results.parquet").exists()
    wait_for_group_to_end(process.pid)
    with journal.open("a", encoding="utf-8") as file:
        file.write('{"suite":"quick","tra')
    told: list[int] = []
    with Processes(1) as workers:
        rows = run_suite(SMALL, tmp_path, workers, told.append)
    assert told == [2, 3]
    assert journal.read_text(encoding="utf-8").startswith(before)
    assert read_results(tmp_path) == tuple(sorted(rows, key=lambda row: row.key))
    assert steady(rows) == steady(read_results(finished))


def wait_for_group_to_end(group: int) -> None:
    """Workers end by themselves when their owner was killed."""
    give_up = time.monotonic() + 20
    while time.monotonic() < give_up:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("a worker outlives its owner")


def test_a_row_says_what_compare_says_and_its_series_fits(
    tmp_path: Path, finished: Path
) -> None:
    row = read_results(finished)[0]
    assert not row.failed
    assert len(row.config_hash) == 64
    with pytest.raises(SystemExit) as ended:
        main(["compare", row.stream, "--backends", row.backend, "--out", str(tmp_path)])
    assert not ended.value.code
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    figures = report["runs"][row.backend]
    assert row.metrics["map_rmse_aligned_m"] == figures["map"]["rmse_aligned_m"]
    assert row.metrics["laps_counted"] == figures["closures"]["laps"] == 1
    series, placed = read_series(finished / row.series)
    recording = open_source(row.stream)
    assert series.frame_ms_counts.sum() == recording.n_frames
    assert series.position_error_m.max() <= row.metrics["pose_max_m"] * 1.0001
    assert placed.true_xy_m is not None
    nearest = np.linalg.norm(placed.xy_m[:, None] - placed.true_xy_m, axis=2).min(1)
    assert np.sqrt(np.mean(nearest**2)) == pytest.approx(
        row.metrics["map_rmse_aligned_m"], rel=1e-3
    )


def test_the_command_prints_figures_and_writes_the_report(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All runs are there already; what is printed and written follows from them."""
    command(*OPTIONS, "--out", str(finished))
    streams = capsys.readouterr()
    assert f"bench quick: 3 of 3 runs found in {finished}, 0 to do" in streams.err
    assert f"Report: {finished / 'report.html'}" in streams.out
    said = " ".join(streams.out.replace("│", " ").split())
    assert "failed runs 0 of 3" in said
    assert "map RMSE, aligned" in said
    assert (finished / "report.html").is_file()
    command(*OPTIONS, "--out", str(finished), "--json")
    plain = json.loads(capsys.readouterr().out)
    assert plain["contenders"][0]["failures"]["of"] == 3
    command("diff", str(finished), str(finished / "results.parquet"))
    said = capsys.readouterr().out
    assert "3 of 3 pairs agree" in said
    assert "map RMSE, aligned: ekf (new)/ekf (old) 1.000" in said


def test_a_folder_of_other_runs_is_refused(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (finished / "results.parquet").read_bytes()
    with pytest.raises(SystemExit) as ended:
        main(["bench", *OPTIONS, "--set", "seed=3", "--out", str(finished)])
    assert ended.value.code == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "has 3 runs that these options do not ask for" in said
    assert "Give another --out" in said
    assert (finished / "results.parquet").read_bytes() == before


def test_every_run_is_replayed_into_a_folder_of_its_own() -> None:
    jobs = [job for chain in QUICK.chains() for job in chain]
    folders = {job.command.split()[-1] for job in jobs}
    assert len(folders) == len(jobs)
    assert all(folder.startswith("out/replay/") for folder in folders)


def test_what_breaks_off_is_a_row_and_is_done_again(tmp_path: Path) -> None:
    job = SMALL.chains()[0][0]
    lost = job.model_copy(
        update={"stream": job.stream.model_copy(update={"track": "gone.yaml"})}
    )
    row = run_job(lost).row
    assert row.broke_off
    assert row.failed
    assert row.reason.startswith("SourceError: sim:gone.yaml: neither")
    assert np.isnan(row.metrics["precision"])
    journal = Journal[SuiteRow](tmp_path / JOURNAL, (SuiteRow,))
    journal.add(row)
    assert Journal[SuiteRow](tmp_path / JOURNAL, (SuiteRow,)).rows == {}


def test_a_worker_that_dies_takes_one_call_with_it() -> None:
    with Processes(1) as workers:
        assert workers.call(abs, -3) == 3
        with pytest.raises(WorkerError, match="SIGKILL"):
            workers.call(signal.raise_signal, signal.SIGKILL)
        assert workers.call(abs, -4) == 4


def test_an_interrupt_stops_what_waits(tmp_path: Path) -> None:
    journal = Journal[SuiteRow](tmp_path / JOURNAL, (SuiteRow,))

    def told(done: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    chains = Suite("x", ("oval",), backends=("ekf",), seeds=50).chains()
    with pytest.raises(KeyboardInterrupt):
        run_chains(chains, journal, lambda job: failed_row(job, "short"), 1, told)
    assert len(journal.rows) < 50


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """The address of a Dask scheduler with two worker processes."""
    pytest.importorskip("distributed")
    file, log = tmp_path / "scheduler.json", tmp_path / "dask.log"
    quiet = ["--no-dashboard", "--scheduler-file", str(file)]
    roles = (
        ["scheduler", "--host", "127.0.0.1", "--port", "0", *quiet],
        ["worker", "--nworkers", "2", "--nthreads", "1", *quiet],
    )
    with ExitStack() as stack, log.open("w", encoding="utf-8") as said:
        for role in roles:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *role],
                cwd=tmp_path,
                stdout=said,
                stderr=said,
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)
        give_up = time.monotonic() + 60
        while log.read_text(encoding="utf-8").count("Registered to:") < 2:
            assert time.monotonic() < give_up, log.read_text(encoding="utf-8")
            time.sleep(0.1)
        yield json.loads(file.read_text(encoding="utf-8"))["address"]


def test_a_dask_cluster_gives_the_same_rows(
    tmp_path: Path, finished: Path, scheduler: str
) -> None:
    out = tmp_path / "out"
    command(*OPTIONS, "--out", str(out), "--scheduler", scheduler)
    assert steady(read_results(out)) == steady(read_results(finished))
    assert len(list((out / "series").iterdir())) == 3


def test_without_dask_the_error_says_what_to_install(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SystemExit) as ended:
        main(["bench", "--out", str(tmp_path), "--scheduler", "tcp://127.0.0.1:1"])
    assert ended.value.code == 1
    assert "pip install 'conegraph[dask]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "code"),
    [
        ("--suite", "huge", 2),
        ("--suite", "quik", 2),
        ("--sensors", "radar", 2),
        ("--odometry", "maybe", 2),
        ("--faults", ",", 2),
        ("--tracks", "no-such-track", 1),
        ("--faults", "rain=0.1", 1),
        ("--backends", "ukf", 1),
        ("--set", "motion.nothing=1", 1),
    ],
)
def test_a_wrong_option_is_named_before_anything_runs(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    value: str,
    code: int,
) -> None:
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        main(["bench", option, value, "--out", str(out)])
    assert ended.value.code == code
    said = capsys.readouterr().err
    assert value.partition("=")[0] in said
    assert ("did you mean quick?" in said) == (value == "quik")
    assert not out.exists()


def test_a_suite_of_what_does_not_exist_is_refused() -> None:
    with pytest.raises(SourceError, match="nowhere"):
        Suite("x", ("nowhere.yaml",)).chains()
    with pytest.raises(ConfigError, match="ukf"):
        Suite("x", ("oval",), backends=("ukf",)).chains()
