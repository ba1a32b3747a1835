"""The batch optimum reaches its bound, and the bound is what can be derived."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conegraph.backends.factors import ORIGIN_SIGMAS
from conegraph.config import MotionConfig
from conegraph.eval.align import align_se2
from conegraph.eval.reference import (
    batch_optimum,
    causal_bound,
    cramer_rao,
    prefix_optima,
    without_rigid_motion,
)
from conegraph.eval.reference_graph import ReferenceGraph
from conegraph.geometry import compose, constant_twist, to_child, to_parent
from conegraph.types import (
    Array,
    ConeObservations,
    Event,
    Recording,
    SensorModel,
    Trajectory,
    TruthMap,
    VelocityObservation,
)

SENSOR = SensorModel(np.array([0.02, 0.0, 0.002]), 0.005, floor_m=0.01)
SPEED, TURN, BIAS_SIGMA = 5.0, 0.4, 0.01
ODOMETRY = np.diag([0.1, 0.02]) ** 2
MOTION = MotionConfig(slip_sigma_m_per_sqrt_m=0.0, gyro_bias_sigma_radps=BIAS_SIGMA)
CONES = TruthMap(
    np.arange(14) * 3,
    np.random.default_rng(5).uniform((-4, -8), (22, 20), (14, 2)),
    np.zeros(14, dtype=np.int64),
)


def drive(
    seed: int, *, frames: int = 40, noise: float = 1.0, odometry: bool = True
) -> Recording:
    """A car on a circle at 10 Hz, its noise drawn as the sensor's model has it."""
    rng = np.random.default_rng(seed)
    stamps = 0.1 * np.arange(float(frames))
    poses = np.array([constant_twist(SPEED, TURN, t) for t in stamps])
    events: list[Event] = []
    if odometry:
        bias = noise * BIAS_SIGMA * rng.standard_normal()
        read_at = 0.01 * np.arange(10.0 * frames)
        read = (SPEED, TURN + bias) + noise * rng.standard_normal(
            (len(read_at), 2)
        ) @ np.sqrt(ODOMETRY)
        events += [
            VelocityObservation(t, u, r, ODOMETRY)
            for t, (u, r) in zip(read_at.tolist(), read.tolist(), strict=True)
        ]
    for stamp, pose in zip(stamps.tolist(), poses, strict=True):
        there = to_child(pose, CONES.xy_m)
        near = np.hypot(*there.T) < 14.0
        xy = seen(there[near], noise, rng)
        prob = np.full((len(xy), 5), 0.2)
        cov = SENSOR.covariance(xy)
        events.append(ConeObservations(stamp, xy, cov, prob, CONES.id[near]))
    return Recording(
        "circle",
        tuple(sorted(events, key=lambda event: event.stamp_s)),
        sensor=SENSOR,
        truth_trajectory=Trajectory(stamps, poses),
        truth_map=CONES,
    )


def seen(there: Array, noise: float, rng: np.random.Generator) -> Array:
    c0, c1, c2 = SENSOR.range_sigma_m
    r = np.hypot(*there.T)
    bearing = np.arctan2(there[:, 1], there[:, 0])
    draw = noise * rng.standard_normal((4, len(r)))
    r = r + (c0 + r * (c1 + r * c2)) * draw[0]
    bearing = bearing + SENSOR.bearing_sigma_rad * draw[1]
    xy = np.column_stack([r * np.cos(bearing), r * np.sin(bearing)])
    return xy + SENSOR.floor_m * draw[2:].T


def one_frame() -> Recording:
    recording = drive(0, frames=1, noise=0.0, odometry=False)
    return replace(recording, name="one frame")


