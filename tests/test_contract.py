"""The public interface that users script against: names, files, columns, keys."""

import json
import re
import shlex
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import conegraph
import conegraph.backends
import conegraph.eval
from conegraph import Pipeline, load_config
from conegraph.backends import make_backend
from conegraph.cli import main
from conegraph.config import resolve_config
from conegraph.config.explain import key_paths
from conegraph.eval import compare, evaluate
from conegraph.pipeline import RunResult

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

COLUMNS = {
    "map.csv": "id,x,y,class,p_blue,p_yellow,p_orange,p_big_orange,p_unknown,"
    "cov_xx,cov_xy,cov_yy,observations",
    "associations.csv": "t,observation,status,landmark,d2",
    "timing.csv": "t,stage,ms",
    "status.csv": "t,status,reason,reset_counter",
}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("contract")


@pytest.fixture(scope="module")
def result(out: Path) -> RunResult:
    config = load_config(overrides=["seed=3"], backend="isam2")
    return Pipeline(config, "sim:oval?laps=1").run(out)


@pytest.mark.parametrize("package", [conegraph, conegraph.backends, conegraph.eval])
def test_everything_that_is_exported_exists(package: ModuleType) -> None:
    assert [name for name in package.__all__ if not hasattr(package, name)] == []
    missing = "nothing"
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        getattr(package, missing)


def test_backends_are_made_from_their_section_alone() -> None:
    for kind in ("ekf", "isam2"):
        backend = make_backend(resolve_config({"backend": {"kind": kind}}).backend)
        assert len(backend.cone_map()) == 0


def test_the_config_keys_that_scripts_rely_on() -> None:
    relied_on = {"backend.kind", "backend.profile", "association.method", "seed"}
    assert relied_on <= key_paths().keys()
    assert load_config(overrides=["association.method=known"]).seed == 0


def test_a_run_writes_the_files_with_their_columns(
    out: Path, result: RunResult
) -> None:
    for name, columns in COLUMNS.items():
        assert (out / name).read_text(encoding="utf-8").split("\n")[0] == columns
    for name in ("trajectory.tum", "trajectory_smoothed.tum"):
        poses = np.loadtxt(out / name)
        assert poses.shape == (result.summary["frames"], 8)
        assert np.all(np.diff(poses[:, 0]) > 0)
        np.testing.assert_allclose(np.linalg.norm(poses[:, 4:], axis=1), 1, atol=1e-8)
    config = tomllib.loads((out / "config.toml").read_text(encoding="utf-8"))
    assert (config["backend"]["kind"], config["seed"]) == ("isam2", 3)


def test_the_summary_has_what_is_promised(out: Path, result: RunResult) -> None:
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    promised = {"frames", "laps", "loop_closures", "rejected", "latency_ms", "metrics"}
    assert {"schema_version", "peak_memory_mb"} | promised <= summary.keys()
    assert summary["latency_ms"]["frame"].keys() == {"p50", "p95", "p99", "max"}
    for closure in summary["loop_closures"]:
        assert closure.keys() == {"stamp_s", "distance_m", "accepted", "reason"}
    assert result.folder is not None
    metrics = evaluate(result.folder, result.truth)
    assert compare({"isam2": metrics}).names == ("isam2",)
    assert summary["metrics"] == metrics.to_dict()


def test_the_reasons_of_the_status_keep_to_one_cell(
    out: Path, result: RunResult
) -> None:
    rows = (out / "status.csv").read_text(encoding="utf-8").splitlines()
    assert {row.count(",") for row in rows} == {3}
    assert {row.split(",")[1] for row in rows[1:]} <= {"INIT", "OK", "DEGRADED", "LOST"}
    assert len(rows) == result.summary["frames"] + 1


def test_the_lock_and_the_readme_know_every_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "://" not in lock
    locked = set(re.findall(r"(?m)^([a-z0-9-]+)==", lock))
    needed = project["project"]["dependencies"]
    names = {re.split(r"[<>=;\s]", line)[0] for line in needed}
    tools = {
        re.split(r"[<>=]", line)[0] for line in project["dependency-groups"]["dev"]
    }
    assert names | tools <= locked
    explained = README.split("## Dependencies")[1].split("##")[0]
    assert {name for name in names if name not in explained} == set()


def blocks(language: str) -> list[str]:
    """Return the README's code blocks in a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_the_readme_shows_valid_configuration() -> None:
    (shown,) = blocks("toml")
    assert resolve_config(tomllib.loads(shown)).backend.kind == "isam2"


def test_the_readmes_python_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(blocks("toml")[0], encoding="utf-8")
    with pytest.raises(SystemExit, match="0"):
        main(["simulate", "oval", "--laps", "1", "--out", "log"])
    (shown,) = blocks("python")
    exec(compile(shown, "README.md", "exec"), {})
    assert (tmp_path / "out" / "api" / "map.csv").is_file()


def test_the_readmes_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    shown = re.findall(r"(?m)^(?:.*uv run )?conegraph (.+)$", "\n".join(blocks("sh")))
    assert len(shown) >= 6
    for line in shown:
        words = shlex.split(line, comments=True)
        with pytest.raises(SystemExit):
            main([words[0], "--help"])
        known = capsys.readouterr().out
        options = {word for word in words if word.startswith("-")}
        assert known.startswith(f"Usage: conegraph {words[0]}"), line
        assert {option for option in options if option not in known} == set(), line
