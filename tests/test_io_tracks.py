"""Track files of every format, and each file of the real collections."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from conegraph.errors import FileFormatError
from conegraph.io.tracks import read_track
from conegraph.io.tracks.cone_map_csv import read_cone_map
from conegraph.types import ConeClass, TrackLayout

BLUE, YELLOW, ORANGE, BIG_ORANGE, UNKNOWN = ConeClass

PACSIM = """track:
  version: 1.0
  lanesFirstWithLastConnected: false
  start:
    position: [-2.0, 0.5, 0.0]
    orientation: [0.1, 0.2, 1.5e0]
  left:
  - position: [1e1, 2.0, 0.0]
    class: blue
  - position: [.nan, 2.0, 0.0]
    class: blue
  - class: blue
  - position: [5, 2.0, 0.0]
    class: small-orange
  right:
  - position: [10.0, -2.0, 0.0]
    class: yellow
  - position: [10.0, -2.0, 0.0]
    class: yellow
  time_keeping:
  - position: [0.0, 4.0, 0.0]
    class: timekeeping
  unknown:
  - position: [1.0, 9.0, 0.0]
    class: unknown
  - position: [1.0, 8.0, 0.0]
    class: big-orange
  - position: [1.0, 8.0, 0.0]
    class: traffic-light
"""
FSSIM = """cones_left:
- - 0.0
  - 10.0
- - 1e1
  - 0.0
- - 0.0
  - 10.0
