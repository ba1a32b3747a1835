"""The relocalisation benchmark's own arithmetic, tracks and maps."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.bench.lost_car import count_lost
from conegraph.bench.relocalisation import Query, found_figures, never_accepted
from conegraph.bench.relocalisation_trials import (
    MAP_ERROR,
    MAP_SIGMA_M,
    SENSORS,
    circuits,
    cone_map,
    drive,
    spoiled_map,
    start_windows,
    true_pose,
    windows,
)
from conegraph.bench.symmetric import circle, straight
from conegraph.config import resolve_config
from conegraph.errors import SourceError
from conegraph.geometry import rotation, to_parent
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import TruthMap


def test_the_circle_and_the_straight_map_onto_themselves() -> None:
    ring = circle(n=20).xy_m
    turned = ring @ rotation(2 * np.pi / 20).T
    gap = np.linalg.norm(turned[:, None] - ring, axis=2).min(axis=1)
    assert gap.max() < 1e-9
    line = straight(spacing_m=4.0)
    moved = line.xy_m + np.array([4.0, 0.0])
    gap = np.linalg.norm(moved[:, None] - line.xy_m, axis=2).min(axis=1)
    assert (gap < 1e-9).sum() == len(line) - 2


def test_a_spoiled_map_has_the_errors_it_promises() -> None:
    rng = np.random.default_rng(0)
    n = 1500
    xy = 100.0 * rng.standard_normal((n, 2))
    truth = TruthMap(np.arange(n), xy, np.zeros(n, dtype=np.int64))
    spoiled = spoiled_map(truth, rng)
    gap = np.linalg.norm(spoiled.xy_m[:, None] - xy, axis=2).min(axis=1)
    kept = gap < 5 * MAP_SIGMA_M
    assert kept.sum() == pytest.approx((1 - MAP_ERROR) * n, rel=0.03)
    assert (~kept).sum() == pytest.approx(MAP_ERROR * n, rel=0.3)
    assert np.sqrt(np.mean(gap[kept] ** 2) / 2) == pytest.approx(MAP_SIGMA_M, rel=0.1)
    assert np.mean(spoiled.cone_class[kept] != 0) == pytest.approx(0.05, abs=0.02)


def test_windows_see_the_cones_where_they_truly_are() -> None:
    recording = drive(built_in_track("oval", 0), SENSORS["camera"], 1)
    assert recording.truth_map is not None
    config, rng = resolve_config({}), np.random.default_rng(2)
    cut = [*windows(recording, config, (0.0, 1.0), 2, rng)]
    cut += start_windows(recording, config)
    assert [w.seconds for w in cut[:4]] == [0.0, 1.0, 0.0, 1.0]
    assert len(cut) == 8
    for window in cut:
        assert len(window.seen) >= 2
        place = to_parent(window.pose, window.seen.xy_m)
        gap = np.linalg.norm(place[:, None] - recording.truth_map.xy_m, axis=2)
        # One false cone in four frames, and noise that grows with the range.
        assert np.mean(gap.min(axis=1) < 1.0) > 0.6
        assert np.allclose(window.seen.views[0], 0.0)
    counts = [len(w.seen) for w in cut[:4]]
    assert counts[1] > counts[0]
    assert counts[3] > counts[2]


def test_a_car_that_is_carried_is_counted_once() -> None:
    recording = drive(built_in_track("oval", 0), SENSORS["lidar"], 1)
    assert recording.truth_map is not None
    exact = cone_map(recording.truth_map.xy_m, recording.truth_map.cone_class)
    count = count_lost(recording, exact, resolve_config({}), np.random.default_rng(3))
    assert 1 <= len(count.noticed_s) <= 4
    assert max(count.noticed_s) < 1.0
    assert len(count.found_s) == len(count.noticed_s)
    assert max(count.found_s) < 3.0
    assert count.false_alarms == 0
    path = recording.truth_trajectory
    assert path is not None
    assert 0.5 < 3600 * count.hours / path.stamp_s[-1] < 1.0
    assert true_pose(recording, 0.0) == pytest.approx(path.pose[0])


def test_shares_count_what_is_accepted_and_right() -> None:
    queries = [Query("lidar", 0.0, True, True)] * 98
    queries += [Query("lidar", 0.0, True, False), Query("lidar", 0.0, False, True)]
    lidar, camera, _ = found_figures(queries)
    assert lidar.values["share"] == pytest.approx(0.98)
    assert lidar.met
    assert camera.met is None
    wrong = never_accepted("wrong", queries, 0.005)
    assert wrong.values["share"] == pytest.approx(0.01)
    assert not wrong.met
    # Wilson's interval of 1 in 100.
    assert wrong.values["at_most"] == pytest.approx(0.0545, abs=2e-4)
    assert never_accepted("wrong", queries, 0.01).met
    assert never_accepted("wrong", queries[:98], 0.0).met


def test_open_tracks_are_no_circuits() -> None:
    with pytest.raises(SourceError):
        circuits(["acceleration"])
