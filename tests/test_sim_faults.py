"""Faults come as often as asked, and each leaves the others' streams alone."""

from __future__ import annotations

import numpy as np

from conegraph.sim.cone_sensor import CAMERA
from conegraph.sim.faults import StreamFaults, with_faults
from conegraph.sim.track_shapes import HALF_LANE_M
from conegraph.sources import parse_sim_query, simulate_track
from conegraph.types import Array, ConeClass, ConeObservations

FRAMES, CONES = 400, 10


def frames() -> list[ConeObservations]:
    rng = np.random.default_rng(1)
    prob = np.full((CONES, 5), 0.025)
    prob[np.arange(CONES), np.arange(CONES) % 4] = 0.9
    cov = np.tile(0.01 * np.eye(2), (CONES, 1, 1))
    return [
        ConeObservations(
            k / 10, rng.normal(size=(CONES, 2)), cov, prob, np.arange(CONES)
        )
        for k in range(FRAMES)
    ]


def spoiled(faults: StreamFaults, seed: int = 0) -> list[ConeObservations]:
    return with_faults(frames(), faults, CAMERA, np.random.default_rng(seed))


def classes(stream: list[ConeObservations]) -> Array:
    named = np.concatenate([f.class_prob.argmax(axis=1) for f in stream])
    return named.astype(np.float64)


def near(share: float, expected: float, count: int) -> bool:
    return abs(share - expected) < 4 * float(np.sqrt(expected * (1 - expected) / count))


def test_nothing_is_changed_without_faults() -> None:
    for before, after in zip(frames(), spoiled(StreamFaults()), strict=True):
        np.testing.assert_array_equal(before.xy_m, after.xy_m)
        np.testing.assert_array_equal(before.class_prob, after.class_prob)


def test_colours_fail_as_often_as_asked_and_move_nothing() -> None:
    stream = spoiled(StreamFaults(wrong_colour=0.1, unknown_colour=0.2))
    before, after = classes(frames()), classes(stream)
    n = FRAMES * CONES
    unknown = after == ConeClass.UNKNOWN
    assert near(unknown.mean(), 0.2, n)
    assert near(((after != before) & ~unknown).mean(), 0.1, n)
    for a, b in zip(frames(), stream, strict=True):
        np.testing.assert_array_equal(a.xy_m, b.xy_m)
    np.testing.assert_allclose(np.vstack([f.class_prob for f in stream]).sum(axis=1), 1)


def test_cones_are_missed_as_often_as_asked() -> None:
    stream = spoiled(StreamFaults(missed=0.3))
    kept = sum(len(f) for f in stream) / (FRAMES * CONES)
    assert near(kept, 0.7, FRAMES * CONES)


def test_false_cones_come_for_each_that_there_was() -> None:
    stream = spoiled(StreamFaults(false_cones=0.05))
    ids = np.concatenate([f.truth_id for f in stream if f.truth_id is not None])
    false = int((ids < 0).sum())
    # Poisson: its variance is its mean.
    expected = 0.05 * FRAMES * CONES
    assert abs(false - expected) < 4 * np.sqrt(expected)
    assert (ids >= 0).sum() == FRAMES * CONES
    xy = np.concatenate([f.xy_m for f in stream])[ids < 0]
    far = np.hypot(*xy.T)
    assert far.max() <= CAMERA.model.max_range_m


def test_one_fault_does_not_change_the_draws_of_another() -> None:
    alone = spoiled(StreamFaults(missed=0.3))
    both = spoiled(StreamFaults(missed=0.3, wrong_colour=0.5))
    for a, b in zip(alone, both, strict=True):
        np.testing.assert_array_equal(a.xy_m, b.xy_m)


def test_noise_is_as_much_larger_as_asked() -> None:
    stream = spoiled(StreamFaults(noise_scale=3.0))
    added = np.vstack([b.xy_m - a.xy_m for a, b in zip(frames(), stream, strict=True)])
    cov = np.concatenate([f.cov_m2 for f in stream])
    white = np.linalg.solve(np.linalg.cholesky(cov), added[..., None])
    # What was there has the covariance once, so that eight times it is missing.
    np.testing.assert_allclose(white.var(), 8.0, rtol=4 * np.sqrt(1 / white.size))
    np.testing.assert_array_equal(cov, np.concatenate([f.cov_m2 for f in frames()]))


def test_calibration_turns_and_stretches_what_is_seen() -> None:
    stream = spoiled(StreamFaults(range_scale=1.05, sensor_yaw_rad=0.1))
    before = np.vstack([f.xy_m for f in frames()]) @ [1, 1j]
    after = np.vstack([f.xy_m for f in stream]) @ [1, 1j]
    np.testing.assert_allclose(after, before * 1.05 * np.exp(0.1j), rtol=1e-12)


def test_stamps_are_late_by_what_is_asked() -> None:
    stream = spoiled(StreamFaults(stamp_offset_s=0.2))
    late = [b.stamp_s - a.stamp_s for a, b in zip(frames(), stream, strict=True)]
    np.testing.assert_allclose(late, 0.2)


def test_the_start_is_hidden_and_another_one_painted_half_a_lap_on() -> None:
    faults = "hide_start=1&false_start=1"
    plain, spoilt = (
        simulate_track("oval", parse_sim_query(f"laps=1&{query}"))
        for query in ("", faults)
    )
    assert plain.truth_map is not None
    assert spoilt.truth_map is not None
    orange = spoilt.truth_map.cone_class == ConeClass.BIG_ORANGE
    was_orange = plain.truth_map.cone_class == ConeClass.BIG_ORANGE
    false = np.flatnonzero(orange & ~was_orange)
    assert len(false) == 2
    a, b = spoilt.truth_map.xy_m[false]
    assert np.hypot(*(a - b)) < 2 * 2 * HALF_LANE_M
    start = plain.truth_map.xy_m[was_orange].mean(axis=0)
    extent = np.ptp(plain.truth_map.xy_m, axis=0).max()
    assert np.hypot(*(0.5 * (a + b) - start)) > 0.4 * extent
    seen = np.concatenate(
        [e.truth_id for e in spoilt.events() if isinstance(e, ConeObservations)]
    )
    assert not np.isin(seen, np.flatnonzero(orange)).any()
    assert set(seen.tolist()) - {-1} == set(np.flatnonzero(~orange).tolist())
