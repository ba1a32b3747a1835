"""Built-in tracks against the numbers of the Formula Student rules."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.errors import SourceError
from conegraph.sim.polyline import arc_length, curvature, nearest, project, ring
from conegraph.sim.track_shapes import BUILT_IN_TRACKS, built_in_track
from conegraph.types import Array, ConeClass, TrackLayout

CLOSED = ["autocross", "oval", *(f"random {seed}" for seed in range(25))]


def track(text: str) -> TrackLayout:
    name, _, seed = text.partition(" ")
    return built_in_track(name, int(seed or 0))


def cones(layout: TrackLayout, kind: ConeClass) -> Array:
    chosen: Array = layout.xy_m[layout.cone_class == kind]
    return chosen


def middle(layout: TrackLayout) -> Array:
    assert layout.centerline_m is not None
    return layout.centerline_m


def length(layout: TrackLayout) -> float:
    return float(arc_length(ring(middle(layout), layout.closed))[-1])


@pytest.mark.parametrize("text", CLOSED)
def test_closed_courses_keep_the_rules(text: str) -> None:
    layout = track(text)
    gate = cones(layout, ConeClass.BIG_ORANGE)
    blue, yellow = cones(layout, ConeClass.BLUE), cones(layout, ConeClass.YELLOW)
    for row, posts in ((blue, gate[:2]), (yellow, gate[2:])):
        boundary = np.vstack([posts[0], row, posts[1]])
        gaps = np.hypot(*np.diff(boundary, axis=0).T)
        assert gaps.max() <= 5.0
        assert gaps.min() > 0.5
        assert np.hypot(*(posts[0] - posts[1])) == pytest.approx(0.6, abs=0.05)
    assert nearest(blue, yellow)[0].min() >= 3.0
    _, across = project(layout.xy_m, middle(layout), closed=True)
    left = np.isin(layout.cone_class, ConeClass.BLUE)
    left[np.flatnonzero(layout.cone_class == ConeClass.BIG_ORANGE)[:2]] = True
    np.testing.assert_allclose(across, np.where(left, 1.75, -1.75), atol=0.05)


@pytest.mark.parametrize("text", CLOSED)
def test_closed_courses_start_six_metres_before_their_line(text: str) -> None:
    layout = track(text)
    np.testing.assert_array_equal(layout.start_pose, np.zeros(3))
    np.testing.assert_allclose(middle(layout)[0], 0.0, atol=1e-9)
    assert abs(middle(layout)[1, 1]) < 0.01
    gate = cones(layout, ConeClass.BIG_ORANGE).mean(axis=0)
    np.testing.assert_allclose(gate, [6.0, 0.0], atol=0.4)


def test_cones_stand_closer_in_corners() -> None:
    layout = track("autocross")
    line = middle(layout)
    outside = cones(layout, ConeClass.YELLOW)
    gap = np.hypot(*np.diff(outside, axis=0).T)
    index, _ = project(0.5 * (outside[1:] + outside[:-1]), line, closed=True)
    bend = np.abs(curvature(line, closed=True))[index]
    assert gap[bend > 0.12].max() < 3.2
    assert gap[bend < 0.01].min() > 3.8


def test_autocross_is_about_450_m_and_the_same_for_every_seed() -> None:
    assert length(track("autocross")) == pytest.approx(450.0, abs=10.0)
    np.testing.assert_array_equal(track("autocross 1").xy_m, track("autocross 2").xy_m)


def test_oval_is_two_straights_and_a_circle() -> None:
    layout = track("oval")
    assert length(layout) == pytest.approx(100.0 + 30.0 * np.pi, abs=0.2)
    bend = curvature(middle(layout), closed=True)
    assert np.median(bend[bend > 0.03]) == pytest.approx(1 / 15.0, rel=1e-3)


def test_skidpad_has_the_geometry_of_the_rules() -> None:
    layout = track("skidpad")
    crossing = np.array([15.0, 0.0])
    for inner, outer, side in (
        (ConeClass.BLUE, ConeClass.YELLOW, 1.0),
        (ConeClass.YELLOW, ConeClass.BLUE, -1.0),
    ):
        centre = crossing + np.array([0.0, side * 18.25 / 2])
        inside = np.hypot(*(cones(layout, inner) - centre).T)
        outside = np.hypot(*(cones(layout, outer) - centre).T)
        assert (np.abs(inside - 15.25 / 2) < 1e-9).sum() == 16
        # The other circle's innermost cone stands on this outer circle: lane 3 m.
        assert (np.abs(outside - 21.25 / 2) < 1e-9).sum() == 13 + 1
    assert len(cones(layout, ConeClass.BLUE)) == 29
    assert len(cones(layout, ConeClass.BIG_ORANGE)) == 4
    assert nearest(layout.xy_m, middle(layout))[0].min() > 1.45
    assert not layout.closed


def test_skidpad_is_driven_right_right_left_left() -> None:
    layout = track("skidpad")
    line = middle(layout)
    bend = curvature(line, closed=False)
    turned = np.cumsum(bend) * 0.25 / (2 * np.pi)
    assert turned.min() == pytest.approx(-2.0, abs=0.02)
    assert turned[-1] == pytest.approx(0.0, abs=0.02)
    assert length(layout) == pytest.approx(15 + 4 * np.pi * 18.25 + 20, abs=0.5)
    assert line[-1] == pytest.approx([35.0, 0.0], abs=0.3)


def test_acceleration_is_75_m_with_a_cone_every_5_m() -> None:
    layout = track("acceleration")
    gates = np.unique(np.round(cones(layout, ConeClass.BIG_ORANGE)[:, 0] - 0.3, 6))
    np.testing.assert_allclose(gates, [-0.3, 0.3, 74.7, 75.3])
    for kind, y in ((ConeClass.BLUE, 1.75), (ConeClass.YELLOW, -1.75)):
        row = cones(layout, kind)
        np.testing.assert_allclose(row[:, 0] - 0.3, np.arange(5.0, 75.0, 5.0))
        np.testing.assert_allclose(row[:, 1], y)
    orange = cones(layout, ConeClass.ORANGE)
    assert orange[:, 0].min() > 75.3
    assert middle(layout)[-1, 0] < orange[:, 0].max()
    assert not layout.closed


def test_random_courses_differ_by_seed_and_repeat_by_seed() -> None:
    np.testing.assert_array_equal(track("random 7").xy_m, track("random 7").xy_m)
    assert len({length(track(f"random {seed}")) for seed in range(10)}) == 10


def test_an_unknown_name_is_answered_with_those_there_are() -> None:
    with pytest.raises(SourceError, match="no built-in track 'ovel'") as caught:
        built_in_track("ovel", 0)
    assert all(name in str(caught.value) for name in BUILT_IN_TRACKS)
