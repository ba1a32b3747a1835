"""The line to drive: on courses whose middle is known, and on every real file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.errors import SourceError
from conegraph.geometry import compose, to_parent
from conegraph.io.tracks import read_track
from conegraph.sim.driving_line import SPACING_M, closes, driving_line, start_line_at
from conegraph.sim.polyline import nearest, project
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Array, ConeClass, TrackLayout

BLUE, YELLOW = int(ConeClass.BLUE), int(ConeClass.YELLOW)

CLOSED_FILES = (
    *("FSCZ24", "FSE22", "FSE22_test", "FSG19", "FSG21", "FSO20", "FSS22_V1"),
    *("FSS22_V2", "FSG", "thin", "B_shape_02_03_2023", "FSDS_Training"),
    *("SmallCircle", "peanut", "small_track", "small_track_2"),
    *("fsds_competition_1_cones", "fsds_competition_2_cones", "fsds_default_cones"),
    *("track_1_cones", "track_2_cones"),
)
STRAIGHT_FILES = (
    "tracks_pacsim/acceleration.yaml",
    "tracks_amz_fssim/acceleration.yaml",
    "tracks_eufs_qut/acceleration.csv",
    "tracks_epfl_track_database/acceleration_cones.csv",
    "tracks_epfl_track_database/acceleration_4m_cones.csv",
    "tracks_epfl_track_database/ebs_test_fss_cones.csv",
)


def bare(layout: TrackLayout, seed: int = 0) -> TrackLayout:
    """Return nothing but cones in no order."""
    order = np.random.default_rng(seed).permutation(len(layout))
    return TrackLayout(
        layout.name,
        layout.xy_m[order],
        layout.cone_class[order],
        closed=layout.closed,
    )


def real(data_dir: Path, stem: str) -> TrackLayout:
    (path,) = (p for p in data_dir.glob("tracks_*/*") if p.stem == stem)
    return read_track(path)


def farthest(points: Array, line: Array) -> float:
    return float(nearest(points, line)[0].max())


def clearance(layout: TrackLayout, line: Array) -> float:
    cones = layout.xy_m[layout.cone_class != ConeClass.UNKNOWN]
    return float(nearest(cones, line)[0].min())


def right_side(layout: TrackLayout, line: Array) -> float:
    """Return the share of near blue and yellow cones on their side of the line."""
    lane = np.isin(layout.cone_class, (BLUE, YELLOW))
    _, across = project(layout.xy_m[lane], line, closes(line))
    near = np.abs(across) < 4.0
    wanted = np.where(layout.cone_class[lane] == BLUE, 1, -1)
    return float((np.sign(across) == wanted)[near].mean())


@pytest.mark.parametrize("stem", CLOSED_FILES)
@pytest.mark.parametrize("own_line", [True, False])
def test_real_closed_courses(data_dir: Path, stem: str, own_line: bool) -> None:
    layout = real(data_dir, stem)
    if not own_line:
        layout = replace(layout, centerline_m=None, in_driving_order=False)
    line = driving_line(layout)
    assert closes(line)
    assert clearance(layout, line) > 0.9
    assert right_side(layout, line) == 1.0
    if layout.start_pose is not None:
        start, yaw = layout.start_pose[:2], layout.start_pose[2]
        assert np.hypot(*(line[0] - start)) < 1.0
        assert (line[4] - line[0]) @ (np.cos(yaw), np.sin(yaw)) > 0


@pytest.mark.parametrize("stem", ["track_1_cones", "fsds_competition_2_cones"])
def test_the_contour_agrees_with_a_surveyed_centre_line(
    data_dir: Path, stem: str
) -> None:
    layout = real(data_dir, stem)
    assert layout.centerline_m is not None
    found = driving_line(bare(layout))
    assert farthest(layout.centerline_m, found) < 0.7
    assert farthest(found, driving_line(layout)) < 0.7


@pytest.mark.parametrize("path", STRAIGHT_FILES)
@pytest.mark.parametrize("own_line", [True, False])
def test_real_straights_run_into_the_braking_zone(
    data_dir: Path, path: str, own_line: bool
) -> None:
    layout = read_track(data_dir / path)
    if not own_line:
        layout = replace(layout, centerline_m=None)
    line = driving_line(layout)
    assert not closes(line)
    assert clearance(layout, line) > 0.9
    blue = layout.xy_m[layout.cone_class == BLUE]
    timed = np.hypot(*(blue[-1] - blue[0]))
    length = (len(line) - 1) * SPACING_M
    assert length > timed + 20.0
    assert np.hypot(*(line[-1] - line[0])) == pytest.approx(length, rel=1e-3)


@pytest.mark.parametrize(
    "path", ["tracks_amz_fssim/skidpad.yaml", "tracks_eufs_qut/skidpad.csv"]
)
def test_real_skidpads_are_driven_by_script(data_dir: Path, path: str) -> None:
    layout = read_track(data_dir / path)
    line = driving_line(layout)
    assert not closes(line)
    assert clearance(layout, line) > 1.2
    assert layout.start_pose is not None
    np.testing.assert_allclose(line[0], layout.start_pose[:2], atol=0.2)
    # Two circles twice of half the distance between their centres, and the straights.
    assert len(line) * SPACING_M > 4 * 2 * np.pi * 9.0 + 25.0


def test_a_lane_narrower_than_a_car_is_still_followed(data_dir: Path) -> None:
    layout = real(data_dir, "track_created")
    line = driving_line(layout)
    assert closes(line)
    assert right_side(layout, line) > 0.97


def test_a_course_that_does_not_come_back_is_open(data_dir: Path) -> None:
    layout = real(data_dir, "VSV_cones")
    for line in (driving_line(layout), driving_line(bare(layout))):
        assert not closes(line)
        assert clearance(layout, line) > 1.2
        assert right_side(layout, line) == 1.0


@pytest.mark.parametrize("seed", range(12))
def test_bare_cones_of_a_random_course_give_its_centre_line(seed: int) -> None:
    layout = built_in_track("random", seed)
    assert layout.centerline_m is not None
    line = driving_line(bare(layout, seed))
    assert closes(line)
    assert farthest(layout.centerline_m, line) < 0.9
    assert farthest(line, layout.centerline_m) < 0.9
    assert right_side(layout, line) == 1.0
    gate = layout.xy_m[layout.cone_class == ConeClass.BIG_ORANGE]
    assert np.hypot(*(line[0] - gate.mean(axis=0))) < 0.4
    assert start_line_at(layout, line) < 0.4


@settings(max_examples=10, deadline=None)
@given(
    st.floats(-200, 200),
    st.floats(-200, 200),
    st.floats(-3, 3),
    st.sampled_from(["oval", "acceleration", "skidpad"]),
)
def test_moving_the_track_moves_the_line(
    x: float, y: float, yaw: float, name: str
) -> None:
    there = np.array([x, y, yaw])
    layout = built_in_track(name, 0)
    assert layout.start_pose is not None
    moved = replace(
        layout,
        xy_m=to_parent(there, layout.xy_m),
        start_pose=compose(there, layout.start_pose),
        centerline_m=None,
    )
    line = driving_line(moved)
    expected = to_parent(there, driving_line(replace(layout, centerline_m=None)))
    assert farthest(line, expected) < 0.3
    np.testing.assert_allclose(line[0], expected[0], atol=0.3)


def test_a_start_pose_that_looks_back_turns_the_line_around() -> None:
    layout = built_in_track("oval", 0)
    ahead = driving_line(layout)
    back = driving_line(replace(layout, start_pose=np.array([0.0, 0.0, np.pi])))
    assert ahead[8, 0] > 1.9
    assert back[8, 0] < -1.9
    assert farthest(back, ahead) < 0.15


def test_a_start_pose_behind_an_open_lane_leads_into_it() -> None:
    layout = built_in_track("acceleration", 0)
    start = np.array([-8.0, 0.0, 0.0])
    line = driving_line(replace(layout, start_pose=start, centerline_m=None))
    np.testing.assert_allclose(line[0], start[:2], atol=1e-6)
    np.testing.assert_allclose(line[:, 1], 0.0, atol=1e-6)


def test_missing_cones_do_not_break_a_lane() -> None:
    layout = built_in_track("autocross", 0)
    assert layout.centerline_m is not None
    kept = np.random.default_rng(3).random(len(layout)) > 0.05
    thinned = TrackLayout("thin", layout.xy_m[kept], layout.cone_class[kept])
    line = driving_line(thinned)
    assert closes(line)
    assert farthest(line, layout.centerline_m) < 1.5


def test_the_start_line_of_a_built_in_course_is_six_metres_ahead() -> None:
    layout = built_in_track("autocross", 0)
    assert start_line_at(layout, driving_line(layout)) == pytest.approx(6.0, abs=0.3)


@pytest.mark.parametrize(
    ("count", "classes"), [(0, (BLUE,)), (1, (BLUE, YELLOW)), (30, (BLUE,))]
)
def test_without_two_sides_there_is_no_lane(
    count: int, classes: tuple[int, ...]
) -> None:
    xy = np.random.default_rng(0).uniform(-20, 20, (count, 2))
    kinds = np.resize(np.array(classes, dtype=np.int64), count)
    with pytest.raises(SourceError, match="track odd: no lane between its"):
        driving_line(TrackLayout("odd", xy, kinds))


def test_a_field_of_mixed_cones_is_no_lane() -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(-40, 40, (200, 2))
    layout = TrackLayout("field", xy, rng.integers(0, 2, 200))
    with pytest.raises(SourceError, match="track field: no single lane"):
        driving_line(layout)


def test_a_file_with_too_many_cones_is_refused() -> None:
    xy = np.random.default_rng(1).uniform(-400, 400, (3001, 2))
    with pytest.raises(SourceError, match="3001 cones, more than 3000"):
        driving_line(TrackLayout("vast", xy, np.arange(3001) % 2))
