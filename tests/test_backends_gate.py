"""What the gate lets in, and under which reason everything else is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from conegraph.backends.gate import InputGate
from conegraph.config import GateConfig
from conegraph.types import Array, ConeObservations, VelocityObservation

CONFIG = GateConfig()
FINE_COV = 0.01 * np.eye(2)
EVEN = np.full(5, 0.2)
wild = st.floats(allow_nan=True, allow_infinity=True)
likely = st.one_of(wild, st.floats(-20, 20), st.floats(0, 1), st.floats(0, 1e-3))


def frame(
    xy: Array, cov: Array | None = None, prob: Array | None = None, stamp: float = 0.0
) -> ConeObservations:
    n = len(xy)
    return ConeObservations(
        stamp,
        xy,
        np.tile(FINE_COV, (n, 1, 1)) if cov is None else cov,
        np.tile(EVEN, (n, 1)) if prob is None else prob,
    )


FINE_XY = np.array([[5.0, 1.0], [8.0, -2.0], [3.0, 0.5]])


def passed(gate: InputGate, given_frame: ConeObservations) -> Array:
    """Return the positions of the cones that passed."""
    through = gate.cones(given_frame)
    assert through is not None
    return through.xy_m


def test_good_cones_pass_untouched() -> None:
    gate = InputGate(CONFIG)
    given_frame = frame(FINE_XY)
    through = gate.cones(given_frame)
    assert through is not None
    np.testing.assert_array_equal(through.xy_m, given_frame.xy_m)
    np.testing.assert_array_equal(through.cov_m2, given_frame.cov_m2)
    assert not gate.rejected
    empty = gate.cones(frame(np.zeros((0, 2)), stamp=1.0))
    assert empty is not None
    assert len(empty) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 1])
def test_positions_that_are_no_numbers(bad: float, axis: int) -> None:
    xy = FINE_XY.copy()
    xy[1, axis] = bad
    gate = InputGate(CONFIG)
    np.testing.assert_array_equal(passed(gate, frame(xy)), FINE_XY[[0, 2]])
    assert gate.rejected == {"cone: position is not a number": 1}


def test_ranges_between_the_nearest_and_the_farthest_pass() -> None:
    gate = InputGate(GateConfig(min_range_m=0.5, max_range_m=20.0))
    xy = np.array([[0.3, 0.39], [0.3, 0.41], [12.0, 15.9], [12.0, 16.1], [-9.0, 0.0]])
    np.testing.assert_array_equal(passed(gate, frame(xy)), xy[[1, 2, 4]])
    assert gate.rejected == {"cone: too near": 1, "cone: too far": 1}


@pytest.mark.parametrize(
    "cov",
    [
        np.zeros((2, 2)),
        -FINE_COV,
        np.diag([-1.0, -1e-20]),  # negative, with a positive determinant
        np.array([[0.01, 0.02], [0.02, 0.01]]),  # indefinite
        np.array([[0.01, 0.01], [0.01, 0.01]]),  # singular
        np.array([[0.01, 0.003], [0.0, 0.01]]),  # not symmetric
        np.array([[np.nan, 0.0], [0.0, 0.01]]),
        np.array([[0.01, np.nan], [np.nan, 0.01]]),
        np.array([[np.inf, 0.0], [0.0, 0.01]]),
        np.diag([0.01, 0.9e-8]),  # sigma below 1e-4 along one axis
        np.diag([2.1e6, 0.01]),  # sigma above 1e3
    ],
)
def test_covariances_that_cannot_be_used(cov: Array) -> None:
    gate = InputGate(CONFIG)
    all_cov = np.stack([FINE_COV, cov, FINE_COV])
    np.testing.assert_array_equal(
        passed(gate, frame(FINE_XY, all_cov)), FINE_XY[[0, 2]]
    )
    assert gate.rejected == {"cone: covariance unusable": 1}


@pytest.mark.parametrize(
    "prob",
    [
        [0.0] * 5,
        [np.nan, 0.5, 0.5, 0.0, 0.0],
        [-0.1, 0.5, 0.5, 0.0, 0.1],
        [np.inf, 0.0, 0.0, 0.0, 0.0],
    ],
)
def test_class_probabilities_that_cannot_be_used(prob: list[float]) -> None:
    gate = InputGate(CONFIG)
    probs = np.array([EVEN, prob, EVEN])
    np.testing.assert_array_equal(
        passed(gate, frame(FINE_XY, prob=probs)), FINE_XY[[0, 2]]
    )
    assert gate.rejected == {"cone: class probabilities unusable": 1}


def test_scores_that_are_none() -> None:
    gate = InputGate(CONFIG)
    scored = replace(frame(FINE_XY), score=np.array([0.4, np.nan, 1.2]))
    kept = gate.cones(scored)
    assert kept is not None
    np.testing.assert_array_equal(kept.evidence, [0.4])
    assert gate.rejected == {"cone: score unusable": 2}


def test_a_flood_of_cones_is_cut_off() -> None:
    gate = InputGate(GateConfig(max_cones=3))
    xy = np.tile(FINE_XY, (4, 1))
    np.testing.assert_array_equal(passed(gate, frame(xy)), FINE_XY)
    assert gate.rejected == {"cone: too many in one frame": 9}


def test_every_cone_is_counted_once() -> None:
    gate = InputGate(CONFIG)
    xy, cov = FINE_XY.copy(), np.tile(FINE_COV, (3, 1, 1))
    xy[0], cov[0] = np.nan, np.nan
    xy[1], cov[1] = 0.01, -1.0
    assert len(passed(gate, frame(xy, cov))) == 1
    assert gate.rejected == {
        "cone: position is not a number": 1,
        "cone: too near": 1,
    }


def test_one_stamp_far_ahead_is_left_out_and_a_pause_costs_one_frame() -> None:
    gate = InputGate(CONFIG)
    stamps = (1.0, 1e6, 1.1, 1.2, 500.0, 500.1, 500.2)
    passed = [gate.cones(frame(FINE_XY, stamp=s)) is not None for s in stamps]
    assert passed == [True, False, True, True, False, True, True]
    assert gate.rejected == {"frame: stamp leaps ahead": 2}


def test_after_a_pause_that_odometry_runs_through_no_frame_is_lost() -> None:
    gate = InputGate(CONFIG)
    assert gate.cones(frame(FINE_XY, stamp=1.0)) is not None
    for stamp in np.arange(1.0, 60.0, 0.5).tolist():
        assert gate.velocity(velocity(stamp)) is not None
    assert gate.cones(frame(FINE_XY, stamp=60.0)) is not None


def test_odometry_of_another_clock_vouches_for_no_frame() -> None:
    gate = InputGate(CONFIG)
    assert gate.velocity(velocity(1e9)) is not None
    stamps = (1.0, 1.1, 500.0, 1.2)
    passed = [gate.cones(frame(FINE_XY, stamp=s)) is not None for s in stamps]
    assert passed == [True, True, False, True]


def test_wrong_stamps_that_come_one_by_one_confirm_each_other_never() -> None:
    frames, samples = InputGate(CONFIG), InputGate(CONFIG)
    stamps = (1.0, 1e6, 1.1, 1e6 + 1.0, 1.2)
    seen = [frames.cones(frame(FINE_XY, stamp=s)) is not None for s in stamps]
    felt = [samples.velocity(velocity(s)) is not None for s in stamps]
    assert seen == felt == [True, False, True, False, True]


def test_stale_frames_are_dropped_and_do_not_move_the_clock() -> None:
    gate = InputGate(CONFIG)
    for stamp in (1.0, np.nan, np.inf, 1.0, 0.5, -np.inf, 1.5):
        gate.cones(frame(FINE_XY, stamp=stamp))
    assert gate.rejected == {
        "frame: stamp is not a number": 3,
        "frame: stamp does not increase": 2,
    }


def velocity(
    stamp: float = 1.0, u: float = 5.0, r: float = 0.1, cov: Array = FINE_COV
) -> VelocityObservation:
    return VelocityObservation(stamp, u, r, cov)


def test_good_velocities_pass_even_with_the_same_stamp() -> None:
    gate = InputGate(CONFIG)
    assert gate.velocity(velocity()) is not None
    assert gate.velocity(velocity(u=-5.0, r=-0.1)) is not None
    assert not gate.rejected


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (velocity(stamp=np.nan), "odometry: not a number"),
        (velocity(stamp=np.inf), "odometry: not a number"),
        (velocity(u=np.nan), "odometry: not a number"),
        (velocity(r=np.inf), "odometry: not a number"),
        (velocity(cov=np.full((2, 2), np.nan)), "odometry: not a number"),
        (velocity(stamp=0.9), "odometry: stamp goes backwards"),
        (velocity(u=60.1), "odometry: too fast"),
        (velocity(u=-60.1), "odometry: too fast"),
        (velocity(r=20.1), "odometry: turns too fast"),
        (velocity(cov=np.zeros((2, 2))), "odometry: covariance unusable"),
        (velocity(cov=np.diag([1.0, -1.0])), "odometry: covariance unusable"),
        (velocity(cov=1e-13 * np.eye(2)), "odometry: covariance unusable"),
        (velocity(cov=1e7 * np.eye(2)), "odometry: covariance unusable"),
        (
            velocity(cov=np.array([[1.0, 0.5], [0.0, 1.0]])),
            "odometry: covariance unusable",
        ),
    ],
)
def test_velocities_that_cannot_be_used(
    sample: VelocityObservation, reason: str
) -> None:
    gate = InputGate(CONFIG)
    gate.velocity(velocity())
    assert gate.velocity(sample) is None
    assert gate.rejected == {reason: 1}
    # The clock has not moved.
    assert gate.velocity(velocity()) is not None


@settings(deadline=None, max_examples=200)
@given(
    likely,
    st.integers(0, 4).flatmap(
        lambda n: st.tuples(
            arrays.arrays(np.float64, (n, 2), elements=likely),
            arrays.arrays(np.float64, (n, 2, 2), elements=likely),
            arrays.arrays(np.float64, (n, 5), elements=likely),
        )
    ),
    st.booleans(),
)
def test_whatever_comes_only_sane_cones_pass(
    stamp: float, rows: tuple[Array, Array, Array], symmetric: bool
) -> None:
    gate = InputGate(CONFIG)
    xy, cov, prob = rows
    if symmetric:
        cov = np.where([[True, True], [False, True]], cov, cov.transpose(0, 2, 1))
    through = gate.cones(ConeObservations(stamp, xy, cov, prob))
    if through is None:
        assert gate.rejected.total() == 1
        assert not np.isfinite(stamp)
        return
    assert len(through) + gate.rejected.total() == len(xy)
    for field in (through.xy_m, through.cov_m2, through.class_prob):
        assert np.isfinite(field).all()
    range_m = np.hypot(*through.xy_m.T)
    assert ((range_m >= CONFIG.min_range_m) & (range_m <= CONFIG.max_range_m)).all()
    symmetric_cov = 0.5 * (through.cov_m2 + through.cov_m2.transpose(0, 2, 1))
    np.linalg.cholesky(symmetric_cov)
    assert (through.class_prob >= 0).all()


@settings(deadline=None, max_examples=200)
@given(
    likely,
    likely,
    likely,
    arrays.arrays(np.float64, (2, 2), elements=likely),
    st.booleans(),
)
def test_whatever_comes_only_sane_velocities_pass(
    stamp: float, u: float, r: float, cov: Array, symmetric: bool
) -> None:
    gate = InputGate(CONFIG)
    if symmetric:
        cov = np.where([[True, True], [False, True]], cov, cov.T)
    through = gate.velocity(VelocityObservation(stamp, u, r, cov))
    assert (through is None) == (gate.rejected.total() == 1)
    if through is not None:
        assert np.isfinite([through.stamp_s, through.u_mps, through.r_radps]).all()
        assert abs(through.u_mps) <= CONFIG.max_speed_mps
        trace = np.trace(through.cov)
        assert abs(through.cov[0, 1] - through.cov[1, 0]) <= 1e-6 * trace
        np.linalg.cholesky(through.cov)
