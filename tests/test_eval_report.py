"""Comparing runs, and what the report says about them."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from conegraph.errors import ConegraphError
from conegraph.eval import RunMetrics, Truth, compare, evaluate
from conegraph.eval.report import render_table, write_report
from conegraph.io.run_folder import AssociationRows, RunFolder, StatusRows
from conegraph.types import Array, ConeMap, Trajectory, TruthMap

N = 40


def truth_and_run() -> tuple[Truth, RunFolder]:
    """A drive around an ellipse of 40 cones, without any error."""
    a = np.linspace(0.0, 2 * np.pi, N, endpoint=False)
    xy = np.stack([40 * np.cos(a) + 5 * np.cos(3 * a), 25 * np.sin(a)], axis=-1)
    classes = np.arange(N) % 4
    path = Trajectory(np.arange(N) / 10.0, np.column_stack([0.9 * xy, a]))
    prob = np.full((N, 5), 0.1)
    prob[np.arange(N), classes] = 0.6
    cov = np.tile(0.01 * np.eye(2), (N, 1, 1))
    none = np.zeros(0)
    ints = np.zeros(0, dtype=np.int64)
    run = RunFolder(
        folder=Path("run"),
        trajectory=path,
        smoothed=None,
        cone_map=ConeMap(np.arange(N), xy, cov, prob, np.full(N, 5)),
        associations=AssociationRows(none, ints, np.array([], np.str_), ints, none),
        timing_ms={"frame": np.full(N, 1.5)},
        status=StatusRows(
            path.stamp_s, np.full(N, "OK"), ("",) * N, np.zeros(N, dtype=np.int64)
        ),
        summary={"laps": 1},
    )
    return Truth(path, TruthMap(np.arange(N), xy, classes)), run


def off_by(run: RunFolder, map_m: float, path_m: float) -> RunFolder:
    """Move every other cone and pose one way and the rest the other way."""
    sign = np.where(np.arange(N) % 2 == 0, 1.0, -1.0)[:, None]
    xy = run.cone_map.xy_m + sign * [[map_m, 0.0]]
    pose = run.trajectory.pose + sign * [[path_m, 0.0, 0.0]]
    return replace(
        run,
        cone_map=replace(run.cone_map, xy_m=xy),
        trajectory=Trajectory(run.trajectory.stamp_s, pose),
    )


def without(run: RunFolder, keep: NDArray[np.bool_]) -> RunFolder:
    m = run.cone_map
    rows = np.flatnonzero(keep)
    return replace(
        run,
        cone_map=ConeMap(
            m.id[rows],
            m.xy_m[rows],
            m.cov_m2[rows],
            m.class_prob[rows],
            m.observations[rows],
        ),
    )


def judged(truth: Truth, **runs: RunFolder) -> dict[str, RunMetrics]:
    return {name: evaluate(run, truth) for name, run in runs.items()}


def test_the_verdict_names_the_effect_first() -> None:
    truth, run = truth_and_run()
    metrics = judged(truth, ekf=off_by(run, 0.4, 0.2), isam2=off_by(run, 0.1, 0.201))
    assert compare(metrics).verdict == (
        "isam2's map is 75 % closer to the truth than ekf's (aligned RMSE: isam2 "
        "0.100 m, ekf 0.400 m). No difference shown in the path (aligned ATE while "
        "driving: ekf 0.200 m, isam2 0.201 m). Frames took (median, p99, longest): "
        "ekf 1.5, 1.5 and 1.5 ms; isam2 1.5, 1.5 and 1.5 ms. This is one run of each "
        "over one stream: it shows what happened here, not which is better in general."
    )


def test_a_third_run_that_is_behind_does_not_hide_that_two_are_level() -> None:
    truth, run = truth_and_run()
    metrics = judged(
        truth,
        ekf=off_by(run, 0.1, 0.1),
        isam2=off_by(run, 0.102, 0.1),
        thesis=off_by(run, 0.3, 0.1),
    )
    assert compare(metrics).verdict.startswith(
        "No difference shown in the map between ekf and isam2; thesis is farther from "
        "the truth (aligned RMSE: ekf 0.100 m, isam2 0.102 m, thesis 0.300 m)."
    )


def test_millimetres_are_no_difference() -> None:
    truth, run = truth_and_run()
    metrics = judged(truth, a=off_by(run, 0.001, 0.0), b=off_by(run, 0.004, 0.0))
    assert compare(metrics).verdict.startswith("No difference shown in the map")


def test_missing_cones_are_said_before_a_small_error() -> None:
    truth, run = truth_and_run()
    half = without(off_by(run, 0.01, 0.0), np.arange(N) < N // 2)
    verdict = compare(judged(truth, full=off_by(run, 0.1, 0.0), half=half)).verdict
    assert verdict.startswith(
        "half misses the most cones (recall: half 0.500, full 1.000). half's map is"
    )


def with_extra(run: RunFolder, xy_m: Array) -> RunFolder:
    """The run with more cones of its first one's looks."""
    m, n = run.cone_map, len(xy_m)
    return replace(
        run,
        cone_map=ConeMap(
            np.arange(len(m) + n),
            np.vstack([m.xy_m, xy_m]),
            np.concatenate([m.cov_m2, m.cov_m2[:1].repeat(n, axis=0)]),
            np.concatenate([m.class_prob, m.class_prob[:1].repeat(n, axis=0)]),
            np.concatenate([m.observations, m.observations[:1].repeat(n)]),
        ),
    )


