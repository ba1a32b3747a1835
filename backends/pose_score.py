"""How well poses explain what the car sees, in bulk.

A sighting shows the nearest cone of the map with probability `SHOWN`, and else
something that the map does not have, spread with `CLUTTER_PER_M2` over the ground.
Placed by pose p, with residual e to the nearest cone, ``S = R(psi) C R(psi)' + C_map
+ sigma_map^2 I`` and the colours' likelihood ratio c, it is more likely than clutter
by the factor::

    g = SHOWN / CLUTTER_PER_M2 * N(e; 0, S) c + 1 - SHOWN
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.backends.cone_index import ConeIndex
from conegraph.backends.sightings import Sightings
from conegraph.geometry import rotation, wrap_angle
from conegraph.types import Array, IntArray, Mask, SensorModel

SHOWN = 0.8
CLUTTER_PER_M2 = 0.05

MAP_SIGMA_M = 0.03
"""Error of a cone's place in the map that the map does not know of."""

COARSE_SIGMA_M = 0.1
COARSE_TURN_RAD = 0.02
"""Errors of a pose that two cones alone give, in metres and per metre of range."""

COARSE = 25
"""Nearest sightings that a first score looks at."""

STEPS = 3
LONGEST_STEP = 1.0
PRIOR_INFORMATION = np.diag([1e-2, 1e-2, 1e-1])
"""Keeps poses that few cones hold from running away."""

REMOVED = 0.2
"""Chance that a cone of the map is no longer there."""

NEAR_EDGE = 0.94
"""Share of range and field of view within which a cone must be seen."""

SURELY_SEEN = 0.98
"""No sensor sees better than this."""


@dataclass(frozen=True, slots=True)
class _Placed:
    """Sightings (n) placed by poses (h): arrays (h, n).

    Attributes:
        arm_m: (h, n, 2) from the car to the sighting, world axes.
        cone: nearest cones.
        error_m: (h, n, 2) from the nearest cone to the sighting.
        information: (h, n, 2, 2) inverse of S; zero where no cone is in reach.
        gain: the factor ``g - (1 - SHOWN)``.
    """

    arm_m: Array
    cone: IntArray
    error_m: Array
    information: Array
    gain: Array


@dataclass(frozen=True, slots=True)
class ScoredPoses:
    """Poses and what speaks for them.

    Attributes:
        pose: (h, 3).
        cov: (h, 3, 3) their covariances.
        log_likelihood: (h,) over "all that is seen is clutter", natural log.
        misfit: (h,) squared Mahalanobis distance of what fits, per degree of freedom.
        cone: (h, n) the cone that each sighting shows, M for none.
    """

    pose: Array
    cov: Array
    log_likelihood: Array
    misfit: Array
    cone: IntArray

    def take(self, rows: IntArray) -> ScoredPoses:
        """Return the poses in the rows."""
        return ScoredPoses(
            self.pose[rows],
            self.cov[rows],
            self.log_likelihood[rows],
            self.misfit[rows],
            self.cone[rows],
        )


def coarse_score(
    index: ConeIndex, seen: Sightings, log_colour: Array, poses: Array
) -> Array:
    """Return a quick log-likelihood (h,) of many poses, by the nearest sightings."""
    range_m = np.hypot(*seen.xy_m.T)
    rows = np.argsort(range_m, kind="stable")[:COARSE]
    xy, range_m = seen.xy_m[rows], range_m[rows]
    var = 0.5 * np.trace(seen.cov_m2[rows], axis1=1, axis2=2) + MAP_SIGMA_M**2
    var = var + COARSE_SIGMA_M**2 + (COARSE_TURN_RAD * range_m) ** 2
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x = poses[:, :1] + c * xy[:, 0] - s * xy[:, 1]
    y = poses[:, 1:2] + s * xy[:, 0] + c * xy[:, 1]
    cone = index.nearest(x, y)
    d2 = (x - index.xy_m[cone, 0]) ** 2 + (y - index.xy_m[cone, 1]) ** 2
    log_gain = np.log(SHOWN / CLUTTER_PER_M2 / (2 * np.pi * var)) - 0.5 * d2 / var
    log_gain += log_colour[rows[None, :], cone]
    gain = np.exp(np.clip(log_gain, -30.0, 30.0))
    score: Array = np.log(gain + 1.0 - SHOWN).sum(axis=1)
    return score


