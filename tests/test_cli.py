"""Whole commands: what they print, what they write, how they end."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from conegraph.cli import main

RUN_FILES = {
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
}
DRIVE = "sim:oval?laps=1"


def run(*arguments: object) -> int:
    """Run the command in this process and return its exit status."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    code = ended.value.code
    assert isinstance(code, int)
    return code


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a cone log of a short drive, made by the command itself."""
    folder = tmp_path_factory.mktemp("simulated") / "log"
    assert run("simulate", "oval", "--laps", 1, "--seed", 5, "--out", folder) == 0
    return folder


@pytest.fixture(scope="session")
def compared(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a comparison over that log."""
    out = tmp_path_factory.mktemp("compared") / "out"
    assert run("compare", log, "--out", out, "--backends", "ekf,isam2,ekf/thesis") == 0
    return out


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from conegraph.cli import main\n"
        "try:\n"
        "    main(['--help'])\n"
        "except SystemExit:\n"
        "    pass\n"
        "heavy = {'numpy', 'scipy', 'gtsam', 'rerun', 'cv2', 'rich', 'pydantic'}\n"
        "print(*sorted(heavy & sys.modules.keys()), file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stderr.split() == []
    assert "compare" in done.stdout


def test_only_what_works_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--help") == 0
    text = capsys.readouterr().out
    commands = [line.split()[0] for line in text.split("Commands:\n")[1].splitlines()]
    assert commands == [
        "demo",
        "run",
        "compare",
        "detect",
        "calibrate",
        "record",
        "simulate",
        "track",
        "train-detector",
        "tune",
        "doctor",
        "view",
        "bench",
        "config",
    ]
    assert "..." not in text.split("Commands:\n")[1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["run"],
        ["run", "--out", "x"],
        ["run", DRIVE, "--out", "x", "--mode", "update"],
        ["run", DRIVE, "--out", "x", "--map", "m.csv", "--mode", "guess"],
        ["compare", DRIVE, "--out", "x", "--backends", ""],
        ["compare", DRIVE, "--out", "x", "--backends", "ekf,ekf"],
        ["simulate", "oval"],
        ["simulate", "oval", "--out", "x", "--laps", "0"],
        ["simulate", "oval", "--out", "x", "--sensor", "radar"],
        ["config", "check"],
    ],
    ids=" ".join,
)
def test_wrong_usage_ends_with_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Usage: conegraph" in captured.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nowhere", "--out", "{}/o"], "nowhere: no such file or folder"),
        (["run", "sim:ovall", "--out", "{}/o"], "sim:ovall: neither a track file"),
        (
            ["run", DRIVE, "--out", "{}/o", "--set", "backend.gate_chi=9"],
            "backend.gate_chi: no such key; did you mean association.gate_d2?",
        ),
        (
            ["run", DRIVE, "--out", "{}/o", "--set", "backend.polish=true"],
            "backend.polish belongs to isam2, not to ekf",
        ),
        (
            ["run", DRIVE, "--out", "{}/o", "--backend", "icp"],
            "back end 'icp' does not exist; choose from ekf, isam2",
        ),
        (
            ["compare", DRIVE, "--out", "{}/o", "--backends", "ekf/fast"],
            "backend.profile: Input should be 'default' or 'thesis' (got 'fast')",
        ),
        (["run", DRIVE, "--out", "{}/o", "-c", "{}/c.toml"], "{}/c.toml: no such file"),
        (["run", DRIVE, "--out", "{}/o", "--map", "{}/m.csv"], "{}/m.csv"),
        (["run", DRIVE, "--out", "{}/file/o"], "{}/file/o: Not a directory"),
        (["simulate", "oval", "--out", "{}/file/o"], "{}/file/o: Not a directory"),
        (["config", "check", "{}/c.toml"], "{}/c.toml: no such file"),
        (["view", "{}"], "{}/run.rrd: no such recording; run again with --save-rrd"),
    ],
    ids=lambda given: " ".join(given) if isinstance(given, list) else "",
)
def test_a_known_error_is_one_line_and_ends_with_1(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "file").touch()
    assert run(*(a.format(tmp_path) for a in arguments)) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"conegraph: {message.format(tmp_path)}")
    assert captured.err.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_python_m_conegraph_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "conegraph", "run", "nowhere", "--out", "x"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr == "conegraph: nowhere: no such file or folder\n"


