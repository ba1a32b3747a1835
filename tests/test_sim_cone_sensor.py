"""The detector's noise, misses and mistakes against the numbers it was given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from conegraph.sim.cone_sensor import CAMERA, LIDAR, ConeSensor, RangeFalloff, sense
from conegraph.types import Array, ConeClass, ConeObservations, IntArray, TruthMap

SURE = RangeFalloff(1.0)
RNG = np.random.default_rng(0)
FIELD = TruthMap(
    np.arange(100, 340), RNG.uniform(-60, 60, (240, 2)), RNG.integers(0, 4, 240)
)


def poses(count: int) -> Array:
    """Return cars all over the field, looking everywhere."""
    rng = np.random.default_rng(1)
    places = rng.uniform(-50, 50, (count, 2))
    return np.column_stack([places, rng.uniform(-np.pi, np.pi, count)])


def run(
    sensor: ConeSensor, count: int = 3000, cones: TruthMap = FIELD, seed: int = 2
) -> list[ConeObservations]:
    rng = np.random.default_rng(seed)
    return sense(sensor, np.arange(count) / sensor.rate_hz, poses(count), cones, rng)


def truth_of(frames: Sequence[ConeObservations]) -> tuple[Array, IntArray]:
    """Return true (range, bearing) and index of the cone of every true detection."""
    where = poses(len(frames))
    polar, index = [], []
    for frame, pose in zip(frames, where, strict=True):
        assert frame.truth_id is not None
        row = frame.truth_id[frame.truth_id >= 0] - 100
        away = FIELD.xy_m[row] - pose[:2]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - pose[2]
        polar.append(
            np.column_stack([np.hypot(*away.T), np.angle(np.exp(1j * bearing))])
        )
        index.append(row)
    return np.vstack(polar), np.concatenate(index)


def visible(sensor: ConeSensor, count: int) -> Array:
    """Return true (range, bearing) of every cone in view, by brute force."""
    found = []
    for pose in poses(count):
        away = FIELD.xy_m - pose[:2]
        bearing = np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - pose[2])))
        distance = np.hypot(*away.T)
        m = sensor.model
        near = (distance >= m.min_range_m) & (distance <= m.max_range_m)
        seen = near & (np.abs(bearing) <= m.half_fov_rad)
        found.append(np.column_stack([distance, bearing])[seen])
    return np.vstack(found)


def without_false(sensor: ConeSensor) -> ConeSensor:
    return replace(sensor, false_per_frame=0.0)


def test_a_perfect_detector_reports_exactly_what_is_in_view() -> None:
    sensor = replace(without_false(CAMERA), detection=SURE)
    polar, _ = truth_of(run(sensor))
    expected = visible(sensor, 3000)
    assert len(polar) == len(expected)
    np.testing.assert_allclose(np.sort(polar[:, 0]), np.sort(expected[:, 0]))


@pytest.mark.parametrize("sensor", [CAMERA, LIDAR], ids=["camera", "lidar"])
def test_nothing_is_reported_from_outside_the_view(sensor: ConeSensor) -> None:
    polar, _ = truth_of(run(sensor))
    model = sensor.model
    assert polar[:, 0].min() >= model.min_range_m
    assert polar[:, 0].max() <= model.max_range_m
    assert np.abs(polar[:, 1]).max() <= model.half_fov_rad
    assert np.abs(polar[:, 1]).max() > 0.99 * model.half_fov_rad


@pytest.mark.parametrize("sensor", [CAMERA, LIDAR], ids=["camera", "lidar"])
def test_misses_follow_the_detection_probability(sensor: ConeSensor) -> None:
    reported, _ = truth_of(run(without_false(sensor)))
    there = visible(sensor, 3000)
    edges = np.linspace(sensor.model.min_range_m, sensor.model.max_range_m, 5)
    for near, far in pairwise(edges.tolist()):
        ranges = there[(there[:, 0] >= near) & (there[:, 0] < far), 0]
        p = sensor.detection.at(ranges - sensor.model.min_range_m)
        count = ((reported[:, 0] >= near) & (reported[:, 0] < far)).sum()
        assert abs(count - p.sum()) < 5 * np.sqrt((p * (1 - p)).sum())


def test_noise_is_drawn_at_the_true_range() -> None:
    """Range and bearing errors of the camera over their sigmas are standard normal."""
    frames = run(without_false(CAMERA))
    polar, _ = truth_of(frames)
    xy = np.vstack([f.xy_m for f in frames])
    sigma = 0.01 + 0.0025 * polar[:, 0] ** 2
    error = np.column_stack(
        [
            (np.hypot(*xy.T) - polar[:, 0]) / sigma,
            (np.arctan2(xy[:, 1], xy[:, 0]) - polar[:, 1]) / 0.005,
        ]
    )
    n = len(error)
    total = (error**2).sum()
    assert 1e-6 < float(chi2.cdf(total, 2 * n)) < 1 - 1e-6
    assert np.abs(error.mean(axis=0)).max() < 5 / np.sqrt(n)
    assert abs(np.corrcoef(error.T)[0, 1]) < 5 / np.sqrt(n)


def test_reported_covariance_is_the_models_at_the_measured_place() -> None:
    for frame in run(CAMERA, 50):
        np.testing.assert_array_equal(frame.cov_m2, CAMERA.model.covariance(frame.xy_m))


def test_residuals_agree_with_the_reported_covariance() -> None:
    """The lidar's noise hardly depends on range, so that chi^2 has 2 n degrees."""
    frames = run(without_false(LIDAR), 600)
    polar, _ = truth_of(frames)
    xy = np.vstack([f.xy_m for f in frames])
    cov = np.vstack([f.cov_m2 for f in frames])
    true_xy = polar[:, :1] * np.column_stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])])
    error = xy - true_xy
    d2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error)
    assert 1e-6 < float(chi2.cdf(d2.sum(), 2 * len(d2))) < 1 - 1e-6