def test_a_cone_twice_is_no_cone_that_is_not_there() -> None:
    truth, run = truth_and_run()
    n = 1 + N // 10
    twice = with_extra(run, run.cone_map.xy_m[:n] + 0.3)
    verdict = compare(judged(truth, once=run, twice=twice)).verdict
    assert verdict.startswith(
        f"twice has the most cones twice (duplicates: twice {n} of {N + n}, once 0 of "
        f"{N})."
    )
    assert "not there" not in verdict
    false = with_extra(run, np.tile([[900.0, 900.0]], (n, 1)) + 9.0 * np.eye(n, 2))
    verdict = compare(judged(truth, once=run, false=false)).verdict
    assert verdict.startswith(
        f"false has the most cones that are not there (false cones: false {n} of "
    )
    assert "twice" not in verdict


def test_a_run_without_a_map_is_named() -> None:
    truth, run = truth_and_run()
    empty = without(run, np.zeros(N, dtype=np.bool_))
    verdict = compare(judged(truth, good=run, bad=empty)).verdict
    assert verdict.startswith("bad made no map that fits the truth anywhere.")


def test_without_truth_only_time_is_compared() -> None:
    _, run = truth_and_run()
    comparison = compare(judged(Truth(), ekf=run, isam2=run))
    assert comparison.verdict == (
        "There is no truth to judge accuracy by. Frames took (median, p99, longest): "
        "ekf 1.5, 1.5 and 1.5 ms; isam2 1.5, 1.5 and 1.5 ms."
    )
    shown = {row.figure.label for row in comparison.rows}
    assert not shown & {"laps driven", "lap ends closed in time", "closure precision"}
    groups = {row.figure.group for row in comparison.rows}
    assert groups == {
        "Laps and loop closures",
        "Status",
        "Time per frame",
        "Cost",
    }


def test_where_nothing_is_best_nothing_is_said_of_it(tmp_path: Path) -> None:
    truth, run = truth_and_run()
    metrics = judged(truth, ekf=run)
    write_report(tmp_path, {"ekf": run}, metrics, truth)
    for name in ("report.html", "report.md"):
        assert "Bold: best" not in (tmp_path / name).read_text(encoding="utf-8")
    assert render_table(compare(metrics)).caption is None


def test_one_run_is_described_and_nothing_is_compared() -> None:
    truth, run = truth_and_run()
    comparison = compare(judged(truth, ekf=off_by(run, 0.1, 0.2)))
    assert comparison.verdict == (
        "ekf: the map is 0.100 m off (aligned RMSE, recall 1.000, precision 1.000) "
        "and the path is 0.200 m off (aligned ATE while driving). Frames took "
        "(median, p99, longest): ekf 1.5, 1.5 and 1.5 ms."
    )
    assert not any(row.best for row in comparison.rows)
    assert compare({}).verdict == "Nothing was run, so there is nothing to compare."


def test_the_longest_frame_is_said_with_where_the_graph_was_solved() -> None:
    _, run = truth_and_run()
    slow = {"frame": np.r_[np.full(99, 1.0), 700.0]}
    graph = replace(run, timing_ms=slow, summary={**run.summary, "mapping": "inline"})
    said = compare(judged(Truth(), isam2=graph)).verdict
    assert "isam2 1.0, 8.0 and 700.0 ms, mapping in line." in said


def test_what_the_verdict_calls_level_is_not_bold() -> None:
    truth, run = truth_and_run()
    three = compare(
        judged(
            truth,
            a=off_by(run, 0.100, 0.1),
            b=off_by(run, 0.108, 0.1),
            c=off_by(run, 0.300, 0.1),
        )
    )
    (row,) = (r for r in three.rows if r.figure.path == "map.rmse_aligned_m")
    assert row.best == {0, 1}
    two = compare(judged(truth, a=off_by(run, 0.100, 0.1), b=off_by(run, 0.108, 0.1)))
    assert "No difference shown in the map" in two.verdict
    assert not any(r.best for r in two.rows if r.figure.group == "Map")