def refine(
    index: ConeIndex,
    seen: Sightings,
    log_colour: Array,
    poses: Array,
    sensor: SensorModel,
) -> ScoredPoses:
    """Fit poses to the cones they explain and score them with all that is known.

    Gauss-Newton steps in which each sighting counts by its probability of showing
    its nearest cone (in the first step, by a Cauchy weight, so that it may be far).
    Then cones and sightings go together one to one, and a cone that should have
    been seen and was not speaks against a pose.
    """
    for step in range(STEPS):
        placed = _place(index, seen, log_colour, poses)
        if step == 0:
            weight = 1.0 / (1.0 + _mahalanobis(placed) / 9.0)
            weight = np.where(placed.cone < index.n, weight, 0.0)
        else:
            weight = placed.gain / (placed.gain + 1.0 - SHOWN)
        H, gradient = _normal(placed, weight)
        move = np.linalg.solve(H, gradient[..., None])[..., 0]
        poses = poses - np.clip(move, -LONGEST_STEP, LONGEST_STEP)
    poses[:, 2] = wrap_angle(poses[:, 2])
    placed = _place(index, seen, log_colour, poses)
    shows = placed.gain / (placed.gain + 1.0 - SHOWN)
    H, _ = _normal(placed, shows)
    best = _one_to_one(index, placed, shows > 0.5)
    nothing = np.log(1.0 - SHOWN)
    alone = np.where(shows > 0.5, nothing, np.log(placed.gain + 1.0 - SHOWN))
    gains = np.where(best, np.log(placed.gain + 1.0 - SHOWN), alone)
    cone = np.where(best, placed.cone, index.n)
    missed = _missed(index, seen, cone, poses, sensor)
    freedom = np.maximum(2 * np.count_nonzero(best, axis=1) - 3, 1)
    return ScoredPoses(
        poses,
        np.asarray(np.linalg.inv(H), dtype=np.float64),
        gains.sum(axis=1) + np.log(REMOVED + (1.0 - REMOVED) * missed).sum(axis=1),
        np.where(best, _mahalanobis(placed), 0.0).sum(axis=1) / freedom,
        cone,
    )


def _place(
    index: ConeIndex, seen: Sightings, log_colour: Array, poses: Array
) -> _Placed:
    R = rotation(poses[:, 2])
    arm = np.einsum("hij,nj->hni", R, seen.xy_m)
    place = poses[:, None, :2] + arm
    cone = index.nearest(place[..., 0], place[..., 1])
    near = cone < index.n
    error = np.where(near[..., None], place - index.xy_m[cone], 0.0)
    S = np.einsum("hij,njk,hlk->hnil", R, seen.cov_m2, R)
    S += index.cov_m2[cone] + MAP_SIGMA_M**2 * np.eye(2)
    a, b, d = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    det = a * d - b * b
    information = np.empty_like(S)
    information[..., 0, 0], information[..., 1, 1] = d / det, a / det
    information[..., 0, 1] = information[..., 1, 0] = -b / det
    information *= near[..., None, None]
    d2 = np.einsum("hni,hnij,hnj->hn", error, information, error)
    log_gain = np.log(SHOWN / CLUTTER_PER_M2 / (2 * np.pi)) - 0.5 * (np.log(det) + d2)
    log_gain += log_colour[np.arange(len(seen))[None, :], cone]
    gain = np.where(near, np.exp(np.clip(log_gain, -30.0, 30.0)), 0.0)
    return _Placed(arm, cone, error, information, gain)


def _mahalanobis(placed: _Placed) -> Array:
    d2: Array = np.einsum(
        "hni,hnij,hnj->hn", placed.error_m, placed.information, placed.error_m
    )
    return d2


def _normal(placed: _Placed, weight: Array) -> tuple[Array, Array]:
    """Return the normal matrices (h, 3, 3) and gradients (h, 3) of the fits."""
    h, n = placed.gain.shape
    J = np.zeros((h, n, 2, 3))
    J[..., 0, 0] = J[..., 1, 1] = 1.0
    J[..., 0, 2], J[..., 1, 2] = -placed.arm_m[..., 1], placed.arm_m[..., 0]
    weighted = (placed.information * weight[..., None, None]) @ J
    H = np.einsum("hnai,hnaj->hij", J, weighted) + PRIOR_INFORMATION
    gradient = np.einsum("hnai,hna->hi", weighted, placed.error_m)
    return H, gradient


def _one_to_one(index: ConeIndex, placed: _Placed, shows: Mask) -> Mask:
    """(h, n) whether a sighting is the best of those that claim its cone."""
    h, n = placed.gain.shape
    strongest = np.full((h, index.n + 1), -1.0)
    row = np.repeat(np.arange(h), n)
    claim = np.where(shows, placed.gain, 0.0)
    np.maximum.at(strongest, (row, placed.cone.ravel()), claim.ravel())
    best: Mask = shows & (claim >= strongest[np.arange(h)[:, None], placed.cone])
    return best


def _missed(
    index: ConeIndex, seen: Sightings, cone: IntArray, poses: Array, sensor: SensorModel
) -> Array:
    """(h, M) chance that a cone of the map stays unseen; 1 where it was seen."""
    chance = sensor.detection_probability
    unseen = np.ones((len(poses), index.n + 1))
    if chance == 0.0:
        return unseen[:, :-1]
    blind = 1.0 - min(SURELY_SEEN, 0.7 if chance is None else chance)
    away = index.xy_m[None, :-1] - poses[:, None, :2]
    local = away @ rotation(poses[:, 2])
    for view in seen.views:
        x, y = np.moveaxis((local - view[:2]) @ rotation(view[2]), -1, 0)
        range_m = np.hypot(x, y)
        inside = (range_m < NEAR_EDGE * 0.8 * sensor.max_range_m) & (
            range_m > sensor.min_range_m + 0.5
        )
        inside &= np.abs(np.arctan2(y, x)) < NEAR_EDGE * sensor.half_fov_rad
        unseen[:, :-1][inside] *= blind**seen.frames_per_view
    unseen[np.arange(len(poses))[:, None], cone] = 1.0
    return unseen[:, :-1]
