"""Whatever is in a file, nothing but a ConegraphError may come out of a reader."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conegraph.errors import ConegraphError
from conegraph.io.cone_log import read_cone_log
from conegraph.io.mrclam import read_mrclam
from conegraph.io.tracks import read_track
from conegraph.io.tracks.cone_map_csv import read_cone_map
from conegraph.io.tum_trajectory import read_tum
from conegraph.io.victoria_park import read_victoria_park

ODOMETRY = "ODOMETRY 0 1 0.2 0.1 0.02 0.0001 0 0 4e-06 0 4e-06\n"
PACSIM = (
    "track:\n  lanesFirstWithLastConnected: true\n"
    "  start: {position: [0, 0, 0], orientation: [0, 0, 0]}\n"
    "  left:\n  - position: [1.0, 2.0, 0.0]\n    class: blue\n"
)
FULL_MAP = (
    "id,x,y,class,p_blue,p_yellow,p_orange,p_big_orange,p_unknown,"
    "cov_xx,cov_xy,cov_yy,observations\n5,1,2,blue,0.5,0.5,0,0,0,0.04,0.01,0.09,12\n"
)


def read_robot(path: Path) -> object:
    return read_mrclam(path.parent, "Robot1")


def read_folder(path: Path) -> object:
    return read_cone_log(path.parent)


def read_epfl(path: Path) -> object:
    return read_track(path.with_name("a_cones.csv"))


# The file that is spoiled, its readers, its text, and sound files beside it.
Case = tuple[str, Callable[[Path], object], str, dict[str, str]]
MRCLAM = {
    "Barcodes.dat": "1 5\n6 63\n",
    "Landmark_Groundtruth.dat": "6 1.0 2.0 0 0\n",
    "Robot1_Odometry.dat": "10.0 0.5 0.2\n10.1 0.5 0.2\n",
    "Robot1_Groundtruth.dat": "9.0 1 2 0.5\n11.0 2 2 3.5\n",
    "Robot1_Measurement.dat": "10.05 63 2.0 0.5\n10.05 5 2.0 0.5\n",
}
CASES: list[Case] = [
    (
        "cones.csv",
        read_folder,
        "t,x,y,class,true_id,cov_xx,cov_xy,cov_yy\n1,2,3,blue,4,0.1,0,0.1\n2\n",
        {},
    ),
    (
        "cones.csv",
        read_folder,
        "t,x,y,p_blue,p_yellow,p_orange,p_big_orange,p_unknown\n1,2,3,1,0,0,0,0\n",
        {},
    ),
    (
        "odometry.csv",
        read_folder,
        "t,u,r,cov_uu,cov_ur,cov_rr\n1,2,3,0.1,0,0.1\n2,2,3,0.1,0,0.1\n",
        {"cones.csv": "t,x,y\n1,2,3\n"},
    ),
    (
        "truth.csv",
        read_folder,
        "t,x,y,yaw\n1,2,3,4\n",
        {"cones.csv": "t,x,y\n1,2,3\n"},
    ),
    (
        "map.csv",
        read_folder,
        "id,x,y,class\n1,2,3,blue\n2,2,4,yellow\n",
        {"cones.csv": "t,x,y\n1,2,3\n"},
    ),
    ("a.tum", read_tum, "1 2 3 0 0 0 0 1\n2 3 4 0 0 0 1 0\n", {}),
    ("a.txt", read_victoria_park, ODOMETRY + "LANDMARK 1 2 8 6 0.4 0 0.4\n", {}),
    ("a.yaml", read_track, PACSIM, {}),
    ("b.yaml", read_track, "cones_left:\n- [1, 2]\ncones_right: [[3, 4]]\n", {}),
    ("a.csv", read_track, "tag,x,y,direction\nblue,1,2,0\ncar_start,0,0,1\n", {}),
    ("b.csv", read_track, "blue,1,2,0\nyellow 3 4\n", {}),
    ("a_cones.csv", read_track, "cone_type,X,Y\nblue,1,2\nyellow,1,3\n", {}),
    (
        "a_center_line.csv",
        read_epfl,
        "# x,y,right_width,left_width\n0,0,1,1\n1,1,1,1\n",
        {"a_cones.csv": "cone_type,X,Y\nblue,1,2\n"},
    ),
    ("map.csv", read_track, FULL_MAP, {}),
    ("map.csv", read_cone_map, FULL_MAP, {}),
    *[(name, read_robot, text, MRCLAM) for name, text in MRCLAM.items()],
]

IDS = [f"{i}-{case[0]}" for i, case in enumerate(CASES)]

CELLS = [b"", b"nan", b"-inf", b"1e308", b"1e-320", b"-1", b"0", b"\xff", b"\0", b'"']
edit = st.tuples(
    st.floats(0, 1),
    st.integers(0, 3),
    st.binary(max_size=4) | st.sampled_from(CELLS) | st.sampled_from([b",", b"\n"]),
)


def spoil(data: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    """Replace some bytes, each at a share of the length, by others."""
    for share, length, new in edits:
        at = int(share * len(data))
        data = data[:at] + new + data[at + length :]
    return data


def read_all(read: Callable[[Path], object], path: Path) -> None:
    with suppress(ConegraphError):
        read(path)


@pytest.mark.parametrize("case", CASES, ids=IDS)
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(edits=st.lists(edit, min_size=1, max_size=6))
def test_spoiled_files(
    tmp_path: Path, case: Case, edits: list[tuple[float, int, bytes]]
) -> None:
    name, read, text, beside = case
    for other, content in beside.items():
        (tmp_path / other).write_text(content, encoding="utf-8")
    path = tmp_path / name
    path.write_bytes(spoil(text.encode(), edits))
    read_all(read, path)


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.binary(max_size=200), packed=st.booleans())
def test_arbitrary_bytes(tmp_path: Path, data: bytes, packed: bool) -> None:
    for read in (read_track, read_cone_map, read_tum, read_victoria_park):
        path = tmp_path / ("a.yaml.gz" if packed else "a.yaml")
        path.write_bytes(gzip.compress(data)[: len(data) // 2 + 15] if packed else data)
        read_all(read, path)


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_unspoiled_files_are_read(tmp_path: Path, case: Case) -> None:
    name, read, text, beside = case
    for other, content in {**beside, name: text}.items():
        (tmp_path / other).write_text(content, encoding="utf-8")
    assert read(tmp_path / name) is not None