def test_the_best_of_a_row_stands_out() -> None:
    truth, run = truth_and_run()
    comparison = compare(
        judged(truth, a=off_by(run, 0.2, 0.10001), b=off_by(run, 0.1, 0.10002))
    )
    rows = {(r.figure.group, r.figure.label): r for r in comparison.rows}
    map_row = rows["Map", "RMSE, aligned"]
    assert map_row.title == "RMSE, aligned [m]"
    assert map_row.cells == ("0.200", "0.100")
    assert map_row.best == {1}
    assert rows["Path while driving", "ATE, aligned"].best == frozenset()
    assert rows["Map", "nearest RMSE (lenient)"].best == frozenset()


def test_warnings_name_the_run_unless_they_concern_all() -> None:
    truth, run = truth_and_run()
    assert truth.cones is not None
    xy = truth.cones.xy_m.copy()
    xy[1] = xy[0]
    faulty = replace(truth, cones=replace(truth.cones, xy_m=xy))
    killed = replace(run, summary={})
    warnings = compare(judged(faulty, ekf=run, isam2=killed)).warnings
    assert len(warnings) == 2
    assert warnings[0].startswith("the truth is faulty: 1 of its pairs")
    assert warnings[1].startswith("isam2: the run did not finish")


def test_what_spoils_all_figures_is_said_first() -> None:
    truth, run = truth_and_run()
    frames = len(run.trajectory)
    lost = {"rejected": {"frame: stamp does not increase": 9 * frames}}
    spoilt = replace(run, summary={**run.summary, **lost})
    comparison = compare(judged(truth, ekf=run, isam2=spoilt))
    start = f"isam2: {9 * frames} of {10 * frames} frames were left out"
    assert comparison.alarms[0].startswith(start)
    assert comparison.verdict.startswith(start)
    assert compare(judged(truth, ekf=run)).alarms == ()


def test_the_table_has_a_column_a_run_and_units() -> None:
    truth, run = truth_and_run()
    metrics = judged(truth, ekf=off_by(run, 0.2, 0.1), isam2=off_by(run, 0.1, 0.1))
    console = Console(width=80, record=True, force_terminal=True)
    with console.capture() as captured:
        console.print(render_table(compare(metrics)))
    text = captured.get()
    assert re.search(r"RMSE, aligned \[m\].*0\.200.*\x1b\[1m0\.100\x1b\[0m", text)


class Links(HTMLParser):
    """Collects everything that a browser would fetch, and the drawings."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.drawings: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Look at one element."""
        given = dict(attrs)
        for name in ("src", "href", "xlink:href"):
            target = given.get(name)
            if target and not target.startswith("#"):
                self.fetched.append(target)
        if tag == "svg":
            self.drawings.append(str(given.get("aria-label")))


def report(folder: Path) -> tuple[str, str, str]:
    truth, run = truth_and_run()
    runs = {
        "ekf": without(off_by(run, 0.2, 0.1), np.arange(N) != 5),
        "isam2": off_by(run, 0.05, 0.1),
    }
    folder.mkdir()
    write_report(folder, runs, judged(truth, **runs), truth, title="Ellipse <1>")
    names = ("report.html", "report.json", "report.md")
    html, plain, markdown = ((folder / n).read_text(encoding="utf-8") for n in names)
    return html, plain, markdown


def test_the_report_is_the_same_for_the_same_runs(tmp_path: Path) -> None:
    assert report(tmp_path / "a") == report(tmp_path / "b")


def test_the_html_needs_no_network_and_shows_every_run(tmp_path: Path) -> None:
    html, _, _ = report(tmp_path / "r")
    page = Links()
    page.feed(html)
    assert page.fetched == []
    assert [d.split(".")[0] for d in page.drawings] == [
        "ekf",
        "isam2",
        "Error while driving",
        "Time per frame",
    ]
    assert all(d.endswith(".") for d in page.drawings)
    ids = re.findall(r'\bid="([^"]*)"', html)
    assert len(ids) == len(set(ids))
    used = re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', html)
    assert {a or b for a, b in used} <= set(ids)
    assert not re.search(r"url\((?!#)|@import|<script", html)
    assert '<g id="' not in html
    assert html.count("Errors 10 times enlarged") == 4
    assert "<h1>Ellipse &lt;1&gt;</h1>" in html
    assert html.index("ekf misses the most cones") < html.index("<svg")
    assert "isam2&#x27;s map is 75&nbsp;% closer" in html
    assert 'name="viewport"' in html


