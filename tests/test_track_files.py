"""What ``conegraph track`` writes, as a reader of the files sees it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from conegraph.bench.track_truth import known_track
from conegraph.cli import main
from conegraph.io.run_writer import format_map
from conegraph.sim.track_shapes import built_in_track

OVAL = known_track(built_in_track("oval", 0))


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("track")
    (folder / "map.csv").write_text(format_map(OVAL.cone_map()), encoding="utf-8")
    out = folder / "out"
    assert (
        run("track", str(folder / "map.csv"), "--out", str(out), "--pose", "0,0,0") == 0
    )
    return out


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_boundaries_list_every_cone_in_driving_order(written: Path) -> None:
    found = table(written / "boundaries.csv")
    for side, true in (("left", OVAL.left), ("right", OVAL.right)):
        chain = [int(row["id"]) for row in found if row["side"] == side]
        turn = true.tolist().index(chain[0])
        assert chain == np.roll(true, -turn).tolist()
        places = [int(row["index"]) for row in found if row["side"] == side]
        assert places == list(range(len(chain)))
    row = found[0]
    assert [float(row["x"]), float(row["y"])] == OVAL.xy_m[int(row["id"])].tolist()


def test_the_centre_line_has_the_header_and_columns_of_the_race_track_tools(
    written: Path,
) -> None:
    text = (written / "centerline.csv").read_text(encoding="utf-8")
    assert text.startswith("# x_m,y_m,w_tr_right_m,w_tr_left_m\n")
    line = np.loadtxt(written / "centerline.csv", delimiter=",")
    assert line[:, 2:] == pytest.approx(1.75, abs=0.08)
    assert np.hypot(*line[0, :2]) < 3.0


def test_triangles_shapes_and_summary_fit_together(written: Path) -> None:
    triangles = table(written / "triangles.csv")
    assert len(triangles) == len(OVAL.xy_m)
    shapes = json.loads((written / "track.geojson").read_text(encoding="utf-8"))
    kinds = [f["properties"]["kind"] for f in shapes["features"]]
    assert kinds == ["road", "left", "right", "centerline"]
    assert len(shapes["features"][0]["geometry"]["coordinates"]) == 2
    summary = json.loads((written / "track.json").read_text(encoding="utf-8"))
    assert summary["closed"] is True
    assert summary["length_m"] == pytest.approx(100 + 30 * np.pi, rel=0.01)
    assert summary["unused"] == []
    assert summary["confidence"] > 0.9
    assert (written / "track.png").read_bytes().startswith(b"\x89PNG")


def test_an_event_is_written_with_its_map_and_path(tmp_path: Path) -> None:
    assert run("track", "skidpad", "--out", str(tmp_path)) == 0
    assert len(table(tmp_path / "map.csv")) == 86
    path = table(tmp_path / "path.csv")
    facts = json.loads((tmp_path / "event.json").read_text(encoding="utf-8"))
    assert float(path[-1]["s"]) == facts["stop_s_m"]
    assert facts["segments"] == ["right", "right timed", "left", "left timed"]


def test_an_event_is_printed_as_json_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("track", "acceleration", "--out", str(tmp_path), "--json") == 0
    written = (tmp_path / "event.json").read_text(encoding="utf-8")
    assert json.loads(capsys.readouterr().out) == json.loads(written)


def test_a_map_without_a_lane_is_no_track(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = tmp_path / "one.csv"
    one.write_text("x,y,class\n1,2,blue\n", encoding="utf-8")
    out = str(tmp_path / "out")
    assert run("track", str(one), "--out", out, "--plot", "none") == 0
    assert "no track is known: no lane between cones" in capsys.readouterr().out


def test_a_wrong_pose_is_a_usage_error(tmp_path: Path) -> None:
    assert run("track", "skidpad", "--out", str(tmp_path), "--pose", "1,2") == 2


def test_the_benchmark_prints_its_targets(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("bench", "track", "--courses", "1", "--seeds", "1") == 0
    text = capsys.readouterr().out
    assert "hard cases right or unsure" in text
    assert "≥ 0.94" in text
