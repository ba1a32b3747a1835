"""What the cones of a run and its odometry say of each other, whatever a filter made.

While a cone is in view it is seen from many places. Odometry puts these sights side
by side: if all is well they fall on one point, up to noise. A fault of odometry,
stamps or calibration spreads them in a way of its own. With p and psi the pose by
odometry, R its rotation, J the quarter turn, y where the car sees a cone that stands
at l, and ' the derivative by time::

    p + R y = l + k p                   odometry's speed is (1 + k) times the true one
                + b (q + t J R y)       its yaw rate is too great by b, q' = t J p'
                + d J R y               the sensor appears turned left by d
                + s (p' + psi' J R y)   frames are stamped late by s

A scale of all ranges is the same as -k: odometry and cones then speak of two worlds
that differ in size, and nothing inside a run tells which is right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from conegraph.eval.doctor_tracks import chained, placed
from conegraph.geometry import rotation
from conegraph.types import Array, IntArray

NAMES = ("scale", "yaw_rate_bias", "sensor_yaw", "stamp_offset")
"""What is estimated: k, b in rad/s, d in rad, s in s."""

SPAN_S = 3.0
"""Sights of a cone farther apart are not compared: odometry has drifted meanwhile."""

CLUSTER_S = 1.0
"""Errors within this time are taken as dependent on each other."""

ROUNDS = 4
OFTEN, FEWEST = 3, 50
"""Sights of a cone that are of use, and all together."""

FAR = 3.0
"""Sigmas beyond which a sight loses weight (Huber): it may show another cone."""

_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class SensorFit:
    """The faults that fit best, all together.

    Attributes:
        value: (4,) in the order of `NAMES`.
        sigma: (4,) standard deviations, from the scatter of `CLUSTER_S` intervals.
        gain: (4,) share of the spread of the sights that each explains, 0 to 1.
        noise: how many times as large as reported the rest of the spread is.
        sights: how many sights were used.
        worst_s: stamp at which what they explain is greatest, for each (4,).
    """

    value: Array
    sigma: Array
    gain: Array
    noise: float
    sights: int
    worst_s: Array


@dataclass(frozen=True, slots=True)
class Sights:
    """Sights of cones, and odometry's steps between the frames.

    Attributes:
        frame: (N,) frame of each.
        group: (N,) whose sights are compared with each other.
        xy_m: (N, 2) in the car frame.
        cov_m2: (N, 2, 2) as reported.
        stamp_s: (F,) of the frames.
        step: (F, 3) odometry's pose increment up to each frame.
    """

    frame: IntArray
    group: IntArray
    xy_m: Array
    cov_m2: Array
    stamp_s: Array
    step: Array

    def of_cones_seen_often(self) -> Sights:
        """Return those of groups with `OFTEN` sights or more, the groups renumbered."""
        keep = np.bincount(self.group, minlength=1)[self.group] >= OFTEN
        return replace(
            self,
            frame=self.frame[keep],
            group=np.unique(self.group[keep], return_inverse=True)[1],
            xy_m=self.xy_m[keep],
            cov_m2=self.cov_m2[keep],
        )


def fit_sensors(sights: Sights) -> SensorFit | None:
    """Estimate what is wrong with odometry, stamps and calibration together.

    Gauss and Newton's method on the equation above, with every cone's place l
    eliminated and the weights of far sights reduced (P. Huber, "Robust estimation of
    a location parameter", 1964).

    Without odometry the estimate's own motion takes its place. It follows the cones,
    so that little is left of any fault.

    Returns:
        None with too few cones that were seen twice.
    """
    sights = sights.of_cones_seen_often()
    if len(sights.frame) < FEWEST:
        return None
    value, weight = np.zeros(len(NAMES)), np.ones(len(sights.frame))
    for _ in range(ROUNDS):
        residual, slope = _linearised(sights, value)
        W = np.linalg.inv(sights.cov_m2) * weight[:, None, None]
        residual, slope = _without_places(sights.group, W, residual, slope)
        information = np.einsum("nip,nij,njq->pq", slope, W, slope)
        if np.linalg.cond(information) > 1e14:
            return None
        step = np.linalg.solve(information, np.einsum("nip,nij,nj", slope, W, residual))
        value = value + step
        rest = residual - slope @ step
        d2 = np.einsum("ni,nij,nj->n", rest, np.linalg.inv(sights.cov_m2), rest)
        scale = _scale(d2)
        weight = np.minimum(1.0, FAR * scale / np.sqrt(np.maximum(d2, 1e-12)))
    return _summary(sights, value, information, slope, W, rest, scale)


def _scale(d2: Array) -> float:
    """Return how many times as large as reported the noise is, by the median."""
    return float(np.sqrt(np.median(d2) / (2.0 * np.log(2.0))))


def _linearised(s: Sights, value: Array) -> tuple[Array, Array]:
    """Return where the sights are with the faults taken out, and by what they move.

    Returns:
        Places (N, 2) by odometry, and their derivatives (N, 2, 4) by the faults.
    """
    scale, bias, turned, late = value
    standing = ~s.step.any(axis=1)
    dt = np.where(standing, 0.0, np.diff(s.stamp_s, prepend=s.stamp_s[0]))
    step = s.step / [1.0 + scale, 1.0 + scale, 1.0]
    step[:, 2] -= bias * dt
    pose = chained(step)
    speed = np.gradient(pose[:, :2], s.stamp_s, axis=0)
    rate = np.gradient(np.unwrap(pose[:, 2]), s.stamp_s)
    middle = s.stamp_s - 0.5 * dt
    moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
    bent = np.cumsum(middle[:, None] * moved @ _TURN.T, axis=0)
    seen = s.xy_m @ rotation(turned)
    world = placed(pose[s.frame], seen) - pose[s.frame, :2]
    across = world @ _TURN.T
    swept = speed[s.frame] + rate[s.frame, None] * across
    # Counted from the middle of a span, or the noise of a sight would be multiplied.
    t = s.stamp_s[s.frame, None]
    about = (np.floor(t / SPAN_S) + 0.5) * SPAN_S
    since = t - about
    slope = np.stack(
        [
            pose[s.frame, :2],
            bent[s.frame] - about * (pose[s.frame, :2] @ _TURN.T) + since * across,
            across,
            swept,
        ],
        axis=2,
    )
    return pose[s.frame, :2] + world - late * swept, slope


def _without_places(
    group: IntArray, W: Array, residual: Array, slope: Array
) -> tuple[Array, Array]:
    """Take from each group its weighted mean: the place of the cone that fits best."""
    joined = np.concatenate([residual[:, :, None], slope], axis=2)
    n = int(group.max()) + 1
    information = np.zeros((n, 2, 2))
    total = np.zeros((n, 2, joined.shape[2]))
    np.add.at(information, group, W)
    np.add.at(total, group, W @ joined)
    centred = joined - np.linalg.solve(information, total)[group]
    return centred[:, :, 0], centred[:, :, 1:]


def _summary(
    s: Sights,
    value: Array,
    information: Array,
    slope: Array,
    W: Array,
    rest: Array,
    noise: float,
) -> SensorFit:
    """Describe a fit; sigmas by the sandwich of scores summed over short intervals."""
    score = np.einsum("nip,nij,nj->np", slope, W, rest)
    cluster = np.floor(s.stamp_s[s.frame] / CLUSTER_S).astype(np.int64)
    cluster = np.unique(cluster, return_inverse=True)[1]
    summed = np.zeros((int(cluster.max()) + 1, len(NAMES)))
    np.add.at(summed, cluster, score)
    inverse = np.linalg.inv(information)
    sigma = np.sqrt(np.diag(inverse @ (summed.T @ summed) @ inverse))
    explained = np.einsum("nip,nij,njp->np", slope, W, slope) * value**2
    spread = float(np.einsum("ni,nij,nj", rest, W, rest))
    whole = spread + explained.sum(axis=0)
    worst = np.zeros((int(cluster.max()) + 1, len(NAMES)))
    np.add.at(worst, cluster, explained)
    start = np.array([s.stamp_s[s.frame][cluster == k].min() for k in worst.argmax(0)])
    return SensorFit(
        value=value,
        sigma=sigma,
        gain=explained.sum(axis=0) / whole,
        noise=noise,
        sights=len(s.frame),
        worst_s=start,
    )
