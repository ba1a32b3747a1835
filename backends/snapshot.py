"""What the graph believes near the car, in the form the tracker goes on from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from conegraph.backends.mapper import Mapper
from conegraph.backends.motion import NV
from conegraph.geometry import rotation
from conegraph.types import Array, IntArray

PINNED = 1e-10
"""Variance of a pose that everything else is expressed relative to."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Means of everything, and the covariance of what is near the car.

    Attributes:
        k: number of the frame that it speaks of.
        stamp_s: that frame's stamp.
        state: (6 + 2 n,) the car and the n cones near it.
        cov: covariance of these *as seen from the pose*, whose own rows are all but
            zero.
        ids: (n,) the cones near the car.
        pose_cov: (3, 3) covariance of the pose in the world.
        all_ids: (m,) every cone.
        all_xy_m: (m, 2) where they are.
    """

    k: int
    stamp_s: float
    state: Array
    cov: Array
    ids: IntArray
    pose_cov: Array
    all_ids: IntArray
    all_xy_m: Array


def take_snapshot(mapper: Mapper, radius_m: float) -> Snapshot:
    """Read the last pose and the cones within a radius from the graph.

    Covariances are of the cones relative to the car: that is what the next frame can
    test, and linearising a filter about a pose that is uncertain in the world by far
    more than the sensor is precise breaks it. A cone at ``r = l - p`` has the error
    ``e_l - e_p - e_psi J r``, J the quarter turn: cones seen lately are sharp, those
    of the last visit carry all the drift since. (Given the pose they would all be
    sharp, and a loop could only be closed within the sensor's noise.) Speeds that the
    graph does not carry (while odometry spans the frames) are taken from the tracker.

    Args:
        mapper: the graph, solved.
        radius_m: cones farther from the car are left out.
    """
    newest = mapper.newest
    frame, k = newest.frame, newest.k
    pose = mapper.pose(k)
    all_ids = np.array(list(mapper.cones), dtype=np.int64)
    all_xy = np.array([mapper.cone_m(c) for c in all_ids.tolist()]).reshape(-1, 2)
    near = np.linalg.norm(all_xy - pose[:2], axis=1) < radius_m
    ids = all_ids[near]
    keys, place = [X(k)], [0, 1, 2]
    state = np.concatenate([frame.state, all_xy[near].ravel()])
    state[:3] = pose
    if newest.moving:
        keys.append(V(k))
        place += [3, -1, 4]
        velocity = mapper.isam.calculateEstimateVector(V(k))
        state[3:5] = velocity[0], velocity[2]
    if mapper.has_bias:
        keys.append(B(newest.segment))
        place.append(5)
        state[5] = mapper.isam.calculateEstimateVector(B(newest.segment))[0]
    keys += [L(c) for c in ids.tolist()]
    place += list(range(NV, len(state)))
    joint = np.asarray(mapper.isam.jointMarginalCovariance(keys).fullMatrix())
    turn = np.eye(len(joint))
    turn[:2, :2] = rotation(pose[2])
    joint = turn @ joint @ turn.T
    pose_cov = joint[:3, :3].copy()
    away = state[NV:] - np.tile(pose[:2], len(ids))
    seen = np.eye(len(joint))
    first = len(joint) - len(away)
    seen[first:, :2] = np.tile(-np.eye(2), (len(ids), 1))
    seen[first::2, 2], seen[first + 1 :: 2, 2] = away[1::2], -away[::2]
    joint = seen @ joint @ seen.T
    cov = np.zeros((len(state), len(state)))
    target = np.array(place)
    used = target >= 0
    cov[np.ix_(target[used], target[used])] = joint[np.ix_(used, used)]
    cov[:3], cov[:, :3] = 0.0, 0.0
    cov[range(3), range(3)] = PINNED
    if not newest.moving:
        cov[3:5, 3:5] = frame.speed_cov
    return Snapshot(k, frame.stamp_s, state, cov, ids, pose_cov, all_ids, all_xy)