def test_the_bound_of_one_frame_in_closed_form() -> None:
    recording = one_frame()
    bound = cramer_rao(recording)
    (frame,) = (e for e in recording.stream if isinstance(e, ConeObservations))
    xy = CONES.xy_m[np.isin(CONES.id, bound.cone_id)]
    np.testing.assert_allclose(frame.xy_m, xy, atol=1e-12)
    # A cone is where the car is, plus what the sensor says: R + G S0 G'.
    n = len(xy)
    sensor = np.zeros((2 * n, 2 * n))
    for i, R in enumerate(SENSOR.covariance(xy)):
        sensor[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = R
    turn = np.column_stack([-xy[:, 1], xy[:, 0]]).ravel()
    G = np.column_stack([np.tile(np.eye(2), (n, 1)), turn])
    expected = sensor + G @ np.diag(ORIGIN_SIGMAS**2) @ G.T
    np.testing.assert_allclose(bound.cov_m2, expected, rtol=1e-6, atol=1e-12)
    assert bound.map_rmse_m == pytest.approx(np.sqrt(np.trace(expected) / n))
    # What the car's own doubt does to the map is a rigid motion: it aligns away.
    fitted = np.trace(without_rigid_motion(sensor, xy)) / n
    assert bound.map_rmse_aligned_m == pytest.approx(np.sqrt(fitted), rel=1e-6)
    assert bound.pose_rmse_m == pytest.approx(np.hypot(*ORIGIN_SIGMAS[:2]))


@given(st.integers(0, 2**32 - 1), st.integers(2, 30))
def test_alignment_takes_away_rigid_motions_and_three_degrees_of_freedom(
    seed: int, n: int
) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-50, 50, (n, 2))
    kept = without_rigid_motion(0.04 * np.eye(2 * n), xy)
    assert np.trace(kept) == pytest.approx(0.04 * (2 * n - 3))
    turn = np.column_stack([-xy[:, 1], xy[:, 0]]).ravel()
    for moved in (turn, np.tile([1.0, 0.0], n), np.tile([0.0, 1.0], n)):
        assert np.abs(kept @ moved).max() < 1e-9 * np.abs(moved).max()


def test_alignment_of_small_errors_is_the_projection() -> None:
    rng = np.random.default_rng(3)
    xy = rng.uniform(-20, 20, (9, 2))
    e = 1e-5 * rng.standard_normal((9, 2))
    projected = without_rigid_motion(np.outer(e.ravel(), e.ravel()), xy)
    mse = align_se2(xy + e, xy).rmse_m ** 2
    assert mse == pytest.approx(np.trace(projected) / 9, rel=1e-3)


@pytest.mark.parametrize("odometry", [True, False])
def test_without_noise_the_optimum_is_the_truth(odometry: bool) -> None:
    # Without odometry the prior that the car stands at the start, where this one
    # drives at 2.5 of its sigmas, pulls by some millimetres.
    limit_m = 1e-3 if odometry else 1e-2
    solution = batch_optimum(drive(0, noise=0.0, odometry=odometry), MOTION)
    assert solution.map_rmse_m() < limit_m
    assert solution.pose_rmse_m() < limit_m
    assert solution.map_rmse_aligned_m() <= solution.map_rmse_m()


def test_over_seeds_the_optimum_reaches_the_bound() -> None:
    seeds = 40
    bound = cramer_rao(drive(0, noise=0.0), MOTION)
    solutions = [batch_optimum(drive(seed), MOTION) for seed in range(seeds)]
    aligned = np.array([s.map_rmse_aligned_m() ** 2 for s in solutions])
    # A sum over seeds of squared errors has this mean and standard deviation.
    sigma = bound.aligned_mse_sigma_m2 / np.sqrt(seeds)
    assert abs(aligned.mean() - bound.map_rmse_aligned_m**2) < 3.0 * sigma
    # A cone's and a pose's squared error have at most twice their square as variance.
    spread = 3.0 * np.sqrt(2.0 / seeds)
    whole = np.mean([s.map_rmse_m() ** 2 for s in solutions]) / bound.map_rmse_m**2
    path = np.mean([s.pose_rmse_m() ** 2 for s in solutions]) / bound.pose_rmse_m**2
    assert 1.0 - spread < whole < 1.0 + spread
    assert 1.0 - spread < path < 1.0 + spread


