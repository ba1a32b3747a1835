"""The report of a benchmark says what its rows say, and fits every screen."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conegraph.errors import FileFormatError
from conegraph.eval.series import FRAME_MS_EDGES, PlacedMap, RunSeries
from conegraph.eval.suite_metrics import METRICS
from conegraph.eval.suite_report import write_suite_report
from conegraph.eval.suite_rows import RESULTS, SuiteRow, write_results
from conegraph.eval.suite_series import write_series

ANGLE = np.linspace(0.0, 2 * np.pi, 30, endpoint=False)
TRUTH = np.stack([40 * np.cos(ANGLE), 25 * np.sin(ANGLE)], axis=-1)
CLASSES = np.arange(30) % 2
TRACKS, SEEDS = ("oval", "random:1"), 4

Written = tuple[str, str, dict[str, Any]]
"""The page, the Markdown and the JSON."""


def row(contender: str, track: str, seed: int, **given: object) -> SuiteRow:
    """A run whose figures are 1 but for those given."""
    backend, _, profile = contender.partition("/")
    reason = str(given.pop("reason", ""))
    stream = f"sim:{track}?seed={seed}"
    metrics = {metric.name: 1.0 for metric in METRICS}
    return SuiteRow(
        suite="quick",
        track=track,
        sensor="lidar",
        odometry=True,
        faults="",
        seed=seed,
        laps=2,
        backend=backend,
        profile=profile or "default",
        settings="",
        stream=stream,
        command=f"conegraph compare '{stream}' --backends {contender} --out out/{seed}",
        config_hash="0",
        code_version="0.1.0",
        status="ok",
        reason=reason,
        metrics={**metrics, **{k: float(str(v)) for k, v in given.items()}},
    )


def series(error_m: float) -> tuple[RunSeries, PlacedMap]:
    """A run whose path is off by one distance and whose map by another, everywhere."""
    n = 50
    counts = np.zeros(len(FRAME_MS_EDGES) - 1, dtype=np.int64)
    counts[25:30] = 7
    along = RunSeries(
        stamp_s=np.linspace(0.0, 24.5, n),
        distance_m=np.linspace(0.0, 245.0, n),
        position_error_m=np.full(n, error_m),
        heading_error_rad=np.zeros(n),
        nees=np.full(n, 3.0),
        frame_ms_edges=FRAME_MS_EDGES,
        frame_ms_counts=counts,
        lap_p99_ms=np.array([5.0, 6.0]),
    )
    # One cone up, the next down: no rotation or shift would fit better.
    off = np.where(CLASSES == 0, error_m, -error_m)[:, None] * [[0.0, 1.0]]
    return along, PlacedMap(TRUTH + off, CLASSES, TRUTH, TRUTH, CLASSES, TRUTH)


def benchmark(folder: Path, contenders: tuple[str, ...] = ("ekf", "isam2")) -> Path:
    """Drives whose map errors are known: isam2's are always four fifths of ekf's."""
    rows = []
    for k, contender in enumerate(contenders):
        for t, track in enumerate(TRACKS):
            for seed in range(SEEDS):
                error_m = 0.1 * (1 + seed + 0.1 * t) * 0.8**k
                lost = k == 0 and t == 1 and seed == 3
                rows.append(
                    row(
                        contender,
                        track,
                        seed,
                        map_rmse_aligned_m=error_m,
                        pose_max_m=7.0 if lost else 1.0,
                        reason="diverged: 7.0 m off" if lost else "",
                    )
                )
                write_series(folder / rows[-1].series, *series(error_m))
    write_results(folder / RESULTS, rows)
    return folder


def written(folder: Path) -> Written:
    page = write_suite_report(folder)
    assert page == folder / "report.html"
    markdown = (folder / "report.md").read_text(encoding="utf-8")
    plain = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return page.read_text(encoding="utf-8"), markdown, plain


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return written(benchmark(tmp_path_factory.mktemp("both")))


def test_the_verdict_comes_first_and_has_effects(both: Written) -> None:
    html, markdown, plain = both
    verdict = markdown.splitlines()[2]
    assert verdict == plain["findings"][0]
    # Seven pairs, all of one ratio: so is every resample. By chance alone all are on
    # one side in one of 64 cases, and there are four figures to look at.
    assert verdict == (
        "isam2 beside ekf over 8 drives: no difference shown in failures; 7 drives "
        "cannot show a difference in map error, path error, cones found and slowest "
        "frames (it takes 8)."
    )
    assert "Failed runs: ekf 1 of 8 (2 to 47 %), isam2 0 of 8 (0 to 32 %)." in markdown
    assert html.index("no difference shown") < html.index("<svg") < html.index("<table")
    assert (
        "Longest frame of any run: ekf: 1 ms; isam2, mapping in line: 1 ms." in markdown
    )
    assert plain["schema_version"] == 1


def test_tables_have_medians_of_sound_runs_and_failures(both: Written) -> None:
    _, markdown, _ = both
    lines = markdown.splitlines()
    (cells,) = (line for line in lines if line.startswith("| Map: map RMSE, aligned"))
    # ekf: .1 .2 .3 .4 and .11 .21 .31; isam2: four fifths of these and of .41.
    assert re.search(r"\| 0\.2100 \[.*\| 0\.2040 \[", cells)
    assert any(
        re.match(r"\| ekf \| 8 \| 1 \| 12\.5 % .* diverged 1 \|", x) for x in lines
    )
    (random,) = (line for line in lines if line.startswith("| random:1: lidar"))
    assert ", 1 of 4 failed |" in random


def test_the_median_and_the_worst_map_of_each_are_drawn(both: Written) -> None:
    html, _, _ = both
    titles = re.findall(r"<figcaption><strong>(.*?)</strong><span>(.*?)</span>", html)
    maps = {t.replace("&nbsp;", " "): s for t, s in titles if " off" in t}
    assert list(maps) == [
        "ekf, median run: 0.210 m off",
        "isam2, median run: 0.168 m off",
        "ekf, worst run: 0.410 m off",
        "isam2, worst run: 0.328 m off",
    ]
    assert maps["ekf, worst run: 0.410 m off"].startswith(
        "random:1, lidar, wheels and gyro, seed 3. Failed: diverged: 7.0&nbsp;m off. "
    )
    assert (
        "0 missed, 0 not there, 0 duplicates" in maps["isam2, worst run: 0.328 m off"]
    )


def test_the_worst_runs_come_with_what_replays_them(both: Written) -> None:
    _, markdown, _ = both
    worst = markdown[markdown.index("## Worst runs") :].splitlines()
    commands = [line for line in worst if line.startswith("conegraph")]
    assert commands[0] == (
        "conegraph compare 'sim:random:1?seed=3' --backends ekf --out out/3 --save-rrd"
    )
    assert commands[-2:] == [
        "conegraph view out/3",
        "conegraph doctor out/3/ekf",
    ]
    assert len(commands) == 12


def test_an_effect_that_is_shown_has_its_size(tmp_path: Path) -> None:
    rows = [
        row(name, f"random:{track}", seed, map_rmse_aligned_m=error_m * (1 + track))
        for name, error_m in (("ekf", 0.1), ("isam2", 0.08), ("ekf/thesis", 0.3))
        for track in range(9)
        for seed in range(2)
    ]
    write_results(tmp_path / RESULTS, rows)
    html, markdown, plain = written(tmp_path)
    assert markdown.splitlines()[2].startswith(
        "isam2 beside ekf over 18 drives: map error 20 % lower (20 to 20 %); "
    )
    assert plain["findings"][1] == "This holds for tracks like these."
    assert "map error 3.0 times as large (3.0 to 3.0)" in plain["findings"][4]
    assert "| isam2 is better |" in markdown
    assert "<h2" in html
    assert "Maps over the truth" not in html
    assert plain["warnings"] == ["54 runs left no series: drawings are without them"]


def test_default_profiles_come_first(tmp_path: Path) -> None:
    folder = benchmark(tmp_path, ("ekf/thesis", "ekf", "isam2"))
    _, markdown, plain = written(folder)
    assert [c["name"] for c in plain["contenders"]] == ["ekf", "isam2", "ekf/thesis"]
    assert markdown.splitlines()[2].startswith("isam2 beside ekf over 8 drives: ")


def test_one_back_end_alone_is_not_compared(tmp_path: Path) -> None:
    html, markdown, _ = written(benchmark(tmp_path, ("ekf",)))
    assert markdown.splitlines()[2].startswith("ekf ran alone")
    assert "Who is better" not in html


def test_back_ends_that_fail_everywhere_are_compared_by_that(tmp_path: Path) -> None:
    rows = [
        row(name, f"random:{track}", 0, reason=reason, map_rmse_aligned_m="nan")
        for name, reason in (("ekf", ""), ("isam2", "ValueError: broke off"))
        for track in range(8)
    ]
    write_results(tmp_path / RESULTS, rows)
    _, markdown, _ = written(tmp_path)
    assert markdown.splitlines()[2] == (
        "isam2 beside ekf over 8 drives: more failures (8 against 0); no drive that "
        "neither failed on."
    )
    assert re.search(r"\| isam2 \| 8 \| 8 \| 100\.0 % .* ValueError 8 \|", markdown)
    assert "| isam2 | - | 1.00 | ValueError: broke off |" in markdown


def test_a_faulty_truth_is_said(tmp_path: Path) -> None:
    folder = benchmark(tmp_path)
    along, _ = series(0.1)
    truth = np.concatenate([TRUTH, TRUTH[:1] + 0.1])
    classes = np.append(CLASSES, 0)
    faulty = PlacedMap(TRUTH, CLASSES, TRUTH, truth, classes, TRUTH)
    write_series(folder / row("ekf", "oval", 0).series, along, faulty)
    _, markdown, plain = written(folder)
    assert len(plain["warnings"]) == 1
    assert plain["warnings"][0].startswith(
        "the truth of oval is faulty: 1 of its pairs"
    )
    assert f"> {plain['warnings'][0]}" in markdown


def test_runs_without_series_are_said_and_the_rest_is_drawn(tmp_path: Path) -> None:
    folder = benchmark(tmp_path)
    (folder / row("ekf", "oval", 1).series).unlink()
    (folder / row("ekf", "oval", 2).series).write_bytes(b"torn")
    _, _, plain = written(folder)
    assert plain["warnings"] == ["2 runs left no series: drawings are without them"]


def test_the_same_results_give_the_same_bytes(tmp_path: Path, both: Written) -> None:
    assert written(benchmark(tmp_path)) == both


def test_results_without_a_run_are_one_error(tmp_path: Path) -> None:
    write_results(tmp_path / RESULTS, [])
    with pytest.raises(FileFormatError, match="holds no run"):
        write_suite_report(tmp_path)


def test_the_page_fits_a_phone_and_a_desk(
    tmp_path: Path, look_at: Callable[[Path], list[Mapping[str, Any]]]
) -> None:
    folder = benchmark(tmp_path / "bench", ("ekf", "isam2", "ekf/thesis"))
    looks = look_at(write_suite_report(folder))
    assert [look["window_px"] for look in looks] == [390, 1280]
    for look in looks:
        assert look["page_px"] <= look["window_px"]
        # Three duels, two maps each of three, and four drawings along the way.
        assert (look["pictures"], look["too_small"]) == (13, 0)
        assert look["fetched"] == look["console"] == look["clipped"] == []
        assert look["scrolling"] == 0


def test_the_html_is_sound_and_accessible(both: Written) -> None:
    html, _, _ = both
    ids = re.findall(r'\bid="([^"]*)"', html)
    assert len(ids) == len(set(ids))
    used = re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', html)
    assert {a or b for a, b in used} <= set(ids)
    assert html.count("<table ") == html.count("<caption>") > 3
    assert not re.search("<th(?! scope)[ >]", html)
    assert all(re.findall(r'<svg role="img" aria-label="([^"]+)"', html))
    assert html.count('<svg role="img"') == html.count("<svg")
