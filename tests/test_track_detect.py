"""Boundaries, road and centre line of tracks that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LinearRing

from conegraph.bench.track import Score, bench_track
from conegraph.bench.track_hard import hairpin, hard_cases, map_of
from conegraph.bench.track_judge import (
    ahead_right,
    edges_right,
    road_iou,
    wrong_map,
)
from conegraph.bench.track_truth import (
    KnownTrack,
    Spoil,
    closed_tracks,
    course_of,
    known_track,
    moved,
    random_tracks,
    reverse,
    spoiled,
    window,
)
from conegraph.config import TrackConfig
from conegraph.sim.track_shapes import built_in_track
from conegraph.track import detect_track
from conegraph.track.live import LiveTrack
from conegraph.track.road import signed_area
from conegraph.track.shapes import road_polygon, road_raster
from conegraph.track.thesis import thesis_order
from conegraph.types import ConeMap

OVAL = known_track(built_in_track("oval", 0))
RANDOM = random_tracks([3])[0]


@pytest.mark.parametrize("truth", [OVAL, RANDOM], ids=lambda t: t.name)
def test_a_clean_map_comes_out_edge_by_edge(truth: KnownTrack) -> None:
    track = detect_track(truth.cone_map())
    right, count = edges_right(track, truth)
    assert track.closed
    assert right == count == len(track.left) + len(track.right)
    assert road_iou(track, truth) > 0.999
    assert track.confidence > 0.9
    assert track.unused == ()
    assert track.relabelled == ()


def test_the_oval_has_the_length_width_and_curvature_of_its_making() -> None:
    track = detect_track(OVAL.cone_map(), np.zeros(3))
    line = track.centerline
    # Two straights of 50 m and a circle of 15 m radius, in a lane of 3.5 m.
    assert track.length_m == pytest.approx(100 + 30 * np.pi, rel=0.01)
    assert line.left_m == pytest.approx(1.75, abs=0.08)
    assert line.right_m == pytest.approx(1.75, abs=0.08)
    assert np.median(line.curvature_1pm[line.curvature_1pm > 0.03]) == pytest.approx(
        1 / 15, rel=0.1
    )
    step = np.hypot(*np.diff(line.xy_m, axis=0).T)
    assert step == pytest.approx(step[0], rel=0.02)
    assert np.diff(line.s_m) == pytest.approx(step)


@settings(max_examples=10, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1),
    shift=st.floats(-900.0, 900.0),
    seed=st.integers(0, 99),
    backwards=st.booleans(),
)
def test_neither_order_nor_frame_nor_direction_changes_the_answer(
    yaw: float, shift: float, seed: int, backwards: bool
) -> None:
    truth = reverse(OVAL) if backwards else OVAL
    truth = moved(truth, yaw, np.array([shift, -0.5 * shift]))
    cones = truth.cone_map()
    first = detect_track(cones)
    mixed = np.random.default_rng(seed).permutation(len(cones))
    again = detect_track(cones.subset(mixed))
    assert edges_right(first, truth) == (len(cones), len(cones))
    assert again.left_id.tolist() == first.left_id.tolist()
    assert again.right_id.tolist() == first.right_id.tolist()


@pytest.mark.parametrize(
    "spoil",
    [Spoil(missing=0.1), Spoil(false=0.05), Spoil(flipped=0.03)],
    ids=["missing", "false", "flipped"],
)
def test_most_spoilt_maps_come_out_right(spoil: Spoil) -> None:
    wrong = []
    for seed in range(6):
        seen = spoiled(RANDOM, spoil, np.random.default_rng(seed))
        why = wrong_map(detect_track(seen.cone_map()), RANDOM)
        wrong += [why] if why else []
    assert len(wrong) <= 1, wrong


def test_what_is_odd_about_a_map_is_said() -> None:
    cones = OVAL.cone_map()
    xy, prob = np.array(cones.xy_m), np.array(cones.class_prob)
    flipped, gone = int(OVAL.left[5]), int(OVAL.right[9])
    prob[flipped] = prob[OVAL.right[5]]
    middle = OVAL.line_m[80]
    keep = np.arange(len(cones)) != gone
    spoilt = ConeMap(
        np.append(cones.id[keep], 777),
        np.vstack([xy[keep], middle]),
        np.concatenate([cones.cov_m2[keep], cones.cov_m2[:1]]),
        np.vstack([prob[keep], prob[OVAL.left[7]]]),
        np.append(cones.observations[keep], 5),
    )
    track = detect_track(spoilt)
    assert [(r.id, r.side) for r in track.relabelled] == [(flipped, "left")]
    assert [(u.id, u.reason) for u in track.unused] == [(777, "stands on the road")]
    before, after = (int(OVAL.right[k]) for k in (8, 10))
    assert [(b.from_id, b.to_id) for b in track.bridged] == [(before, after)]


@pytest.mark.parametrize("truth", [OVAL, RANDOM, course_of(250)], ids=lambda t: t.name)
def test_the_road_covers_the_lane_once(truth: KnownTrack) -> None:
    track = detect_track(truth.cone_map())
    area = signed_area(track.xy_m, track.triangles)
    assert (area > 0).all()
    assert area.sum() == pytest.approx(road_polygon(track).area, rel=1e-9)
    assert len(track.triangles) == len(track.left) + len(track.right)
    edges = np.sort(
        np.concatenate(
            [track.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]
        )
    )
    _, times = np.unique(edges, axis=0, return_counts=True)
    # Every gate is in two triangles, every edge of a boundary in one.
    assert sorted(set(times.tolist())) == [1, 2]
    assert (times == 2).sum() == len(track.triangles)
    raster = road_raster(track, cell_m=0.2)
    assert raster.road.sum() * 0.04 == pytest.approx(area.sum(), rel=0.01)


@pytest.mark.parametrize("colour", [True, False])
def test_the_lane_ahead_of_a_car_is_found(colour: bool) -> None:
    for at in range(0, len(OVAL.line_m), 60):
        pose = OVAL.pose_at(at)
        rng = np.random.default_rng(at)
        seen = window(spoiled(OVAL, Spoil(colour=colour), rng), pose, 20.0)
        track = detect_track(seen.cone_map(), pose)
        assert ahead_right(track, OVAL, pose), at
        right, count = edges_right(track, seen)
        # Without colours nothing says on which side the last cone in view stands.
        assert right >= count - (not colour)


def test_half_a_map_is_an_open_track() -> None:
    cones = OVAL.cone_map()
    half = cones.subset(cones.xy_m[:, 0] > 5.0)
    track = detect_track(half)
    assert not track.closed
    assert len(track.left) + len(track.right) == len(half)


HARD = hard_cases(seed=0)


@pytest.mark.parametrize("name", [name for name, _ in HARD])
def test_hard_cases_are_right_or_unsure(name: str) -> None:
    assert dict(HARD)[name](TrackConfig())


def test_no_cones_are_no_track() -> None:
    track = detect_track(ConeMap.empty())
    assert track.confidence == 0.0
    assert track.reason
    assert len(track.centerline) == 0


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(0, 30),
    scale=st.sampled_from([0.0, 0.5, 20.0]),
)
def test_any_cones_give_an_answer(seed: int, n: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    xy = np.round(rng.uniform(-scale, scale, (n, 2)), 1)
    split = int(rng.integers(n + 1))
    for pose in (None, np.zeros(3)):
        track = detect_track(map_of(xy[:split], xy[split:]), pose)
        assert 0.0 <= track.confidence <= 1.0
        assert set(track.left_id.tolist()).isdisjoint(track.right_id.tolist())
        if track.closed:
            assert LinearRing(track.left_m).is_simple


def test_what_did_not_change_is_not_found_again() -> None:
    cones, pose = OVAL.cone_map(), np.zeros(3)
    live = LiveTrack()
    whole, ahead = live.update_map(cones, pose), live.update_pose(pose)
    jitter = replace(cones, xy_m=cones.xy_m + 0.01)
    assert live.update_map(jitter, pose) is whole
    assert live.update_pose(pose + 0.01) is ahead
    assert live.update_map(cones.subset(np.arange(len(cones)) != 4), pose) is not whole


def test_new_cones_leave_the_rest_of_the_road_as_it_was() -> None:
    cones = RANDOM.cone_map()
    later = np.isin(np.arange(len(cones)), RANDOM.left[20:23])
    first = detect_track(cones.subset(~later))
    second = detect_track(cones, previous=first)
    kept = {tuple(t) for t in first.triangle_id.tolist()}
    fresh = [t for t in second.triangle_id.tolist() if tuple(t) not in kept]
    near = np.isin(np.array(fresh), RANDOM.left[17:26]).any(axis=1)
    assert len(fresh) < 12
    assert near.all()


@pytest.mark.parametrize("reading", ["product", "sum"])
def test_the_thesis_joins_an_even_circle_by_either_reading(
    reading: Literal["product", "sum"],
) -> None:
    config = TrackConfig(profile="thesis", thesis_cost=reading)
    truth = course_of(60)
    chain = thesis_order(truth.xy_m, truth.left, int(truth.left[7]), config)
    step = np.diff(chain) % len(truth.left)
    assert len(set(step.tolist())) == 1
    assert step[0] in (1, len(truth.left) - 1)


def test_the_hairpin_runs_on_both_sides_of_its_wall() -> None:
    left, right = hairpin(1.5)
    track = detect_track(map_of(left, right), np.array([-1.0, -2.25, 0.0]))
    assert track.left.tolist() == list(range(len(left)))
    assert track.centerline.xy_m[-1] == pytest.approx([0.0, 2.25], abs=0.7)


def test_real_layouts_come_out(data_dir: Path) -> None:
    wrong = {}
    for truth in closed_tracks(data_dir / "tracks_pacsim"):
        why = wrong_map(detect_track(truth.cone_map()), truth)
        if why:
            wrong[truth.name] = why
    assert wrong == {}


def test_what_was_not_measured_meets_no_target() -> None:
    figure = Score("maps", 1.0, 0.9, True, 0).figure()
    assert (figure.measured, figure.met) == ("not measured", None)


def test_a_line_that_is_not_found_is_infinitely_far_off() -> None:
    # Where every cone is yellow there is no lane.
    lone = replace(OVAL, cone_class=np.ones(len(OVAL.xy_m), dtype=np.int64))
    scores = {s.name: s for s in bench_track([lone], [0], TrackConfig())}
    line = scores["centre line RMS m, clean"]
    assert (line.value, line.met, line.count) == (np.inf, False, 1)
    assert line.failures == ("oval, seed 0: no line",)
