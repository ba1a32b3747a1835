"""``conegraph doctor`` on a run that it has to explain."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from conegraph.cli import main


def run(*arguments: object) -> int:
    """Run the command in this process and return its exit status."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    code = ended.value.code
    assert isinstance(code, int)
    return code


@pytest.fixture(scope="module")
def biased(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose wheels are 5 % too small."""
    out = tmp_path_factory.mktemp("biased")
    assert run("run", "sim:acceleration?wheel_scale=1.05&seed=3", "--out", out) == 0
    return out


def test_wheels_are_blamed_with_evidence_time_and_advice(
    biased: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run("doctor", biased, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    first = said["findings"][0]
    assert said["cause"] == first["cause"] == "wheel_scale"
    assert first["measured"] == pytest.approx(0.05, abs=0.01)
    assert 0.0 <= first["at_s"] <= 30.0
    assert "wheel radius" in first["advice"]


def test_without_truth_wheels_and_ranges_are_one(
    biased: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run("doctor", biased, "--no-truth") == 0
    assert "1. odometry's speed or the sensor's ranges" in capsys.readouterr().out


def test_a_run_without_truth_is_explained_as_far_as_it_can(
    biased: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = shutil.copytree(biased, tmp_path / "kept")
    (kept / "truth.tum").unlink()
    capsys.readouterr()
    assert run("doctor", kept, "--json") == 0
    assert json.loads(capsys.readouterr().out)["cause"] == "scale"


def test_a_folder_without_a_run_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("doctor", tmp_path) == 1
    assert "trajectory.tum" in capsys.readouterr().err


def test_a_folder_of_several_runs_names_them(
    biased: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("ekf", "isam2"):
        shutil.copytree(biased, tmp_path / name)
    assert run("doctor", tmp_path) == 1
    said = capsys.readouterr().err
    assert f"holds 2 runs: choose {tmp_path / 'ekf'} or {tmp_path / 'isam2'}" in said


def test_stamps_in_milliseconds_are_said_before_any_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{100 * k},{5 + k % 3},{2 - k % 5}" for k in range(40)]
    (tmp_path / "log").mkdir()
    text = "\n".join(["t,x,y", *rows]) + "\n"
    (tmp_path / "log" / "cones.csv").write_text(text, encoding="utf-8")
    assert run("run", tmp_path / "log", "--out", tmp_path / "out") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("Beware: 39 of 40 frames were left out, most of them for")
    assert "in seconds, and not in milliseconds?" in said
    assert run("doctor", tmp_path / "out") == 0
    said = capsys.readouterr().out
    assert said.startswith("cannot tell: 39 of 40 frames were left out")
    assert "healthy" not in said
