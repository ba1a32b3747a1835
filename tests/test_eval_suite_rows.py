"""Results of a suite are read back as they were written, by name and by type."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from conegraph.errors import FileFormatError
from conegraph.eval.series import MAX_SAMPLES, PlacedMap, RunSeries
from conegraph.eval.suite_metrics import BY_NAME, METRICS, why_failed
from conegraph.eval.suite_rows import RESULTS, SuiteRow, read_results, write_results
from conegraph.eval.suite_series import read_series, write_series
from conegraph.io.plain import Plain

FINE = {
    **{metric.name: 0.5 for metric in METRICS},
    "pose_max_m": 1.0,
    "precision": 0.95,
    "laps_true": 2.0,
    "laps_counted": 2.0,
}


def row(**given: object) -> SuiteRow:
    fields: dict[str, object] = {
        "suite": "quick",
        "track": "oval",
        "sensor": "lidar",
        "odometry": True,
        "faults": "",
        "seed": 3,
        "laps": 2,
        "backend": "ekf",
        "profile": "default",
        "settings": "",
        "stream": "sim:oval?laps=2&seed=3",
        "command": "conegraph compare 'sim:oval?laps=2&seed=3' --out replay",
        "config_hash": "ab12",
        "code_version": "0.1.0",
        "status": "ok",
        "reason": "",
        "metrics": FINE,
    }
    return SuiteRow.model_validate({**fields, **given})


def test_rows_come_back_sorted_and_the_same_rows_make_the_same_bytes(
    tmp_path: Path,
) -> None:
    one = row()
    other = row(backend="isam2", profile="thesis", metrics={**FINE, "nis": math.nan})
    crashed = row(seed=4, stream="sim:b", status="failed", reason="boom", metrics={})
    for name, rows in (("a", [crashed, other, one]), ("b", [one, crashed, other])):
        (tmp_path / name).mkdir()
        write_results(tmp_path / name / RESULTS, rows)
    back = read_results(tmp_path / "a")
    assert [r.key for r in back] == sorted(r.key for r in (one, other, crashed))
    by_key = {r.key: r for r in back}
    assert by_key[one.key] == one
    assert by_key[other.key].contender == "isam2/thesis"
    assert math.isnan(by_key[other.key].metrics["nis"])
    assert by_key[crashed.key].failed
    assert math.isnan(by_key[crashed.key].metrics["precision"])
    first, second = (tmp_path / name / RESULTS for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_metrics_failure_and_series_are_columns(tmp_path: Path) -> None:
    path = tmp_path / RESULTS
    write_results(path, [row()])
    (cells,) = parquet.read_table(path).to_pylist()
    assert cells["map_rmse_aligned_m"] == 0.5
    assert cells["failed"] is False
    assert cells["series"] == row().series
    assert set(BY_NAME) < set(cells)


def test_a_file_of_another_kind_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="no such file"):
        read_results(tmp_path)
    bad = tmp_path / RESULTS
    bad.write_text("no parquet", encoding="utf-8")
    with pytest.raises(FileFormatError, match="no results of a suite"):
        read_results(bad)


@pytest.mark.parametrize(
    ("worse", "reason"),
    [
        ({}, ""),
        ({"pose_max_m": 2.5}, "diverged: 2.5 m off"),
        ({"pose_max_m": math.nan}, "diverged: nan m off"),
        ({"precision": 0.85}, "map precision 0.850"),
        ({"laps_counted": 1.0}, "1 of 2 laps missed"),
        ({"laps_true": math.nan}, ""),
    ],
)
def test_when_a_run_counts_as_failed(worse: dict[str, float], reason: str) -> None:
    assert why_failed({**FINE, **worse}) == reason


def test_a_metric_is_found_by_its_path() -> None:
    metric = BY_NAME["rpe_10m_m"]
    plain: Plain = {"trajectory": {"rpe": [{"rmse_m": 1.0}, {"rmse_m": 2.0}]}}
    assert metric.of(plain) == 2.0
    assert math.isnan(metric.of({"trajectory": {"rpe": []}}))
    assert math.isnan(metric.of({"trajectory": None}))


def test_series_come_back_to_float32(tmp_path: Path) -> None:
    n, rng = 1000, np.random.default_rng(0)
    t = np.arange(n) / 10
    along = RunSeries(t, t, t, t, t, np.geomspace(1, 9, 4), np.arange(3), t[:2])
    placed = PlacedMap(rng.normal(size=(5, 2)), np.arange(5), rng.normal(size=(n, 2)))
    path = tmp_path / "series" / "a.npz"
    write_series(path, along, placed)
    again, map_again = read_series(path)
    np.testing.assert_allclose(again.stamp_s, t, rtol=1e-6)
    assert again.frame_ms_counts.tolist() == [0, 1, 2]
    assert map_again.cone_class.tolist() == [0, 1, 2, 3, 4]
    assert map_again.true_xy_m is None
    assert len(map_again.path_m) == MAX_SAMPLES
    np.testing.assert_allclose(map_again.path_m[[0, -1]], placed.path_m[[0, -1]], 1e-6)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(FileFormatError, match="no series"):
        read_series(path)
    write_series(path, replace(along, nees=np.zeros(3_000_000)), placed)
    with pytest.raises(FileFormatError, match="inflates"):
        read_series(path)
