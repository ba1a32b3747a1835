"""The judge on tracks: the true one, and what is wrong with others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from conegraph.bench.track_truth import known_track
from conegraph.errors import FileFormatError
from conegraph.eval.track_metrics import TrackMetrics, track_metrics, true_track
from conegraph.eval.written_track import WrittenTrack, read_written_track
from conegraph.geometry import inverse, to_parent
from conegraph.io.cone_names import hard_class_prob
from conegraph.io.tracks import read_track
from conegraph.sim.track_shapes import built_in_track
from conegraph.track import Track, detect_track
from conegraph.track.files import write_track
from conegraph.types import Array, ConeClass, ConeMap, TruthMap

OVAL = known_track(built_in_track("oval", 0))
TRUTH = TruthMap(1000 + np.arange(len(OVAL.xy_m)), OVAL.xy_m, OVAL.cone_class)
START = OVAL.pose_at(0)
ZERO = np.zeros(3)


def judged(
    cone_map: ConeMap,
    track: Track | None = None,
    pose: Array = ZERO,
    truth: TruthMap = TRUTH,
) -> TrackMetrics:
    found = detect_track(cone_map, START) if track is None else track
    true = true_track(truth, START)
    assert true is not None
    return track_metrics(WrittenTrack.of(found), cone_map, truth, true, pose, 1.0)


def test_the_true_boundaries_are_those_beside_the_line_to_drive() -> None:
    true = true_track(TRUTH, START)
    assert true is not None
    for chain, side in ((true.left, OVAL.left), (true.right, OVAL.right)):
        coloured = TRUTH.id[side][OVAL.cone_class[side] <= ConeClass.YELLOW]
        assert set(coloured.tolist()) <= set(chain.tolist())
    assert true.closed


def test_the_true_track_has_no_error_wherever_the_runs_world_lies() -> None:
    pose = np.array([30.0, -12.0, 2.0])
    own = OVAL.cone_map()
    moved = replace(own, xy_m=to_parent(inverse(pose), own.xy_m), id=own.id[::-1])
    start = np.append(to_parent(inverse(pose), START[None, :2])[0], START[2] - pose[2])
    m = judged(moved, detect_track(moved, start), pose)
    assert m.found
    assert m.closed_right
    assert m.edges == len(true_chain())
    assert (m.edges_right, m.edges_found) == (1.0, 1.0)
    assert m.road_iou == pytest.approx(1.0, abs=1e-6)
    assert m.lateral_max_m == pytest.approx(0.0, abs=1e-4)


def true_chain() -> list[int]:
    true = true_track(TRUTH, START)
    assert true is not None
    return [*true.left.tolist(), *true.right.tolist()]


def test_a_wider_circle_has_the_overlap_and_the_offset_of_its_geometry() -> None:
    """Cones every 5 degrees at 18 and 22 m; the run has them 1 m farther out.

    Of the rings (18, 22) and (19, 23) the intersection is (19, 22), the union (18,
    23); polygons of 72 corners scale all areas alike.
    """
    angle = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    kinds = np.repeat([ConeClass.BLUE, ConeClass.YELLOW], 72).astype(np.int64)
    truth = TruthMap(np.arange(144), np.vstack([18 * around, 22 * around]), kinds)
    start = np.array([20.0, 0.0, np.pi / 2])

    def cones(xy_m: Array) -> ConeMap:
        cov = np.tile(0.01 * np.eye(2), (144, 1, 1))
        prob, seen = hard_class_prob(kinds), np.full(144, 9)
        return ConeMap(np.arange(144), xy_m, cov, prob, seen)

    true = true_track(truth, start)
    assert true is not None
    out = cones(np.vstack([19 * around, 23 * around]))
    found = WrittenTrack.of(detect_track(out, start))
    m = track_metrics(found, out, truth, true, ZERO, 1.1)
    assert m.edges == 144
    assert (m.edges_right, m.edges_found) == (1.0, 1.0)
    assert m.road_iou == pytest.approx((22**2 - 19**2) / (23**2 - 18**2), abs=1e-3)
    assert m.lateral_rmse_m == pytest.approx(1.0, abs=0.01)
    assert m.lateral_max_m == pytest.approx(1.0, abs=0.03)


def without(cone_map: ConeMap, cone_id: int) -> ConeMap:
    return cone_map.subset(cone_map.id != cone_id)


def test_a_cone_that_the_map_lacks_is_no_neighbour() -> None:
    whole = OVAL.cone_map()
    blue = int(OVAL.left[np.flatnonzero(OVAL.cone_class[OVAL.left] == 0)[5]])
    m = judged(without(whole, blue))
    assert (m.edges_right, m.edges_found) == (1.0, 1.0)
    assert m.edges == len(true_chain()) - 1


def test_a_boundary_that_leaves_a_cone_of_the_map_out_has_a_wrong_edge() -> None:
    whole = OVAL.cone_map()
    track = detect_track(whole, START)
    edges = len(true_chain())
    m = judged(whole, replace(track, left=np.delete(track.left, 7)))
    assert m.edges == edges - 1
    assert m.edges_right == pytest.approx((edges - 2) / (edges - 1))
    assert m.edges_found == pytest.approx((edges - 2) / edges)


def test_a_false_cone_on_a_boundary_makes_two_wrong_edges() -> None:
    whole = OVAL.cone_map()
    far = whole.xy_m.copy()
    track = detect_track(whole, START)
    far[track.left[7]] += 50.0
    edges = len(true_chain())
    m = judged(replace(whole, xy_m=far), track)
    assert m.edges == edges
    assert m.edges_right == pytest.approx((edges - 2) / edges)
    assert m.edges_found == pytest.approx((edges - 2) / (edges - 1))


def test_a_track_driven_the_wrong_way_round_has_no_right_edge() -> None:
    whole = OVAL.cone_map()
    track = detect_track(whole, START)
    swapped = replace(track, left=track.right[::-1], right=track.left[::-1])
    m = judged(whole, swapped)
    assert m.edges_right == 0.0
    assert m.road_iou == pytest.approx(1.0, abs=1e-6)


def test_an_unknown_track_has_no_edge_and_no_road() -> None:
    m = judged(OVAL.cone_map(), Track.unknown("too dark"))
    assert (m.found, m.closed_right, m.edges, m.road_iou) == (False, False, 0, 0.0)
    assert np.isnan(m.edges_right)
    assert m.edges_found == 0.0
    assert np.isnan(m.lateral_rmse_m)


def test_no_lane_is_no_truth_to_judge_by() -> None:
    rng = np.random.default_rng(3)
    strewn = TruthMap(np.arange(15), rng.uniform(-5, 5, (15, 2)), np.full(15, 4))
    assert true_track(strewn, None) is None
    none = np.zeros(0, dtype=np.int64)
    nothing = TruthMap(none, np.zeros((0, 2)), none)
    assert true_track(nothing, None) is None


def test_twins_are_one_cone_of_the_boundary(data_dir: Path) -> None:
    layout = read_track(data_dir / "tracks_pacsim" / "FSCZ24.yaml")
    n = len(layout)
    truth = TruthMap(np.arange(n), layout.xy_m, layout.cone_class)
    cov, seen = np.tile(0.01 * np.eye(2), (n, 1, 1)), np.full(n, 9)
    both = ConeMap(
        np.arange(n), layout.xy_m, cov, hard_class_prob(layout.cone_class), seen
    )
    true = true_track(truth, layout.start_pose)
    assert true is not None
    # The first of seven pairs that stand closer than 0.15 m is 60 and 61.
    for cones in (both, without(both, 60), without(both, 61)):
        found = WrittenTrack.of(detect_track(cones, layout.start_pose))
        m = track_metrics(found, cones, truth, true, ZERO, 1.0)
        assert (m.edges, m.edges_right, m.edges_found) == (n - 7, 1.0, 1.0)


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    track = detect_track(OVAL.cone_map(), START)
    write_track(tmp_path, track)
    read, made = read_written_track(tmp_path), WrittenTrack.of(track)
    assert read is not None
    np.testing.assert_array_equal(read.left, made.left)
    np.testing.assert_array_equal(read.right, made.right)
    np.testing.assert_allclose(read.line_m, made.line_m, atol=1e-9)
    assert read.closed
    assert shapely.equals_exact(read.road, made.road, 1e-9)


def test_an_unknown_track_can_be_read(tmp_path: Path) -> None:
    write_track(tmp_path, Track.unknown("too dark"))
    read = read_written_track(tmp_path)
    assert read is not None
    assert (len(read.left), len(read.line_m), read.road.is_empty) == (0, 0, True)


def test_a_folder_without_a_track_has_none(tmp_path: Path) -> None:
    assert read_written_track(tmp_path / "track") is None


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("track.json", "[1]", "must hold a JSON object"),
        ("track.json", "{", "is not JSON"),
        ("track.json", '{"left": [], "right": []}', "no track's summary"),
        ("track.json", '{"left": ["a"], "right": [], "closed": 1}', "no track's"),
        ("track.geojson", '{"features": [{"properties": {}}]}', "holds no track"),
        ("track.geojson", '{"features": []}', "holds no track"),
        ("track.geojson", '{"features": 7}', "holds no track"),
    ],
)
def test_a_broken_track_is_refused_by_name(
    tmp_path: Path, file: str, text: str, said: str
) -> None:
    write_track(tmp_path, detect_track(OVAL.cone_map(), START))
    (tmp_path / file).write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=said) as error:
        read_written_track(tmp_path)
    assert file in str(error.value)
