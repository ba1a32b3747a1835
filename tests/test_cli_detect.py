"""Pictures go in, a table and pictures come out; what is no picture is said."""

import csv
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from conegraph.cli import main
from conegraph.io.detections_csv import COLUMNS
from conegraph.io.picture_file import read_color

BLUE_BGR = (188, 92, 26)


def write_cone(path: Path) -> None:
    """Write a grey picture with one blue cone, 24 px wide and 36 high."""
    picture = np.full((240, 320, 3), 105, dtype=np.uint8)
    foot = [(119, 112), (123, 115), (100, 115), (104, 112)]
    cv2.fillPoly(picture, [np.array([(110, 80), (113, 80), *foot])], BLUE_BGR)
    cv2.imwrite(str(path), picture)


def detect(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["detect", *map(str, arguments)])
    code = ended.value.code
    return 0 if code is None else int(code)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_folder_of_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, table = tmp_path / "in", tmp_path / "out" / "found.csv"
    folder.mkdir()
    write_cone(folder / "b.png")
    cv2.imwrite(str(folder / "a.jpg"), np.full((50, 60, 3), 105, dtype=np.uint8))
    (folder / "c.png").write_bytes(b"no picture")
    (folder / "notes.txt").write_text("x", encoding="utf-8")
    assert detect(folder, "--detector", "hsv", "--out", table) == 0
    said = capsys.readouterr()
    assert ": 1 cone in 2 pictures, drawn in" in said.out
    assert "left out: " in said.err
    assert "c.png" in said.err
    (row,) = rows_of(table)
    assert tuple(row) == COLUMNS
    assert (row["picture"], row["class"], row["x"]) == ("b.png", "blue", "")
    edges = [float(row[name]) for name in ("left", "top", "right", "bottom")]
    assert edges == pytest.approx([99.5, 79.5, 123.5, 115.5], abs=1.0)
    drawn = read_color(tmp_path / "out" / "found_pictures" / "b.png.png")
    assert drawn.shape == (960, 1280, 3)
    assert (drawn[::4, ::4] != read_color(folder / "b.png")).any()


def test_pictures_of_one_name_are_drawn_apart(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_cone(tmp_path / name / "x.png")
    table, drawn = tmp_path / "t.csv", tmp_path / "drawn"
    images = [tmp_path / name / "x.png" for name in ("one", "two")]
    assert detect(*images, "--out", table, "--pictures", drawn) == 0
    assert len(list(drawn.iterdir())) == len(rows_of(table)) == 2


def test_a_rendered_drive_has_places_too(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    source = "sim:acceleration?sensor=rgbd&rate=1&laps=1&seed=1&light=bright"
    assert detect(source, "--out", table, "--every", "4", "--no-draw") == 0
    rows = rows_of(table)
    assert len(rows) > 4
    assert all(0.0 < float(row["x"]) < 25.0 for row in rows)
    assert all(float(row["cov_xx"]) > 0.0 for row in rows)
    assert not (tmp_path / "t_pictures").exists()


def huge_png(path: Path) -> None:
    head = struct.pack(">IIBBBBB", 20000, 20000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + head
    check = struct.pack(">I", zlib.crc32(b"IHDR" + head))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk + check)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("text.png", "is no picture"),
        ("huge.png", "claims 20000 x 20000 pixels"),
        ("cut.png", "is cut off"),
        ("gone.png", "no such file"),
        ("empty", "no pictures in this folder"),
    ],
)
def test_what_is_no_picture_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, said: str
) -> None:
    write_cone(tmp_path / "whole.png")
    (tmp_path / "text.png").write_text("hello", encoding="utf-8")
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:-40])
    (tmp_path / "empty").mkdir()
    huge_png(tmp_path / "huge.png")
    assert detect(tmp_path / name, "--out", tmp_path / "t.csv") == 1
    line = capsys.readouterr().err
    assert name in line
    assert said in line
    assert line.count("\n") == 1


def test_the_thesis_detector_can_be_chosen(tmp_path: Path) -> None:
    write_cone(tmp_path / "a.png")
    table = tmp_path / "t.csv"
    chosen = ("--detector", "hsv/thesis", "--out", table)
    assert detect(tmp_path / "a.png", *chosen) == 0
    assert [row["class"] for row in rows_of(table)] == ["blue"]
    assert detect(tmp_path / "a.png", "--detector", "eyes", "--out", table) == 1