def test_false_detections_are_counted_and_even_over_the_view() -> None:
    sensor = replace(CAMERA, false_per_frame=1.5)
    frames = run(sensor)
    false = np.vstack([f.xy_m[f.truth_id == -1] for f in frames])
    assert abs(len(false) - 1.5 * 3000) < 5 * np.sqrt(1.5 * 3000)
    model = sensor.model
    distance, bearing = np.hypot(*false.T), np.arctan2(false[:, 1], false[:, 0])
    assert distance.min() >= model.min_range_m
    assert distance.max() <= model.max_range_m
    assert np.abs(bearing).max() <= model.half_fov_rad
    inner = (distance**2 < (model.min_range_m**2 + model.max_range_m**2) / 2).mean()
    assert inner == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(len(false)))
    left = (bearing > 0).mean()
    assert left == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(len(false)))


def test_classes_are_confused_as_often_as_asked() -> None:
    sensor = replace(
        without_false(CAMERA), classification=RangeFalloff(0.8), unknown_share=0.25
    )
    frames = run(sensor)
    _, index = truth_of(frames)
    named = np.vstack([f.class_prob for f in frames]).argmax(axis=1)
    truth = FIELD.cone_class[index]
    n = len(truth)
    right, unknown = named == truth, named == ConeClass.UNKNOWN
    for share, p in ((right, 0.8), (unknown, 0.05), (~right & ~unknown, 0.15)):
        assert share.mean() == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / n))
    wrong = ~right & ~unknown
    step = (named[wrong] - truth[wrong]) % 4
    counts = np.bincount(step, minlength=4)
    assert counts[0] == 0
    assert np.abs(counts[1:] / wrong.sum() - 1 / 3).max() < 5 / np.sqrt(wrong.sum())


def test_class_probabilities_are_rows_with_the_certainty_on_one_class() -> None:
    prob = np.vstack([f.class_prob for f in run(CAMERA, 200)])
    np.testing.assert_allclose(prob.sum(axis=1), 1.0)
    np.testing.assert_allclose(prob.max(axis=1), CAMERA.certainty)


def test_the_lidar_knows_no_class_beyond_its_class_range() -> None:
    frames = run(without_false(LIDAR), 300)
    polar, _ = truth_of(frames)
    named = np.vstack([f.class_prob for f in frames]).argmax(axis=1)
    far = polar[:, 0] > LIDAR.class_range_m
    assert (named[far] == ConeClass.UNKNOWN).all()
    assert (named[~far] != ConeClass.UNKNOWN).mean() > 0.9


def test_cones_of_unknown_class_may_be_taken_for_any_colour() -> None:
    clutter = TruthMap(FIELD.id, FIELD.xy_m, np.full(240, int(ConeClass.UNKNOWN)))
    sensor = replace(
        without_false(CAMERA), classification=RangeFalloff(0.0), unknown_share=0.0
    )
    named = np.vstack([f.class_prob for f in run(sensor, cones=clutter)]).argmax(axis=1)
    shares = np.bincount(named, minlength=5) / len(named)
    np.testing.assert_allclose(
        shares, [0.25, 0.25, 0.25, 0.25, 0.0], atol=5 * 0.44 / np.sqrt(len(named))
    )


def test_pacsims_falloff() -> None:
    """0.99 - 0.01 d - 0.00012 d^2, never below 0.1, d beyond the least range."""
    at = LIDAR.detection.at(np.array([0.0, 10.0, 44.0, 500.0]))
    np.testing.assert_allclose(at, [0.99, 0.878, 0.31768, 0.1])
    assert LIDAR.model.detection_probability == pytest.approx(
        LIDAR.detection.at(np.array([0.75 * 45.0 - 1.0]))[0], abs=0.005
    )


def test_the_order_within_a_frame_tells_nothing() -> None:
    sensor = replace(without_false(LIDAR), detection=SURE)
    ids = [f.truth_id for f in run(sensor, 400) if len(f) > 9]
    first = np.array([(i < i[0]).sum() / (len(i) - 1) for i in ids if i is not None])
    assert first.mean() == pytest.approx(0.5, abs=5 * 0.3 / np.sqrt(len(first)))


def test_a_world_without_cones_gives_empty_frames() -> None:
    nothing = TruthMap(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0, np.int64))
    frames = run(without_false(CAMERA), 5, nothing)
    assert [len(f) for f in frames] == [0] * 5
