"""Faults come as often as asked, and each leaves the others' streams alone."""

from __future__ import annotations

import numpy as np

from conegraph.sim.cone_sensor import CAMERA
from conegraph.sim.faults import StreamFaults, with_faults
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
