"""Recognising a place: closed forms, and layouts where no place can be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.backends.cone_index import REACH_M, ConeIndex
from conegraph.backends.landmarks import class_likelihood
from conegraph.backends.pose_candidates import candidate_poses
from conegraph.backends.pose_score import (
    CLUTTER_PER_M2,
    MAP_SIGMA_M,
    REMOVED,
    SHOWN,
    refine,
)
from conegraph.backends.relocalize import Relocaliser, mirror_image, same_place
from conegraph.backends.sightings import STANDING, Sightings
from conegraph.backends.start_line import verify_closure
from conegraph.geometry import compose, to_child
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    IntArray,
    SensorModel,
)

SIGMA_M = 0.05
SENSOR = SensorModel(
    np.array([SIGMA_M, 0.0, 0.0]),
    0.005,
    max_range_m=20.0,
    half_fov_rad=np.pi,
    detection_probability=0.0,
)
"""Promises nothing: what is not seen does not count."""


def cone_map(xy_m: Array, classes: IntArray | None = None) -> ConeMap:
    n = len(xy_m)
    prob = np.full((n, 5), 0.025)
    prob[np.arange(n), 0 if classes is None else classes] = 0.9
    cov = np.tile(1e-4 * np.eye(2), (n, 1, 1))
    return ConeMap(np.arange(n) + 100, xy_m, cov, prob, np.full(n, 9))


def scattered(n: int = 60, seed: int = 1) -> ConeMap:
    """Return cones that stand anywhere: no two places are alike."""
    rng = np.random.default_rng(seed)
    return cone_map(rng.uniform(-30, 30, (n, 2)), rng.integers(0, 3, n))


def view(known: ConeMap, pose: Array, range_m: float = 15.0) -> ConeObservations:
    """Return what is near a pose, exactly where it is."""
    xy = to_child(pose, known.xy_m)
    near = np.hypot(*xy.T) < range_m
    n = int(near.sum())
    cov = np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1))
    return ConeObservations(0.0, xy[near], cov, known.class_prob[near])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_the_raster_finds_the_nearest_cone_up_to_a_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = scattered(seed=seed)
    places = rng.uniform(-40, 40, (200, 2))
    found = ConeIndex(known, 12.0).nearest(places[:, 0], places[:, 1])
    gap = np.hypot(*np.moveaxis(places[:, None] - known.xy_m, -1, 0))
    cell = 0.1
    for row, cone in enumerate(found.tolist()):
        if cone == len(known):
            assert gap[row].min() > REACH_M - cell
        else:
            assert gap[row, cone] < gap[row].min() + 2 * cell


def test_colour_ratio_is_one_on_average_and_right_in_closed_form() -> None:
    known = cone_map(np.array([[0.0, 0], [5, 0]]), np.array([0, 1]))
    index = ConeIndex(known, 12.0)
    sure = np.eye(5)[:2]
    ratio = np.exp(index.log_colour(sure))
    assert np.allclose(ratio[:, 2], 1.0)
    # Blue and yellow are alike frequent: a sure blue is on the blue cone by the share
    # of its class there over the mean of both.
    frequency = 0.9 * known.class_prob.mean(axis=0) + 0.02
    by_cone = 0.9 * known.class_prob + 0.1 * frequency
    assert ratio[0, 0] == pytest.approx(by_cone[0, 0] / frequency[0])
    assert ratio[0, 1] == pytest.approx(by_cone[1, 0] / frequency[0])


def test_class_likelihood_of_an_unknown_report_says_nothing() -> None:
    likelihood = class_likelihood(np.eye(5)[4:])
    assert np.allclose(likelihood, likelihood[0, 0])


@given(x=st.floats(-15, 15), y=st.floats(-15, 15), yaw=st.floats(-3.1, 3.1), seed=...)
@settings(max_examples=25, deadline=None)
def test_a_pair_laid_on_its_own_pair_gives_the_true_pose(
    x: float, y: float, yaw: float, seed: int
) -> None:
    known = scattered(seed=abs(seed) % 1000)
    pose = np.array([x, y, yaw])
    seen = Sightings.of_frame(view(known, pose))
    index = ConeIndex(known, 12.0)
    poses = candidate_poses(index, seen, index.log_colour(seen.likelihood), 0.03)
    gap = np.abs(poses - pose)
    gap[:, 2] = np.minimum(gap[:, 2], 2 * np.pi - gap[:, 2])
    assert gap.max(axis=1).min() < 1e-9


def test_log_likelihood_and_covariance_in_closed_form() -> None:
    """Four cones of one class seen exactly; one of them also seen double."""
    known = cone_map(np.array([[8.0, 0], [0, 8], [-8, 0], [0, -8]]))
    frame = view(known, np.zeros(3))
    index = ConeIndex(known, 12.0)
    seen = Sightings.of_frame(frame)
    log_colour = index.log_colour(seen.likelihood)
    scored = refine(index, seen, log_colour, np.zeros((1, 3)), SENSOR)
    var = SIGMA_M**2 + 1e-4 + MAP_SIGMA_M**2
    colour = np.exp(log_colour[0, 0])
    gain = SHOWN / CLUTTER_PER_M2 / (2 * np.pi * var) * colour + 1 - SHOWN
    assert scored.log_likelihood[0] == pytest.approx(4 * np.log(gain))
    shown = 1 - (1 - SHOWN) / gain
    information = np.diag([4.0, 4.0, 4 * 64.0]) * shown / var
    information += np.diag([0.01, 0.01, 0.1])
    assert np.allclose(np.linalg.inv(scored.cov[0]), information, rtol=1e-6)
    assert scored.cone.tolist() == [[0, 1, 2, 3]]
    assert scored.misfit[0] == pytest.approx(0.0, abs=1e-12)

    # Seen double, once 10 cm off: the nearer sighting has the cone, the other none.
    again = frame.subset(np.array([0, 1, 2, 3, 0]))
    xy = again.xy_m.copy()
    xy[4] += [0.1, 0.0]
    double = Sightings.of_frame(replace(again, xy_m=xy))
    log_colour = index.log_colour(double.likelihood)
    both = refine(index, double, log_colour, np.zeros((1, 3)), SENSOR)
    assert both.cone.tolist() == [[0, 1, 2, 3, 4]]
    fewer = scored.log_likelihood[0] - both.log_likelihood[0]
    assert fewer == pytest.approx(-np.log(1 - SHOWN), abs=0.3)


def test_a_cone_that_should_have_been_seen_speaks_against_a_pose() -> None:
    known = scattered()
    frame = view(known, np.zeros(3), 12.0)
    promising = replace(SENSOR, max_range_m=14.0, detection_probability=0.9)
    index = ConeIndex(known, 12.0)
    full = Sightings.of_frame(frame)
    # One cone, 2.5 to 9 m off, is hidden; the others say the same as before.
    range_m = np.hypot(*frame.xy_m.T)
    hidden = int(np.flatnonzero((range_m > 2.5) & (range_m < 9.0))[0])
    less = Sightings.of_frame(frame.subset(np.arange(len(frame)) != hidden))
    at = np.zeros((1, 3))

    def score(seen: Sightings, sensor: SensorModel) -> float:
        scored = refine(index, seen, index.log_colour(seen.likelihood), at, sensor)
        return float(scored.log_likelihood[0])

    assert score(full, promising) == pytest.approx(score(full, SENSOR))
    cost = score(less, SENSOR) - score(less, promising)
    assert cost == pytest.approx(-np.log(REMOVED + (1 - REMOVED) * 0.1))


@given(x=st.floats(-15, 15), y=st.floats(-15, 15), yaw=st.floats(-3.1, 3.1), seed=...)
@settings(max_examples=25, deadline=None)
def test_the_car_is_found_anywhere_and_its_cones_named(
    x: float, y: float, yaw: float, seed: int
) -> None:
    known = scattered(seed=abs(seed) % 1000)
    pose = np.array([x, y, yaw])
    frame = view(known, pose)
    if len(frame) < 9:
        return
    found = Relocaliser(known, SENSOR).locate(frame)
    assert found.accepted, found.reason
    assert found.best is not None
    assert found.probability > 0.99
    assert found.inliers == len(frame)
    assert np.hypot(*(found.best.pose - pose)[:2]) < 0.02
    seen = to_child(pose, known.xy_m[found.best.cone])
    assert np.allclose(seen, frame.xy_m[found.best.row], atol=1e-6)


def test_another_map_few_cones_and_nothing_are_not_accepted() -> None:
    known, other = scattered(seed=3), scattered(seed=4)
    frame = view(other, np.zeros(3))
    searcher = Relocaliser(known, SENSOR)
    assert not searcher.locate(frame).accepted
    few = view(known, np.zeros(3)).subset(np.arange(4))
    assert not searcher.locate(few).accepted
    for nothing in (frame.subset(np.arange(0)), frame.subset(np.arange(1))):
        found = searcher.locate(nothing)
        assert not found.accepted
        assert found.best is None
        assert found.probability == 0.0
    empty = Relocaliser(ConeMap.empty(), SENSOR)
    assert not empty.locate(frame).accepted


@pytest.mark.parametrize("n", [12, 24, 48])
def test_on_a_circle_with_equal_spacing_every_place_is_as_good(n: int) -> None:
    turn = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    known = cone_map(np.vstack([13 * ring, 17 * ring]), np.repeat([0, 1], n))
    searcher = Relocaliser(known, SENSOR)
    rng = np.random.default_rng(n)
    for heading in rng.uniform(-np.pi, np.pi, 20):
        c, s = np.cos(heading), np.sin(heading)
        pose = np.array([15 * c, 15 * s, heading + np.pi / 2])
        frame = view(known, pose, 9.0)
        noisy = frame.xy_m + SIGMA_M * rng.standard_normal(frame.xy_m.shape)
        found = searcher.locate(replace(frame, xy_m=noisy))
        assert not found.accepted
        assert found.probability < 0.9


def test_a_straight_without_ends_in_view_is_not_told_from_the_next_stretch() -> None:
    x = np.arange(-100.0, 100.0, 4.0)
    rows = [np.column_stack([x, np.full_like(x, side)]) for side in (1.75, -1.75)]
    known = cone_map(np.vstack(rows), np.repeat([0, 1], len(x)))
    searcher = Relocaliser(known, SENSOR)
    for at in np.linspace(-20, 20, 11):
        frame = view(known, np.array([at, 0.3, 0.05]), 15.0)
        assert not searcher.locate(frame).accepted


def test_a_lane_like_any_other_is_not_taken_for_the_map_s() -> None:
    """A straight is its own mirror image; where the whole map is, that says nothing."""
    x = np.array([0.0, 3.1, 5.9, 9.5, 12.2, 15.8, 18.0])
    rows = [np.column_stack([x, np.full_like(x, side)]) for side in (1.75, -1.75)]
    lane = cone_map(np.vstack(rows), np.repeat([0, 1], len(x)))
    rest = scattered()
    course = cone_map(
        np.vstack([lane.xy_m, rest.xy_m + np.array([80.0, 0.0])]),
        np.concatenate([lane.cone_class, rest.cone_class]),
    )
    frame = view(course, np.array([9.0, 0.2, 0.1]))
    assert len(frame) == len(lane)
    somewhere = Relocaliser(course, SENSOR)
    assert somewhere.locate(frame, on_map=True).accepted
    assert not somewhere.locate(frame).accepted
    assert somewhere.locate(view(course, np.array([80.0, 0.0, 1.0]))).accepted
    assert Relocaliser(lane, SENSOR).locate(frame).accepted


def test_a_place_that_fits_worse_than_the_noise_is_not_accepted() -> None:
    known, pose = scattered(), np.array([3.0, -4.0, 1.0])
    exact = view(known, pose)
    searcher = Relocaliser(known, SENSOR)
    draw = np.random.default_rng(5).standard_normal(exact.xy_m.shape)
    var = SIGMA_M**2 + 1e-4 + MAP_SIGMA_M**2
    for sigmas, fits in ((0.9, True), (1.6, False)):
        xy = exact.xy_m + sigmas * np.sqrt(var) * draw
        found = searcher.locate(replace(exact, xy_m=xy))
        assert found.best is not None
        assert same_place(found.best.pose, pose)[0]
        assert found.probability > 0.99
        assert found.accepted == fits, found.reason


def test_a_mirror_image_swaps_left_and_right() -> None:
    known = scattered()
    image = mirror_image(known)
    assert np.allclose(image.xy_m, known.xy_m * [1.0, -1.0])
    assert (image.cone_class[known.cone_class == 0] == 1).all()
    assert (image.cone_class[known.cone_class == 2] == 2).all()
    again = mirror_image(image)
    assert np.allclose(again.xy_m, known.xy_m)
    assert np.allclose(again.class_prob, known.class_prob)


def test_a_closure_is_verified_only_where_the_whole_map_has_no_better_place() -> None:
    known = scattered()
    pose = np.array([3.0, -4.0, 1.0])
    frame = view(known, pose)
    searcher = Relocaliser(known, SENSOR)
    assert verify_closure(searcher, frame, pose) > searcher.config.margin
    beside = compose(pose, np.array([2.0, 0.0, 0.0]))
    assert verify_closure(searcher, frame, beside) == -np.inf
    assert verify_closure(searcher, frame.subset(np.arange(1)), pose) == -np.inf
    # The same constellation twice: each is as good as the other.
    twice = cone_map(np.vstack([known.xy_m, known.xy_m + np.array([80.0, 0.0])]))
    lead = verify_closure(Relocaliser(twice, SENSOR), frame, pose)
    assert lead <= searcher.config.margin


def test_same_place_is_near_and_turned_alike() -> None:
    others = np.array([[0.9, 0, 0], [1.1, 0, 0], [0, 0, 0.14], [0, 0, 0.2]])
    assert same_place(np.zeros(3), others).tolist() == [True, False, True, False]
    turned = np.array([[0.0, 0.0, -np.pi + 0.05]])
    assert same_place(np.array([0.0, 0.0, np.pi - 0.05]), turned).all()


def test_a_frame_is_seen_from_where_the_car_is() -> None:
    frame = view(scattered(), np.zeros(3))
    seen = Sightings.of_frame(frame)
    assert len(seen) == len(frame)
    assert seen.views is STANDING