def test_simulate_writes_a_cone_log_with_truth(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {"cones.csv", "map.csv", "odometry.csv", "truth.csv"}
    assert {file.name for file in log.iterdir()} == files
    assert run("simulate", "oval", "--laps", 1, "--seed", 5, "--out", tmp_path) == 0
    assert "oval" in capsys.readouterr().out
    for name in files:
        assert (tmp_path / name).read_bytes() == (log / name).read_bytes()
    assert run("simulate", "oval", "--laps", 1, "--out", tmp_path) == 1
    assert "holds a cone log already" in capsys.readouterr().err
    bare = tmp_path / "bare"
    assert run("simulate", "oval", "--laps", 1, "--no-odometry", "--out", bare) == 0
    assert not (bare / "odometry.csv").exists()


def test_compare_writes_a_run_a_back_end_and_the_report(compared: Path) -> None:
    reports = {"report.json", "report.md", "report.html"}
    names = {"ekf", "isam2", "ekf-thesis"}
    assert {path.name for path in compared.iterdir()} == reports | names
    for name in names:
        assert {path.name for path in (compared / name).iterdir()} >= RUN_FILES
    assert (compared / "isam2" / "trajectory_smoothed.tum").is_file()
    assert not (compared / "ekf" / "trajectory_smoothed.tum").exists()
    profile = tomllib.loads((compared / "ekf-thesis" / "config.toml").read_text())
    assert profile["backend"]["profile"] == "thesis"
    report = json.loads((compared / "report.json").read_text(encoding="utf-8"))
    assert report["runs"].keys() == names
    for name in ("ekf", "isam2"):
        assert report["runs"][name]["map"]["recall"] >= 0.98
        assert report["runs"][name]["map"]["rmse_aligned_m"] < 0.1


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_a_run_repeats_from_its_own_config(
    compared: Path, tmp_path: Path, name: str
) -> None:
    first = compared / name
    assert run("run", "-c", first / "config.toml", "--out", tmp_path / "again") == 0
    for file in ("trajectory.tum", "map.csv", "associations.csv", "config.toml"):
        assert (tmp_path / "again" / file).read_bytes() == (first / file).read_bytes()


def test_run_prints_a_table_or_its_summary(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("run", log, "--out", tmp_path / "a") == 0
    table = capsys.readouterr()
    assert "RMSE, aligned [m]" in table.out
    assert table.err == ""
    assert run("run", log, "--out", tmp_path / "b", "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary == json.loads((tmp_path / "b" / "summary.json").read_text())
    assert summary["backend"] == "ekf"
    assert len(summary["laps"]) == 1


def test_compare_prints_the_verdict_or_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ("--set", "source=sim:oval?laps=1&odometry=off", "--backends", "ekf")
    out = tmp_path / "a"
    assert run("compare", "--out", out, *settings) == 0
    printed = capsys.readouterr().out
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert " ".join(report["verdict"].split()) in " ".join(printed.split())
    assert run("compare", "--out", out, *settings, "--json") == 0
    assert json.loads(capsys.readouterr().out)["runs"].keys() == {"ekf"}


def test_a_known_map_is_kept_or_extended(compared: Path, tmp_path: Path) -> None:
    lines = (compared / "ekf" / "map.csv").read_text(encoding="utf-8").splitlines()
    half = tmp_path / "half.csv"
    half.write_text("\n".join(lines[: len(lines) // 2]) + "\n", encoding="utf-8")
    config = compared / "ekf" / "config.toml"
    sizes = {}
    for mode in ("localize", "update"):
        out = tmp_path / mode
        arguments = ("-c", config, "--map", half, "--mode", mode, "--out", out)
        assert run("run", *arguments) == 0
        sizes[mode] = len((out / "map.csv").read_text().splitlines())
    assert sizes["localize"] == len(lines) // 2
    assert sizes["update"] == len(lines)


def test_poses_before_the_car_was_found_on_its_map_are_no_errors(
    log: Path, compared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The drive begins after 6 s, 45 m from the line, which it passes once.
    late = tmp_path / "late"
    late.mkdir()
    for name in ("cones.csv", "odometry.csv", "truth.csv"):
        head, *rows = (log / name).read_text(encoding="utf-8").splitlines()
        rest = [row for row in rows if float(row.split(",")[0]) >= 6.0]
        (late / name).write_text("\n".join([head, *rest]), encoding="utf-8")
    known = compared / "ekf" / "map.csv"
    assert run("run", late, "--map", known, "--out", tmp_path / "out") == 0
    assert "frames passed until the car was found on the map" in capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    path = summary["metrics"]["trajectory"]
    assert path["poses"] < summary["frames"]
    assert path["ate_se2"]["max_m"] < 0.3
    assert path["ate_as_written"]["max_m"] < 0.5
    assert summary["laps"] == []


def test_nothing_is_looked_for_on_an_empty_map(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_text("x,y,class\n", encoding="utf-8")
    assert run("run", log, "--map", empty, "--out", tmp_path / "out") == 1
    said = f"conegraph: {empty}: has no cone, so no car can be found on it\n"
    assert capsys.readouterr().err == said
    assert not (tmp_path / "out").exists()


def test_a_run_does_not_overwrite_the_log_that_it_reads(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = (log / "map.csv").read_bytes()
    assert run("run", log, "--out", log) == 1
    assert "is the source itself" in capsys.readouterr().err
    assert (log / "map.csv").read_bytes() == truth


def test_a_recording_is_written_when_asked_for_and_never_left_stale(
    log: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "run.rrd"
    assert run("run", log, "--out", tmp_path, "--save-rrd") == 0
    assert recording.stat().st_size > 10_000
    assert run("run", log, "--out", tmp_path) == 0
    assert not recording.exists()


@pytest.mark.parametrize("command", ["run", "compare"])
def test_that_a_finished_run_is_replaced_is_said(
    command: str, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = () if command == "run" else ("--backends", "ekf")
    folder = tmp_path if command == "run" else tmp_path / "ekf"
    again = (command, log, "--out", tmp_path, *chosen)
    assert run(*again) == 0
    assert capsys.readouterr().err == ""
    poses = (folder / "trajectory.tum").read_bytes()
    (folder / "map.csv").write_text("mine", encoding="utf-8")
    assert run(*again) == 0
    said = f"conegraph: {folder}: replacing the results of an earlier run\n"
    assert capsys.readouterr().err == said
    assert (folder / "trajectory.tum").read_bytes() == poses
    assert (folder / "map.csv").read_text(encoding="utf-8") != "mine"
    (folder / "summary.json").unlink()
    assert run(*again) == 0
    assert capsys.readouterr().err == ""


def test_a_detector_without_pictures_is_said_not_to_be_used(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("run", log, "--out", tmp_path / "a", "--detector", "hsv") == 0
    said = f"conegraph: --detector hsv is not used: {log} has cones, and no pictures"
    assert capsys.readouterr().err.splitlines() == [said]
    config = tmp_path / "a" / "config.toml"
    assert 'kind = "hsv"' in config.read_text(encoding="utf-8")
    assert run("run", "-c", config, "--out", tmp_path / "b") == 0
    assert capsys.readouterr().err == ""


def test_config_schema_describes_every_section(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run("config", "schema") == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"backend", "association", "seed"} <= schema["properties"].keys()


def test_config_check_accepts_or_names_the_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my.toml"
    file.write_text('[backend]\nkind = "isam2"\n', encoding="utf-8")
    assert run("config", "check", file) == 0
    assert capsys.readouterr().out == f"{file}: ok (isam2, profile default)\n"
    assert run("config", "check", file, "--resolved") == 0
    assert tomllib.loads(capsys.readouterr().out)["backend"]["polish"] is True
    file.write_text("[asociation]\ngate_d2 = 9\n", encoding="utf-8")
    assert run("config", "check", file) == 1
    assert capsys.readouterr().err == (
        f"conegraph: {file}: asociation.gate_d2: no such key; "
        "did you mean association.gate_d2?\n"
    )


def test_tune_writes_a_config_that_runs_and_says_what_changed(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tuned.toml"
    wrong = ("--set", "sensor.scale=0.5", "--frames", 60, "--sensor", "scale")
    assert run("tune", log, "--out", out, *wrong, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    scale = found["changes"][0]
    assert (scale["name"], scale["before"]) == ("sensor.scale", 0.5)
    # 60 frames of five cones: 1 / sqrt(2 * 600) is 3 %; four of them, and 2 % more.
    assert scale["after"] == pytest.approx(1.0, rel=0.14)
    assert found["before"]["nis_per_dof"] > 1.5 > found["after"]["nis_per_dof"]
    tuned = tomllib.loads(out.read_text(encoding="utf-8"))
    assert tuned["sensor"] == {"scale": scale["after"]}
    assert tuned["motion"].keys() == {"odometry_scale"}
    assert run("run", "-c", out, "--out", tmp_path / "run", "--json") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["consistency"]["overconfident_frames"] == 0
    assert "overconfident" not in said.err