cones_right: [[0.0, -10.0]]
cones_orange: []
cones_orange_big: [[4.7, 2.2, 0.0]]
starting_pose_cg: [1.0, 2.0, 0.5]
tk_device: [[6.0, 3.0], [6.0, -3.0]]
"""
EUFS = """tag,x,y,direction,x_variance,y_variance,xy_covariance
blue,0,10,0,0.01,0.01,0
tag,x,y,direction,x_variance,y_variance,xy_covariance
orange_large,1,2,0,0,0,0
inactive_noise,3,4,0,0,0,0
car_start,0.5,-1,1.57,0,0,0
yellow,0,-10,0,0.01,0.01,0
yellow,0,,0,0.01,0.01,0
yellow,0,-10,0,0.01,0.01,0
gnome,0,0,0,0,0,0
"""
EPFL = "cone_type,X,Y,Z,std_X,std_Y,std_Z,right,left\nblue,1.5,0,0,0,0,0,0,1\n"
MAP = "id,x,y,class\n7,1,2,small_orange\n8,1,2,small_orange\n9,x,2,blue\n"


def track(tmp_path: Path, name: str, text: str) -> TrackLayout:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_track(path)


def test_pacsim(tmp_path: Path) -> None:
    read = track(tmp_path, "a.yaml", PACSIM)
    assert read.name == "a"
    assert read.xy_m.tolist() == [[10, 2], [5, 2], [10, -2], [1, 9], [1, 8]]
    assert read.cone_class.tolist() == [BLUE, ORANGE, YELLOW, UNKNOWN, BIG_ORANGE]
    assert read.start_pose is not None
    assert read.start_pose.tolist() == [-2.0, 0.5, 1.5]
    assert not read.closed
    assert read.in_driving_order
    assert read.dropped == {
        "malformed row": 2,
        "exact duplicate": 1,
        "not a cone: timekeeping": 1,
        "unknown class name": 1,
    }


def test_fssim(tmp_path: Path) -> None:
    read = track(tmp_path, "a.yaml", FSSIM)
    assert read.xy_m.tolist() == [[0, 10], [10, 0], [0, -10], [4.7, 2.2]]
    assert read.cone_class.tolist() == [BLUE, BLUE, YELLOW, BIG_ORANGE]
    assert read.start_pose is not None
    assert read.start_pose.tolist() == [1.0, 2.0, 0.5]
    assert read.closed
    assert read.dropped == {"exact duplicate": 1, "not a cone: tk_device": 2}


def test_eufs(tmp_path: Path) -> None:
    read = track(tmp_path, "a.csv", EUFS)
    assert read.xy_m.tolist() == [[0, 10], [1, 2], [0, -10]]
    assert read.cone_class.tolist() == [BLUE, BIG_ORANGE, YELLOW]
    assert read.start_pose is not None
    assert read.start_pose.tolist() == [0.5, -1.0, 1.57]
    assert read.dropped == {
        "repeated header": 1,
        "not a cone: inactive_noise": 1,
        "malformed row": 1,
        "exact duplicate": 1,
        "unknown class name": 1,
    }


def test_epfl_with_the_line_beside_it(tmp_path: Path) -> None:
    line = tmp_path / "a_center_line.csv"
    line.write_text("# x,y,right_width,left_width\n0,0,1,1\n0,4,1,1\n,5,1,1\n")
    read = track(tmp_path, "a_cones.csv", EPFL)
    assert read.centerline_m is not None
    assert read.centerline_m.tolist() == [[0, 0], [0, 4]]
    assert read.dropped == {"malformed centre line row": 1}
    line.write_text("x,y\n0,0\n0,4\n4,4\n")
    open_line = track(tmp_path, "a_cones.csv", EPFL)
    assert open_line.closed
    line.write_text("x,y\n0,0\n0,4\n0,8\n0,12\n")
    assert not track(tmp_path, "a_cones.csv", EPFL).closed
    assert track(tmp_path, "b_cones.csv", EPFL).centerline_m is None


@pytest.mark.parametrize(
    "text",
    [
        "blue,1,2,0.0,0.01,0.01,0.0\nyellow,3,4,0,0,0,0\nbig_orange,5,6,0,0,0,0\n",
        "blue 1 2\nyellow 3 4\nbig_orange 5 6\n",
        "blue,1,2\n yellow , 3, 4\nbig_orange,5,6\n",
    ],
)
def test_fsds(tmp_path: Path, text: str) -> None:
    read = track(tmp_path, "a.csv", text)
    assert read.xy_m.tolist() == [[1, 2], [3, 4], [5, 6]]
    assert read.cone_class.tolist() == [BLUE, YELLOW, BIG_ORANGE]
    assert read.start_pose is not None
    assert read.start_pose.tolist() == [0.0, 0.0, 0.0]
    assert read.dropped == {}


def test_map_csv_as_a_track(tmp_path: Path) -> None:
    read = track(tmp_path, "map.csv", MAP)
    assert read.xy_m.tolist() == [[1, 2]]
    assert read.cone_class.tolist() == [ORANGE]
    assert read.dropped == {"exact duplicate": 1, "malformed row": 1}
    assert not read.closed


def test_map_csv_as_a_map(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("x,y,class\n1,2,blue\n3,4,unknown\n", encoding="utf-8")
    read = read_cone_map(path)
    assert read.id.tolist() == [0, 1]
    assert read.cov_m2 == pytest.approx(np.broadcast_to(0.0025 * np.eye(2), (2, 2, 2)))
    assert read.class_prob[0, BLUE] == 0.9
    assert read.class_prob[1] == pytest.approx(np.full(5, 0.2))
    assert read.observations.tolist() == [1, 1]
    path.write_text(
        "id,x,y,class,p_blue,p_yellow,p_orange,p_big_orange,p_unknown,"
        "cov_xx,cov_xy,cov_yy,observations\n"
        "5,1,2,blue,0.5,0.5,0,0,0,0.04,0.01,0.09,12\n",
        encoding="utf-8",
    )
    read = read_cone_map(path)
    assert (read.id.tolist(), read.observations.tolist()) == ([5], [12])
    assert read.class_prob.tolist() == [[0.5, 0.5, 0.0, 0.0, 0.0]]
    assert read.cov_m2.tolist() == [[[0.04, 0.01], [0.01, 0.09]]]


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("1,1,x,blue,1,0,1", "x or y"),
        ("1,1,2,pink,1,0,1", "unknown class name"),
        ("1,1,2,blue,1,2,1", "covariance"),
        ("0,1,2,blue,1,0,1", "id occurs twice"),
        ("1.5,1,2,blue,1,0,1", "id is not a whole number"),
        ("-1,1,2,blue,1,0,1", "id is not a whole number"),
        ("1e30,1,2,blue,1,0,1", "id is not a whole number"),
    ],
)
def test_a_map_must_be_whole(tmp_path: Path, row: str, said: str) -> None:
    path = tmp_path / "map.csv"
    header = "id,x,y,class,cov_xx,cov_xy,cov_yy\n0,0,0,blue,1,0,1\n"
    path.write_text(f"{header}{row}\n", encoding="utf-8")
    with pytest.raises(FileFormatError, match=said) as caught:
        read_cone_map(path)
    assert caught.value.line == 3


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.yaml", "", "is empty"),
        ("a.yaml", "gripMap: []\n", "known format"),
        ("a.yaml", "track: 5\n", "holds no mapping"),
        ("a.yaml", "track:\n  left: []\n", "no cone"),
        ("a.yaml", "track: {left: 1, left: 2}\n", "'left' occurs twice"),
        ("a.yaml", "track: &t\n  left: *t\n", "aliases are refused"),
        ("a.yaml", "track: [\n", "not YAML"),
        ("a.yaml", "[" * 3000, "recursion"),
        ("a.yaml", "a" * (3 * 2**20), "larger than 2 MiB"),
        ("a.csv", "u,v\n1,2\n", "known format"),
        ("a.csv", "tag,x,y\ngnome,1,2\n", "no cone"),
        ("a.csv", "[" * 3000, "known format"),
    ],
)
def test_unusable_tracks(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(FileFormatError, match=said):
        track(tmp_path, name, text)


# Blue, yellow, orange, big orange and unknown cones as grep counts them, less the
# duplicates that are listed; then whether the track is a loop.
COLLECTIONS: dict[str, dict[str, tuple[tuple[int, ...], bool, Mapping[str, int]]]] = {
    "tracks_pacsim": {
        "FSCZ24.yaml": ((88, 87, 0, 0, 0), True, {"not a cone: timekeeping": 2}),
        "FSE22.yaml": ((62, 57, 0, 0, 0), True, {"not a cone: timekeeping": 2}),
        "FSE22_test.yaml": ((55, 44, 0, 0, 0), True, {"not a cone: timekeeping": 2}),
        "FSG19.yaml": ((82, 73, 0, 0, 0), True, {"not a cone: timekeeping": 2}),
        "FSG21.yaml": ((74, 60, 0, 0, 0), True, {"not a cone: timekeeping": 2}),
        "FSO20.yaml": ((123, 123, 0, 4, 0), True, {"not a cone: timekeeping": 2}),
        "FSS22_V1.yaml": ((57, 66, 0, 0, 0), True, {"not a cone: timekeeping": 2}),
        "FSS22_V2.yaml": ((46, 54, 0, 0, 16), True, {"not a cone: timekeeping": 2}),
        "acceleration.yaml": (
            (14, 14, 31, 8, 0),
            False,
            {"not a cone: timekeeping": 4, "not a cone: invisible": 6},
        ),
    },
    "tracks_amz_fssim": {
        "FSG.yaml": (
            (94, 88, 0, 4, 0),
            True,
            {"exact duplicate": 2, "not a cone: tk_device": 2},
        ),
        "acceleration.yaml": (
            (14, 14, 41, 8, 0),
            False,
            {"exact duplicate": 1, "not a cone: tk_device": 4},
        ),
        "skidpad.yaml": (
            (29, 29, 11, 4, 0),
            True,
            {"exact duplicate": 1, "not a cone: tk_device": 2},
        ),
        "thin.yaml": (
            (47, 42, 0, 4, 0),
            True,
            {"exact duplicate": 1, "not a cone: tk_device": 2},
        ),
    },
    "tracks_eufs_qut": {
        "B_shape_02_03_2023.csv": ((40, 33, 0, 4, 0), True, {}),
        "FSDS_Training.csv": ((96, 96, 0, 4, 0), True, {}),
        "SmallCircle.csv": ((15, 26, 0, 4, 0), True, {}),
        "acceleration.csv": ((14, 14, 12, 6, 0), False, {}),
        "peanut.csv": ((54, 64, 0, 4, 0), True, {}),
        "skidpad.csv": (
            (29, 29, 20, 4, 0),
            True,
            {"exact duplicate": 2, "not a cone: midpoint": 30},
        ),
        "small_track.csv": ((35, 38, 0, 4, 0), True, {}),
        "small_track_2.csv": ((34, 39, 0, 4, 0), True, {}),
        "track_created.csv": ((77, 77, 0, 0, 0), True, {"repeated header": 1}),
    },
    "tracks_epfl_track_database": {
        "VSV_cones.csv": ((23, 23, 0, 0, 0), False, {}),
        "acceleration_4m_cones.csv": ((18, 18, 52, 8, 0), False, {}),
        "acceleration_cones.csv": ((14, 14, 42, 8, 0), False, {}),
        "ebs_test_fss_cones.csv": ((13, 13, 42, 8, 0), False, {"exact duplicate": 2}),
        "fsds_competition_1_cones.csv": ((85, 85, 0, 4, 0), True, {}),
        "fsds_competition_2_cones.csv": ((115, 115, 0, 4, 0), True, {}),
        "fsds_default_cones.csv": ((96, 96, 0, 4, 0), True, {}),
        "track_1_cones.csv": ((102, 96, 0, 4, 0), True, {}),
        "track_2_cones.csv": ((117, 111, 0, 4, 0), True, {}),
    },
}
FILES = [(folder, name) for folder, files in COLLECTIONS.items() for name in files]


@pytest.mark.parametrize(("folder", "name"), FILES)
def test_real_tracks(data_dir: Path, folder: str, name: str) -> None:
    counts, closed, dropped = COLLECTIONS[folder][name]
    read = read_track(data_dir / folder / name)
    assert tuple(np.bincount(read.cone_class, minlength=5).tolist()) == counts
    assert read.closed == closed
    assert read.dropped == dropped
    assert read.in_driving_order == (folder == "tracks_pacsim")
    assert len(np.unique(read.xy_m, axis=0)) == len(read)
    has_start = folder in ("tracks_pacsim", "tracks_amz_fssim")
    has_start |= folder == "tracks_eufs_qut" and name != "track_created.csv"
    assert (read.start_pose is not None) == has_start
    assert (read.centerline_m is not None) == (folder == "tracks_epfl_track_database")


@pytest.mark.parametrize("folder", COLLECTIONS)
def test_every_real_file_is_known_here(data_dir: Path, folder: str) -> None:
    """None of the collections' tracks goes untested."""
    found = {p.name for p in (data_dir / folder).iterdir() if p.suffix != ".md"}
    others = {n for n in found if n.endswith("_center_line.csv")}
    assert found - others - {"LICENSE", "config"} == set(COLLECTIONS[folder])


def test_the_same_course_in_two_formats(data_dir: Path) -> None:
    """FSDS's training map was kept by two teams: turned and moved, but the same."""
    eufs = read_track(data_dir / "tracks_eufs_qut" / "FSDS_Training.csv")
    epfl = read_track(data_dir / "tracks_epfl_track_database/fsds_default_cones.csv")

    def spread(layout: TrackLayout) -> list[float]:
        blue = layout.xy_m[layout.cone_class == BLUE]
        values: list[float] = np.linalg.svd(blue - blue.mean(axis=0))[1].tolist()
        return values

    assert spread(eufs) == pytest.approx(spread(epfl), rel=1e-3)
