"""The graph: exact worlds come out exact, wrong closures go, wrecks are rebuilt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from conegraph.backends.mapper import Mapper
from conegraph.backends.motion import OdometryIncrement
from conegraph.backends.reviewer import LOOP_D2
from conegraph.backends.snapshot import PINNED, take_snapshot
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.config import Isam2Config, MotionConfig
from conegraph.geometry import between, compose, constant_twist, rotation, to_child
from conegraph.types import Array, ConeMap, IntArray, Trajectory

CONFIG = Isam2Config()
MOTION = MotionConfig()
NO_BIAS = MotionConfig(gyro_bias_sigma_radps=0.0)
SIGMA_M = 0.05
CONES = np.array([[3.0 * (i // 2), 1.8 * (-1) ** i] for i in range(2, 16)])


def settled(mapper: Mapper) -> Trajectory:
    path, _ = mapper.settle(polish=True)
    assert path is not None
    return path


def path(n: int, speed: float = 5.0, rate: float = 0.1, dt_s: float = 0.1) -> Array:
    """Return true poses (n, 3) of a car that holds its velocities."""
    return np.array([constant_twist(speed, rate, dt_s * k) for k in range(n)])


def frame(
    k: int,
    poses: Array,
    ids: Sequence[int] | IntArray,
    *,
    guess: Array | None = None,
    seen: Array | None = None,
    odometry: bool = True,
    closure: bool = False,
    merged: tuple[tuple[int, int], ...] = (),
) -> TrackedFrame:
    """Return frame k as a tracker would hand it on, measured without error."""
    index = np.asarray(ids, dtype=np.int64)
    increment = None
    if odometry and k:
        step = between(poses[k - 1], poses[k])
        increment = OdometryIncrement(
            0.1,
            step,
            np.diag([1e-4, 1e-4, 1e-6]),
            np.array([0.0, -0.025, -0.1]),
            np.array([5.0, 0.1]),
            1e-2 * np.eye(2),
        )
    n = len(index)
    return TrackedFrame(
        stamp_s=0.1 * k,
        increment=increment,
        state=np.array([*(poses[k] if guess is None else guess), 5.0, 0.1, 0.0]),
        speed_cov=np.eye(2),
        landmark_id=index,
        row=np.arange(n),
        xy_m=to_child(poses[k], CONES[index % len(CONES)]) if seen is None else seen,
        cov_m2=np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1)),
        reported_m2=np.tile(SIGMA_M**2 * np.eye(2), (n, 1, 1)),
        vague=np.zeros(n, dtype=bool),
        closure=closure,
        merged=merged,
    )


def ahead(pose: Array) -> IntArray:
    """Return the cones that lie 0 to 9 m ahead of a pose."""
    x = to_child(pose, CONES)[:, 0]
    near: IntArray = np.flatnonzero((x > 0.0) & (x < 9.0)).astype(np.int64)
    return near


def drive(mapper: Mapper, n: int, *, odometry: bool = True, seed: int = 0) -> Array:
    """Feed n frames whose poses the tracker has wrong by decimetres; return truth."""
    rng = np.random.default_rng(seed)
    poses = path(n)
    frames = []
    for k in range(n):
        wrong = poses[k] + (0.0 if k == 0 else rng.normal(size=3) * [0.1, 0.1, 0.02])
        frames.append(frame(k, poses, ahead(poses[k]), guess=wrong, odometry=odometry))
    for at in range(0, n, 5):
        assert mapper.update(frames[at : at + 5]) == []
    return poses


def mapped(mapper: Mapper) -> Array:
    return np.array([mapper.cone_m(c) for c in sorted(mapper.cones)])


@pytest.mark.parametrize("motion", [MOTION, NO_BIAS])
@pytest.mark.parametrize("odometry", [True, False])
def test_a_world_measured_without_error_comes_out_exact(
    motion: MotionConfig, odometry: bool
) -> None:
    mapper = Mapper(CONFIG, motion)
    poses = drive(mapper, 30, odometry=odometry)
    trajectory = settled(mapper)
    np.testing.assert_allclose(trajectory.stamp_s, 0.1 * np.arange(30))
    np.testing.assert_allclose(trajectory.pose, poses, atol=1e-3)
    np.testing.assert_allclose(mapped(mapper), CONES, atol=2e-3)
    assert mapper.rebuilt == 0
    moving = sum(entry.moving or entry.k == 0 for entry in mapper.journal.entries)
    assert moving == (1 if odometry else 30)


def test_a_cone_seen_from_a_known_place_has_its_sensor_s_covariance() -> None:
    mapper = Mapper(CONFIG, NO_BIAS)
    poses = path(2)
    mapper.update([frame(0, poses, [2])])
    # One sight from the origin, which is sure to a millimetre and 0.1 mrad.
    got = mapper.cone_cov_m2(2)
    np.testing.assert_allclose(got, SIGMA_M**2 * np.eye(2), rtol=1e-2, atol=1e-5)
    # n sights more from there divide it by n + 1.
    mapper = Mapper(CONFIG, NO_BIAS)
    still = np.zeros((5, 3))
    mapper.update([frame(k, still, [2]) for k in range(1)])
    mapper.update([frame(k, still, [2]) for k in range(1, 5)])
    got = mapper.cone_cov_m2(2)
    # Its steps are as sure as odometry says, 1 cm each: it does a little worse.
    assert SIGMA_M**2 / 5 < got[0, 0] < SIGMA_M**2 / 4


def test_a_known_map_holds_the_car() -> None:
    ids = np.arange(len(CONES))
    known = ConeMap(
        ids,
        CONES,
        np.tile(1e-4 * np.eye(2), (len(ids), 1, 1)),
        np.full((len(ids), 5), 0.2),
        ids,
    )
    mapper = Mapper(CONFIG, MOTION, known)
    offset = np.array([0.3, -0.2, 0.05])
    poses = np.array([compose(offset, p) for p in path(10)])
    mapper.update(
        [frame(k, poses, ahead(poses[k]), guess=path(10)[k]) for k in range(10)]
    )
    got = settled(mapper).pose
    # The prior of half a metre is nothing beside six cones of 5 cm.
    np.testing.assert_allclose(got, poses, atol=0.02)
    np.testing.assert_allclose(mapped(mapper), CONES, atol=0.01)


def test_two_ids_of_one_cone_are_drawn_together() -> None:
    mapper = Mapper(CONFIG, NO_BIAS)
    poses = path(3)
    twin = 2 + len(CONES)
    first = frame(0, poses, [2, 3])
    seen = to_child(poses[1], CONES[[2, 3]] + np.array([[0.1, 0.0], [0.0, 0.0]]))
    mapper.update([first, frame(1, poses, [twin, 3], seen=seen)])
    assert np.linalg.norm(mapper.cone_m(2) - mapper.cone_m(twin)) > 0.05
    mapper.update([frame(2, poses, [3], merged=((2, twin),))])
    assert np.linalg.norm(mapper.cone_m(2) - mapper.cone_m(twin)) < 0.005


def wrong_closure(poses: Array, k: int) -> TrackedFrame:
    """Return frame k, which takes the cones ahead for cones of the start."""
    ids = ahead(poses[k])
    taken_for = ids - ids.min()
    seen = to_child(poses[k], CONES[ids]) @ rotation(0.4).T + [3.0, 2.0]
    return frame(k, poses, taken_for, seen=seen, closure=True)


@pytest.mark.parametrize("kernel", ["cauchy", "none"])
def test_a_wrong_closure_is_undone_and_leaves_no_trace(kernel: str) -> None:
    config = Isam2Config(robust_kernel="cauchy" if kernel == "cauchy" else "none")
    poses = path(31)
    maps, paths = [], []
    for wrong in (True, False):
        mapper = Mapper(config, NO_BIAS)
        drive(mapper, 30)
        last = wrong_closure(poses, 30) if wrong else frame(30, poses, [])
        undone = mapper.update([last])
        assert len(undone) == wrong
        if wrong:
            assert undone[0].stamp_s == pytest.approx(3.0)
            assert np.median(undone[0].d2) > LOOP_D2
        paths.append(settled(mapper).pose)
        maps.append(mapped(mapper))
    np.testing.assert_allclose(maps[0], maps[1], atol=1e-3)
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-3)


def test_sightings_beside_a_wrong_closure_are_tested_once_it_is_undone() -> None:
    """They come in one update, so that all are tested while it bends the graph."""
    poses = path(31)
    frames = [frame(k, poses, ahead(poses[k])) for k in range(30)]
    mapper = Mapper(Isam2Config(robust_kernel="none"), NO_BIAS)
    undone = mapper.update([*frames, wrong_closure(poses, 30)])
    assert [revision.stamp_s for revision in undone] == pytest.approx([3.0])


def test_a_right_closure_stays_and_pulls() -> None:
    mapper = Mapper(CONFIG, NO_BIAS)
    poses = drive(mapper, 30)
    poses = np.vstack([poses, path(31)[30]])
    seen = to_child(poses[30], CONES[[0, 1, 2, 3]])
    undone = mapper.update([frame(30, poses, [0, 1, 2, 3], seen=seen, closure=True)])
    assert undone == []
    np.testing.assert_allclose(mapper.pose(30), poses[30], atol=5e-3)


def test_a_solver_that_cannot_be_used_any_more_is_rebuilt() -> None:
    mapper = Mapper(CONFIG, NO_BIAS)
    poses = np.vstack([drive(mapper, 20), path(23)[20:]])
    poison = np.full((2, 2), np.nan)
    ids = ahead(poses[20])[:2]
    mapper.update([frame(20, poses, ids, seen=poison)])
    assert mapper.rebuilt >= 1
    mapper.update([frame(k, poses, ahead(poses[k])) for k in (21, 22)])
    np.testing.assert_allclose(settled(mapper).pose, poses, atol=5e-3)


def test_a_snapshot_is_the_graph_as_seen_from_the_pose() -> None:
    mapper = Mapper(CONFIG, MOTION)
    poses = drive(mapper, 20)
    shot = take_snapshot(mapper, 8.0)
    assert shot.k == 19
    seen = sorted({c for pose in poses for c in ahead(pose).tolist()})
    near = np.linalg.norm(CONES[seen] - poses[-1, :2], axis=1) < 8.0
    assert sorted(shot.all_ids.tolist()) == seen
    assert sorted(shot.ids.tolist()) == np.array(seen)[near].tolist()
    np.testing.assert_allclose(shot.state[:3], mapper.pose(19))
    np.testing.assert_allclose(
        shot.state[6:].reshape(-1, 2), CONES[shot.ids], atol=5e-3
    )
    np.testing.assert_allclose(shot.cov, shot.cov.T, atol=1e-12)
    assert np.linalg.eigvalsh(shot.cov)[0] > -1e-12
    np.testing.assert_array_equal(np.diag(shot.cov)[:3], PINNED)
    assert not shot.cov[:3, 3:].any()
    # No velocities in the graph while odometry spans it: the tracker's stay.
    np.testing.assert_array_equal(shot.cov[3:5, 3:5], np.eye(2))
    assert np.linalg.eigvalsh(shot.pose_cov)[0] > 0.0


def test_a_snapshot_shows_old_cones_through_all_the_drift() -> None:
    """One cone is seen in the first frame only, another in the last frame only."""
    mapper, poses, last = Mapper(CONFIG, NO_BIAS), path(31, rate=0.0), 30
    cones = {0: np.array([4.0, 1.5]), 1: poses[last, :2] + [4.0, 1.5]}
    for k in range(last + 1):
        shown = {0: [0], last: [1]}.get(k, [])
        seen = np.array([cones[c] for c in shown]).reshape(-1, 2)
        mapper.update([frame(k, poses, shown, seen=to_child(poses[k], seen))])
    shot = take_snapshot(mapper, 30.0)
    noise = SIGMA_M**2 * np.eye(2)
    # Straight on, n steps of d: heading n q, aside q d^2 (1 + 4 + … + (n-1)^2) + n q_y.
    step, q, q_xy = 0.5, 1e-6, 1e-4
    n = np.arange(float(last))
    heading, aside = last * q, q * step**2 * (n**2).sum() + last * q_xy
    both = q * step * n.sum()
    drift = np.array([[last * q_xy, 0, 0], [0, aside, both], [0, both, heading]])
    away = cones[0] - poses[last, :2]
    by_pose = np.array([[-1.0, 0.0, away[1]], [0.0, -1.0, -away[0]]])
    old, new = (
        shot.cov[6 + 2 * i : 8 + 2 * i, 6 + 2 * i : 8 + 2 * i]
        for i in (shot.ids.tolist().index(c) for c in (0, 1))
    )
    # The start's own doubt is in the cone too, where it cancels.
    np.testing.assert_allclose(
        old, by_pose @ drift @ by_pose.T + noise, rtol=1e-3, atol=1e-7
    )
    np.testing.assert_allclose(new, noise, rtol=1e-3, atol=1e-7)


def test_a_biased_lap_is_straightened_by_the_final_solution() -> None:
    # A circle of 300 steps of a metre in 30 s. The yaw rate reads 0.01 rad/s too
    # much, so the tracker's path turns 0.3 rad too far; then the first cones again.
    n, bias = 300, 0.01
    true = path(n + 1, speed=10.0, rate=2.0 * np.pi / 30.0)
    read = path(n + 1, speed=10.0, rate=2.0 * np.pi / 30.0 + bias)
    first = np.array([[4.0, 2.0], [4.0, -2.0], [7.0, 2.0], [7.0, -2.0]])
    frames = []
    for k in range(n + 1):
        seen = k in (0, n)
        plain = frame(k, true, [0, 1, 2, 3] if seen else [], guess=read[k])
        increment = None
        if k:
            increment = OdometryIncrement(
                0.1,
                between(read[k - 1], read[k]),
                np.diag([1e-4, 1e-4, 1e-6]),
                np.array([0.0, -0.05, -0.1]),
                np.array([10.0, 0.2]),
                1e-2 * np.eye(2),
            )
        xy = to_child(true[k], first) if seen else plain.xy_m
        found = np.full(len(xy), k == n)
        frames.append(replace(plain, increment=increment, xy_m=xy, vague=found))
    mapper = Mapper(CONFIG, MOTION)
    mapper.update(frames)
    gap = settled(mapper).pose[:, :2] - true[:, :2]
    # Linearised once, where the tracker was, the path is 0.3 m off; what is left is
    # what the prior and the walk of the bias allow it to bend.
    assert np.hypot(gap[:, 0], gap[:, 1]).max() < 0.05