def test_a_prefix_knows_nothing_of_what_comes_later() -> None:
    recording = drive(7)
    early = [e for e in recording.stream if e.stamp_s <= 2.0]
    alone = batch_optimum(replace(recording, stream=tuple(early)), MOTION)
    prefix, whole = prefix_optima(recording, (2.0, np.inf), MOTION)
    np.testing.assert_array_equal(prefix.cone_id, alone.cone_id)
    np.testing.assert_allclose(prefix.xy_m, alone.xy_m, atol=1e-9)
    np.testing.assert_allclose(prefix.path.pose, alone.path.pose, atol=1e-9)
    assert prefix.path.stamp_s[-1] == pytest.approx(2.0)
    assert len(whole.path) == 40


def test_without_cones_the_causal_bound_is_the_wheels_own() -> None:
    """Straight on without slip or bias: ``s_u^2 D t`` ahead, a turn's share aside."""
    recording = drive(1, frames=21)
    driven = recording.truth_trajectory
    assert driven is not None
    blind = replace(
        recording,
        stream=tuple(
            e.subset(np.zeros(0, dtype=np.int64))
            if isinstance(e, ConeObservations)
            else replace(e, r_radps=0.0)
            for e in recording.stream
        ),
        truth_trajectory=Trajectory(
            driven.stamp_s, np.outer(driven.stamp_s, [SPEED, 0.0, 0.0])
        ),
    )
    motion = MOTION.model_copy(update={"gyro_bias_sigma_radps": 0.0})
    stamp_s, bound_m = causal_bound(blind, 2, motion)
    np.testing.assert_allclose(stamp_s, [1.0, 2.0])
    white = np.diag(ODOMETRY) * 0.01
    ahead = white[0] * stamp_s
    aside = white[1] * SPEED**2 * stamp_s**3 / 3.0
    start = ORIGIN_SIGMAS[0] ** 2 * 2 + (ORIGIN_SIGMAS[2] * SPEED * stamp_s) ** 2
    np.testing.assert_allclose(bound_m**2, ahead + aside + start, rtol=0.02)


def test_what_comes_later_lowers_the_bound_of_all_but_the_last_pose() -> None:
    recording = drive(2)
    _, causal_m = causal_bound(recording, 39, MOTION)
    _, _, smoothed_m2 = ReferenceGraph(recording, MOTION).covariances()
    assert (causal_m[:-1] ** 2 > smoothed_m2[1:-1]).all()
    assert causal_m[-1] ** 2 == pytest.approx(smoothed_m2[-1], rel=1e-6)


def test_errors_over_chosen_cones_and_from_any_world() -> None:
    recording = drive(2)
    solution = batch_optimum(recording, MOTION)
    few = solution.cone_id[:4]
    expected = align_se2(solution.xy_m[:4], solution.true_xy_m[:4]).rmse_m
    assert solution.map_rmse_aligned_m(few) == expected
    # The truth may come in a frame of its own: it is seen from the first pose.
    away = np.array([100.0, -30.0, 2.0])
    path, cones = recording.truth_trajectory, recording.truth_map
    assert path is not None
    assert cones is not None
    elsewhere = replace(
        recording,
        truth_trajectory=Trajectory(path.stamp_s, compose(away, path.pose)),
        truth_map=replace(cones, xy_m=to_parent(away, cones.xy_m)),
    )
    again = batch_optimum(elsewhere, MOTION)
    np.testing.assert_allclose(again.xy_m, solution.xy_m, atol=1e-7)


def test_no_reference_without_truth_or_sensor() -> None:
    recording = drive(0, frames=3)
    for broken in (
        replace(recording, truth_map=None),
        replace(recording, truth_trajectory=None),
        replace(recording, sensor=None),
        replace(recording, stream=()),
    ):
        with pytest.raises(ValueError, match="circle"):
            batch_optimum(broken)