def test_the_json_has_every_figure_and_a_version(tmp_path: Path) -> None:
    _, plain, _ = report(tmp_path / "r")
    data = json.loads(plain)
    assert data["schema_version"] == 1
    assert list(data["runs"]) == ["ekf", "isam2"]
    assert data["runs"]["ekf"]["map"]["missed"] == 1
    assert data["runs"]["isam2"]["map"]["rmse_aligned_m"] == pytest.approx(0.05)
    assert data["runs"]["ekf"]["smoothed"] is None


def test_the_markdown_is_a_table_with_the_best_in_bold(tmp_path: Path) -> None:
    _, _, markdown = report(tmp_path / "r")
    lines = markdown.splitlines()
    assert lines[0] == "# Ellipse <1>"
    assert lines[2].startswith("ekf misses the most cones (recall: ekf 0.975, isam2 1")
    assert "| Map: RMSE, aligned [m] | 0.200 | **0.050** |" in lines
    table = [line for line in lines if line.startswith("|")]
    assert {line.count("|") for line in table} == {4}
    assert any(line.endswith("Bold: best.") for line in lines)
    assert "- [Error while driving](report.html#error-over-distance): " in markdown


def test_a_run_that_ran_away_does_not_shrink_the_picture(tmp_path: Path) -> None:
    truth, run = truth_and_run()
    xy = run.cone_map.xy_m.copy()
    xy[0] = [1e6, 1e6]
    pose = run.trajectory.pose.copy()
    pose[-1] = np.nan
    lost = replace(
        run,
        cone_map=replace(run.cone_map, xy_m=xy),
        trajectory=Trajectory(run.trajectory.stamp_s, pose),
    )
    write_report(tmp_path, {"ekf": lost}, judged(truth, ekf=lost), truth)
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "1 cone outside" in html
    assert len(html) < 300_000


def test_runs_without_truth_or_map_are_drawn_as_well(tmp_path: Path) -> None:
    _, run = truth_and_run()
    empty = without(run, np.zeros(N, dtype=np.bool_))
    runs = {"ekf": run, "isam2": empty}
    write_report(tmp_path, runs, judged(Truth(), **runs), Truth())
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("<svg") == 3


def test_what_replays_a_run_can_be_typed(tmp_path: Path) -> None:
    truth, run = truth_and_run()
    folder = tmp_path / "my runs" / "ekf"
    folder.mkdir(parents=True)
    kept = replace(run, folder=folder)
    write_report(tmp_path, {"ekf": kept}, judged(truth, ekf=kept), truth)
    lines = (tmp_path / "report.md").read_text(encoding="utf-8").splitlines()
    commands = [shlex.split(line) for line in lines if line.startswith("conegraph")]
    again = f"{folder}-again"
    repeat = ["conegraph", "run", "-c", "CONFIG", "--save-rrd", "--out", "AGAIN"]
    repeat[3], repeat[-1] = f"{folder}/config.toml", again
    assert commands == [
        ["conegraph", "doctor", f"{folder}"],
        repeat,
        ["conegraph", "view", again],
    ]


def test_a_folder_that_is_not_there_is_one_error(tmp_path: Path) -> None:
    truth, run = truth_and_run()
    with pytest.raises(ConegraphError, match=r"report\.json: cannot be written"):
        write_report(tmp_path / "none", {"ekf": run}, judged(truth, ekf=run), truth)


def test_the_page_fits_a_phone_and_a_desk(
    tmp_path: Path, look_at: Callable[[Path], list[Mapping[str, Any]]]
) -> None:
    report(tmp_path / "r")
    looks = look_at(tmp_path / "r" / "report.html")
    assert [look["window_px"] for look in looks] == [390, 1280]
    for look in looks:
        assert look["page_px"] <= look["window_px"]
        assert (look["pictures"], look["too_small"]) == (4, 0)
        assert look["fetched"] == look["console"] == look["clipped"] == []
        assert look["scrolling"] == 0


def test_the_browser_would_notice(
    tmp_path: Path, look_at: Callable[[Path], list[Mapping[str, Any]]]
) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        '<!DOCTYPE html><div style="width:2000px">wide</div><svg width="0"></svg>'
        '<img src="http://127.0.0.1:9/none.png"><script>console.error("broken")</script>'
        '<svg width="200" height="150"><text x="-9" y="50">cut off</text></svg>'
        '<div class="scroll" style="width:50px;overflow:auto">unbreakable-words</div>'
    )
    for look in look_at(page):
        assert look["page_px"] >= 2000
        assert look["too_small"] == 2
        assert look["clipped"] == ["cut off"]
        assert look["scrolling"] == 1
        assert [Path(name).name for name in look["fetched"]] == ["none.png"]
        assert any("broken" in line for line in look["console"])
