"""``conegraph doctor`` on a run that it has to explain."""

from __future__ import annotations

import json
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


def test_a_source_that_is_gone_is_said(
    biased: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = biased / "config.toml"
    text = config.read_text(encoding="utf-8")
    assert "sim:acceleration" in text
    config.write_text(text.replace("sim:acceleration", "sim:gone"), encoding="utf-8")
    assert run("doctor", biased) == 0
    told = capsys.readouterr()
    assert "Without truth: sim:gone" in told.err
    assert "(scale, look at" in told.out


def test_a_folder_without_a_run_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("doctor", tmp_path) == 1
    assert "trajectory.tum" in capsys.readouterr().err
