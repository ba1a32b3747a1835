"""The graph over many laps: bounded, doubted, and in a process of its own."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from conegraph.backends.isam2 import Isam2Backend
from conegraph.backends.journal import Journal
from conegraph.backends.mapper import KEEP, SUM_UP_EVERY, Mapper
from conegraph.backends.mapping import InlineMapping, Mapped, map_frames
from conegraph.backends.mapping_process import ProcessMapping
from conegraph.backends.motion import OdometryIncrement
from conegraph.backends.tracked_frame import TrackedFrame, Unclaimed
from conegraph.config import Isam2Config, MotionConfig, load_config
from conegraph.eval.align import align_se2
from conegraph.geometry import between, constant_twist, rotation, to_child, to_parent
from conegraph.pipeline import for_source
from conegraph.sources import open_source
from conegraph.types import (
    Array,
    ConeMap,
    Mask,
    MatchStatus,
    Revision,
    SensorModel,
    VelocityObservation,
)

SIGMA_M = 0.05
ROUND = SensorModel(np.zeros(3), 0.0, floor_m=SIGMA_M)
MOTION = MotionConfig(gyro_bias_sigma_radps=0.0)
LAP = 160
DT_S = 0.1
SPEED_MPS, RATE_RADPS = 8.0, 2.0 * np.pi / (LAP * DT_S)
RADIUS_M = SPEED_MPS / RATE_RADPS
ANGLE = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
CONES = np.concatenate(
    [
        [[r * np.sin(a), RADIUS_M - r * np.cos(a)] for a in ANGLE]
        for r in (RADIUS_M - 1.5, RADIUS_M + 1.5)
    ]
)


def ring(laps: int, seed: int = 0) -> list[TrackedFrame]:
    """Return frames of a car that drives a circle and sees the cones ahead."""
    rng = np.random.default_rng(seed)
    n = laps * LAP + 20
    poses = np.array(
        [constant_twist(SPEED_MPS, RATE_RADPS, DT_S * k) for k in range(n)]
    )
    frames = []
    for k in range(n):
        seen = to_child(poses[k], CONES)
        ids = np.flatnonzero((seen[:, 0] > 0) & (np.hypot(*seen.T) < 9.0))
        increment = None
        if k:
            noise = rng.normal(size=3) * [0.01, 0.01, 0.001]
            increment = OdometryIncrement(
                DT_S,
                between(poses[k - 1], poses[k]) + noise,
                np.diag([1e-4, 1e-4, 1e-6]),
                np.zeros(3),
                np.array([SPEED_MPS, RATE_RADPS]),
                1e-4 * np.eye(2),
            )
        wrong = poses[k] + (rng.normal(size=3) * [0.05, 0.05, 0.01] if k else 0.0)
        frames.append(
            TrackedFrame(
                stamp_s=DT_S * k,
                increment=increment,
                state=np.array([*wrong, SPEED_MPS, RATE_RADPS, 0.0]),
                speed_cov=1e-2 * np.eye(2),
                landmark_id=ids,
                row=np.arange(len(ids)),
                xy_m=seen[ids] + rng.normal(size=(len(ids), 2)) * SIGMA_M,
                cov_m2=np.tile(SIGMA_M**2 * np.eye(2), (len(ids), 1, 1)),
                reported_m2=np.tile(SIGMA_M**2 * np.eye(2), (len(ids), 1, 1)),
                vague=np.zeros(len(ids), dtype=bool),
            )
        )
    return frames


def feed(mapper: Mapper, frames: list[TrackedFrame]) -> list[Revision]:
    taken = []
    for at in range(0, len(frames), 4):
        taken += mapper.update(frames[at : at + 4])
    return taken


def mapped(mapper: Mapper) -> Array:
    return np.array([mapper.cone_m(c) for c in range(len(CONES))])


def aligned_rms(mapper: Mapper) -> float:
    return align_se2(mapped(mapper), CONES).rmse_m


def test_summing_up_old_poses_costs_no_accuracy_and_bounds_the_window() -> None:
    frames = ring(5)
    exact, bounded = (Mapper(Isam2Config(bounded=b), MOTION) for b in (False, True))
    feed(exact, frames)
    assert len(exact.window) == len(frames)
    longest = 0
    for at in range(0, len(frames), 4):
        bounded.update(frames[at : at + 4])
        longest = max(longest, len(bounded.window))
    # An open loop, two seconds of frames, may delay it; frames come four at a time.
    assert longest <= KEEP + SUM_UP_EVERY + 2.0 / DT_S + 4
    # What is summed up is linear for good: it may cost a few per cent, as long as it
    # is linear where the window had converged.
    assert aligned_rms(bounded) < 1.03 * aligned_rms(exact)
    for cone in (0, 40, 79):
        ratio = np.trace(bounded.cone_cov_m2(cone)) / np.trace(exact.cone_cov_m2(cone))
        assert ratio == pytest.approx(1.0, abs=0.05)


def test_the_final_solution_is_that_of_the_whole_journal() -> None:
    frames = ring(4)
    paths, maps = [], []
    for bounded in (False, True):
        mapper = Mapper(Isam2Config(bounded=bounded), MOTION)
        feed(mapper, frames)
        path, _ = mapper.settle(polish=True)
        assert path is not None
        assert len(path) == len(frames)
        paths.append(path.pose)
        maps.append(mapped(mapper))
    np.testing.assert_allclose(maps[0], maps[1], atol=1e-4)
    np.testing.assert_allclose(paths[0], paths[1], atol=2e-4)


def ring_with_a_wrong_sighting(k: int, i: int) -> list[TrackedFrame]:
    """Return a lap in which sighting i of frame k is off by two metres."""
    frames = ring(1)
    xy = frames[k].xy_m.copy()
    xy[i] += [0.0, 2.0]
    frames[k] = replace(frames[k], xy_m=xy)
    return frames


def test_a_wrong_sighting_is_taken_back_a_second_later() -> None:
    k, i = 60, 2
    frames = ring_with_a_wrong_sighting(k, i)
    cone = int(frames[k].landmark_id[i])
    mapper = Mapper(Isam2Config(), MOTION)
    early = feed(mapper, frames[: k + 8])
    assert early == []
    taken = feed(mapper, frames[k + 8 : k + 20])
    assert [r.stamp_s for r in taken] == [pytest.approx(DT_S * k)]
    assert taken[0].observation.tolist() == [i]
    assert taken[0].landmark_id.tolist() == [cone]
    # Two metres are 40 sigmas; the pose and the cone take a part of them.
    assert 0.5 * 40**2 < taken[0].d2[0] < 1.1 * 40**2


def test_a_loop_that_was_undone_does_not_bound_the_window() -> None:
    frames, k = ring(1)[:120], 60
    taken_for = frames[0].landmark_id
    few = np.arange(len(frames[k].landmark_id)) < len(taken_for)
    wrong = frames[k].xy_m[few] @ rotation(0.4).T + [3.0, 2.0]
    frames[k] = replace(
        frames[k],
        landmark_id=taken_for[: few.sum()],
        row=np.arange(few.sum()),
        xy_m=wrong,
        cov_m2=frames[k].cov_m2[few],
        reported_m2=frames[k].reported_m2[few],
        vague=np.zeros(few.sum(), dtype=bool),
        closure=True,
    )
    mapper = Mapper(Isam2Config(), MOTION)
    (undone,) = feed(mapper, frames)
    assert undone.closure
    assert len(mapper.window) == len(frames) > KEEP


def test_one_wrong_sighting_in_the_frame_that_closed_a_loop_undoes_no_loop() -> None:
    frames, k = ring(1), LAP + 10
    xy = frames[k].xy_m.copy()
    xy[0] += [0.0, 2.0]
    frames[k] = replace(frames[k], xy_m=xy, closure=True)
    mapper = Mapper(Isam2Config(), MOTION)
    (taken,) = feed(mapper, frames) + mapper.settle(polish=True)[1]
    assert taken.observation.tolist() == [0]
    assert not taken.closure


def test_a_given_map_holds_a_cone_whose_only_sighting_is_wrong() -> None:
    ids = np.arange(len(CONES))
    cov, prob = np.tile(1e-4 * np.eye(2), (len(ids), 1, 1)), np.eye(5)[ids % 4]
    known = ConeMap(ids, CONES, cov, prob, np.full(len(ids), 9))
    frames, k = ring(1)[:60], 20
    behind = len(CONES) // 2 - 1
    assert not any(behind in f.landmark_id for f in frames)
    mistaken = frames[k].landmark_id.copy()
    mistaken[0] = behind
    frames[k] = replace(frames[k], landmark_id=mistaken)
    mapper = Mapper(Isam2Config(), MOTION, known)
    taken = feed(mapper, frames) + mapper.settle(polish=True)[1]
    assert [r.landmark_id.tolist() for r in taken] == [[behind]]
    np.testing.assert_allclose(mapper.cone_m(behind), CONES[behind], atol=1e-6)


def test_the_last_sighting_of_a_cone_is_never_taken_back() -> None:
    journal, frames = Journal(), ring(1)
    entry = journal.append(frames[0])
    one = np.array([0], dtype=np.int64)
    assert journal.retract(entry, one, np.array([99.0])) == []
    assert entry.kept.all()
    again = journal.append(frames[1])
    shared = np.flatnonzero(np.isin(again.frame.landmark_id, entry.cones))[:1]
    assert len(journal.retract(again, shared, np.array([99.0]))) == 1
    assert again.kept.sum() == len(again.frame.landmark_id) - 1


def wait_for(mapping: ProcessMapping) -> Mapped | None:
    until_s = time.monotonic() + 60.0
    while mapping.busy and time.monotonic() < until_s:
        time.sleep(0.005)
    return mapping.poll()


def test_a_process_maps_the_same_as_its_parent_would() -> None:
    frames, config = ring(1)[:60], Isam2Config()
    inline = InlineMapping(Mapper(config, MOTION), 30.0)
    process = ProcessMapping(config, MOTION, None, None, 30.0)
    for at in range(0, len(frames), 20):
        batch = frames[at : at + 20]
        process.submit(batch)
        inline.submit(batch)
        ours, theirs = inline.poll(), wait_for(process)
        assert ours is not None
        assert theirs is not None
        assert ours.snapshot is not None
        assert theirs.snapshot is not None
        assert ours.snapshot.k == theirs.snapshot.k
        np.testing.assert_array_equal(ours.snapshot.all_xy_m, theirs.snapshot.all_xy_m)
        assert set(ours.snapshot.ids.tolist()) <= set(theirs.snapshot.ids.tolist())
    settled = [m.finish(polish=True) for m in (inline, process)]
    assert settled[0] is not None
    assert settled[1] is not None
    np.testing.assert_array_equal(settled[0].xy_m, settled[1].xy_m)
    np.testing.assert_array_equal(settled[0].cov_m2, settled[1].cov_m2)


def test_what_nobody_took_out_is_told_at_the_end() -> None:
    frames, config = ring_with_a_wrong_sighting(20, 2)[:40], Isam2Config()
    for mapping in (
        InlineMapping(Mapper(config, MOTION), 30.0),
        ProcessMapping(config, MOTION, None, None, 30.0),
    ):
        mapping.submit(frames)
        settled = mapping.finish(polish=True)
        assert settled is not None
        (revision,) = settled.revisions
        assert revision.observation.tolist() == [2]


def test_a_frame_that_cannot_be_a_factor_ends_the_graph_and_nothing_else() -> None:
    frames = ring(1)[:6]
    step = frames[5].increment
    assert step is not None
    mapper = Mapper(Isam2Config(), MotionConfig())
    assert map_frames(mapper, frames[:5], 20.0).snapshot is not None
    singular = replace(frames[5], increment=replace(step, cov=np.zeros((3, 3))))
    assert map_frames(mapper, [singular], 20.0) == Mapped(None, ())
    assert mapper.failed


@pytest.mark.parametrize("given_up", [100, 240])
def test_a_cone_that_was_given_up_may_come_back(given_up: int) -> None:
    """A car found again on a given map has all of its cones again."""
    n = len(CONES)
    cov = np.tile(1e-4 * np.eye(2), (n, 1, 1))
    ids = np.arange(n)
    known = ConeMap(ids, CONES, cov, np.full((n, 5), 0.2), ids)
    frames, cone = ring(3)[: 2 * LAP + 80], 14
    frames[given_up] = replace(frames[given_up], deleted=(cone,))
    seen = [k for k, f in enumerate(frames) if cone in f.landmark_id.tolist()]
    # Older frames are summed up between these; it is seen before and after.
    assert not [k for k in seen if 240 <= k < 355]
    assert seen[-1] > 355
    mapper = Mapper(Isam2Config(), MOTION, known)
    feed(mapper, frames)
    assert KEEP < len(mapper.window) < len(frames) - 300
    path, _ = mapper.settle(polish=True)
    assert path is not None
    assert len(path) == len(frames)
    np.testing.assert_allclose(mapper.cone_m(cone), CONES[cone], atol=0.02)


def test_a_killed_process_stops_nobody() -> None:
    frames = ring(1)[:40]
    process = ProcessMapping(Isam2Config(), MOTION, None, None, 30.0)
    process.submit(frames[:20])
    assert wait_for(process) is not None
    os.kill(process.pid, signal.SIGKILL)
    process.submit(frames[20:])
    assert wait_for(process) is None
    assert process.finish(polish=True) is None


def test_a_snapshot_of_nothing_solvable_is_none() -> None:
    mapper = Mapper(Isam2Config(), MOTION)
    mapper.failed = True
    assert map_frames(mapper, ring(1)[:3], 20.0) == Mapped(None, ())


def test_frames_go_on_while_the_graph_is_solved_elsewhere() -> None:
    recording = open_source("sim:oval?laps=1&seed=3")
    config = load_config(None, ["backend.mapping=process"], backend="isam2")
    config = for_source(config, recording)
    backend = Isam2Backend(config, recording.sensor)
    for event in recording.events():
        if isinstance(event, VelocityObservation):
            backend.observe_velocity(event)
        else:
            backend.observe_cones(event)
    path = backend.finish()
    assert path is not None
    truth, cones = recording.truth_trajectory, backend.cone_map()
    assert truth is not None
    assert recording.truth_map is not None
    gap = np.linalg.norm(cones.xy_m[:, None] - recording.truth_map.xy_m, axis=2)
    # How far the other process has come by when is not determined: a cone seen only
    # at the very edge may lack its third sighting.
    assert len(cones) >= 0.97 * len(recording.truth_map)
    assert gap.min(axis=1).max() < 0.5
    assert len(np.unique(gap.argmin(axis=1))) == len(cones)
    start = to_parent(np.zeros(3), path.pose[:1, :2])
    np.testing.assert_allclose(start, 0.0, atol=0.05)


def test_a_second_look_gives_back_what_was_left_aside() -> None:
    """Every third sighting of lap two is not claimed at first; the map ends as good."""
    whole = ring(2)
    parted = [
        left_aside(f, np.arange(len(f.row)) % 3 == 0) if k > LAP else f
        for k, f in enumerate(whole)
    ]
    aside = sum(len(f.unclaimed) for f in parted)
    full, less = (Mapper(Isam2Config(), MOTION, None, ROUND) for _ in range(2))
    feed(full, whole)
    revised = feed(less, parted) + less.settle(polish=True)[1]
    full.settle(polish=True)
    found = [r for r in revised if r.status is MatchStatus.MATCHED]
    assert aside > 300
    # 0.999 of them fit, and each finds the cone that it had been taken from.
    assert sum(len(r.observation) for r in found) > 0.99 * aside
    by_stamp = {f.stamp_s: f for f in whole}
    for revision in found:
        frame = by_stamp[revision.stamp_s]
        np.testing.assert_array_equal(
            frame.landmark_id[revision.observation], revision.landmark_id
        )
    assert aligned_rms(less) == pytest.approx(aligned_rms(full), rel=0.05)


def test_no_second_look_gives_a_frame_a_cone_that_it_shows_by_its_old_name() -> None:
    """Odd frames call a cone by a second name until the two are found to be one."""
    frames, twin = ring(1)[:80], 500
    cone = int(frames[30].landmark_id[0])
    k = next(k for k in range(31, 33) if cone in frames[k].landmark_id)
    for i, plain in enumerate(frames):
        names = np.where(plain.landmark_id == cone, twin, plain.landmark_id)
        frames[i] = replace(plain, landmark_id=names) if (i - k) % 2 == 0 else plain
    at = np.flatnonzero(frames[k].landmark_id == twin)
    beside = Unclaimed(
        np.array([99]), frames[k].xy_m[at] + 0.01, frames[k].reported_m2[at]
    )
    frames[k] = replace(frames[k], unclaimed=beside)
    frames[60] = replace(frames[60], merged=((cone, twin),))
    mapper = Mapper(Isam2Config(), MOTION, None, ROUND)
    assert feed(mapper, frames) + mapper.settle(polish=True)[1] == []


def left_aside(frame: TrackedFrame, aside: Mask) -> TrackedFrame:
    """Return a frame whose given sightings were not claimed by any cone."""
    kept = ~aside
    return replace(
        frame,
        landmark_id=frame.landmark_id[kept],
        row=frame.row[kept],
        xy_m=frame.xy_m[kept],
        cov_m2=frame.cov_m2[kept],
        reported_m2=frame.reported_m2[kept],
        vague=frame.vague[kept],
        unclaimed=Unclaimed(
            frame.row[aside], frame.xy_m[aside], frame.reported_m2[aside]
        ),
    )
