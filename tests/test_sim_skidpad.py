"""The skidpad is recognised where it is one, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.geometry import to_parent
from conegraph.sim.polyline import arc_length, nearest
from conegraph.sim.skidpad import recognise_skidpad, skidpad_path
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Array, TrackLayout


def path_of(layout: TrackLayout) -> Array:
    path = recognise_skidpad(layout, exit_m=20.0, step_m=0.25)
    assert path is not None
    return path


@settings(max_examples=20, deadline=None)
@given(st.floats(-99, 99), st.floats(-99, 99), st.floats(-3.1, 3.1), st.booleans())
def test_a_moved_skidpad_is_found_where_it_is(
    x: float, y: float, yaw: float, has_start: bool
) -> None:
    there = np.array([x, y, yaw])
    layout = built_in_track("skidpad", 0)
    moved = replace(
        layout,
        xy_m=to_parent(there, layout.xy_m),
        start_pose=there if has_start else None,
    )
    path = path_of(moved)
    assert layout.centerline_m is not None
    expected = to_parent(there, layout.centerline_m)
    assert nearest(expected[:-4], path)[0].max() < 0.3
    assert (path[1] - path[0]) @ (np.cos(yaw), np.sin(yaw)) > 0.2
    if has_start:
        np.testing.assert_allclose(path[0], [x, y], atol=0.1)
    # First to the right: the far side of the right circle comes before the left's.
    right, left = to_parent(there, np.array([[15.0, -18.25], [15.0, 18.25]]))
    first = [int(nearest(p[None], path)[1][0]) for p in (right, left)]
    assert first[0] < first[1]


def test_cones_set_by_hand_are_recognised_too() -> None:
    layout = built_in_track("skidpad", 0)
    shaken = layout.xy_m + np.random.default_rng(0).normal(0, 0.08, layout.xy_m.shape)
    path = path_of(replace(layout, xy_m=shaken))
    assert layout.centerline_m is not None
    assert nearest(path, layout.centerline_m)[0].max() < 0.4


@pytest.mark.parametrize("name", ["autocross", "oval", "acceleration", "random"])
def test_other_tracks_are_none(name: str) -> None:
    assert recognise_skidpad(built_in_track(name, 3), 20.0, 0.25) is None


def test_a_handful_of_cones_is_none() -> None:
    layout = built_in_track("skidpad", 0)
    few = TrackLayout("few", layout.xy_m[:5], layout.cone_class[:5])
    assert recognise_skidpad(few, 20.0, 0.25) is None


def test_the_script_is_straights_and_four_circles() -> None:
    path = skidpad_path(entry_m=15.0, exit_m=20.0, radius_m=9.125, step_m=0.25)
    assert arc_length(path)[-1] == pytest.approx(35 + 8 * np.pi * 9.125, abs=0.3)
    np.testing.assert_allclose(path[[0, -1]], [[-15.0, 0.0], [20.0, 0.0]], atol=1e-9)
