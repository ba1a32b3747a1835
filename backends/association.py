"""Which observation is which cone: three methods, one result.

All work on the cones of the map predicted into the car frame with their joint
covariance, so that they know nothing of the estimator behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conegraph.backends.landmark_filter import PredictedCones
from conegraph.config import AssociationConfig
from conegraph.types import Array, IntArray

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Pairing:
    """What was matched with what.

    Attributes:
        column: (m,) index into the predicted cones, -1 where nothing matched.
        d2: (m,) squared Mahalanobis distance to the match; where there is none,
            to the nearest cone; infinite without any cone.
        free_d2: (m,) the same to the nearest cone that nothing else matched.
    """

    column: IntArray
    d2: Array
    free_d2: Array

    @property
    def matched(self) -> Mask:
        """(m,) whether each observation has a cone."""
        return self.column >= 0


def mahalanobis(
    xy_m: Array, noise_m2: Array, predicted_m: Array, cov_m2: Array
) -> tuple[Array, Array]:
    """Return d² and log-determinant (m, k) between observations and predictions.

    ``S = C_jj + R_i, d2 = (y_i - h_j)' S^-1 (y_i - h_j)`` in closed form for 2x2.

    Args:
        xy_m: (m, 2) observations.
        noise_m2: (m, 2, 2) their covariances.
        predicted_m: (k, 2) predictions.
        cov_m2: (2k, 2k) joint covariance of these.
    """
    i = 2 * np.arange(len(predicted_m))
    a = cov_m2[i, i] + noise_m2[:, None, 0, 0]
    b = cov_m2[i, i + 1] + noise_m2[:, None, 0, 1]
    c = cov_m2[i + 1, i + 1] + noise_m2[:, None, 1, 1]
    e = xy_m[:, None, :] - predicted_m
    ex, ey = e[..., 0], e[..., 1]
    det = np.maximum(a * c - b * b, 1e-18)
    return (ex * ex * c - 2.0 * ex * ey * b + ey * ey * a) / det, np.log(det)


def colour_cost(observed: Array, mapped: Array) -> Array:
    """Return -2 log of the colours' likelihood ratio, (m, k); 0 says nothing.

    The ratio is ``sum_c p_obs(c) p_map(c) / prior(c)`` over the four colours with
    a uniform prior, where unknown spreads evenly; it is bounded to [1/20, 4].
    """
    ratio = 4.0 * _four_colours(observed) @ _four_colours(mapped).T
    cost: Array = -2.0 * np.log(np.clip(ratio, 0.05, 4.0))
    return cost


def _four_colours(prob: Array) -> Array:
    spread = prob[:, :4] + 0.25 * prob[:, 4:]
    total: Array = spread / np.maximum(spread.sum(axis=1, keepdims=True), 1e-12)
    return total


def associate(
    config: AssociationConfig,
    xy_m: Array,
    noise_m2: Array,
    predicted: PredictedCones,
    cost: Array,
    allowed: Mask,
) -> Pairing:
    """Pair observations with predicted cones by the configured method.

    Args:
        config: method and gates.
        xy_m: (m, 2) observations in the car frame.
        noise_m2: (m, 2, 2) their covariances.
        predicted: k cones with joint covariance.
        cost: (m, k) additional cost of a pair (colour).
        allowed: (m, k) pairs that may be made at all.
    """
    m, k = len(xy_m), len(predicted.slot)
    if m == 0 or k == 0:
        none = np.full(m, -1, dtype=np.int64)
        return Pairing(none, np.full(m, np.inf), np.full(m, np.inf))
    if config.method == "nearest":
        return pair_nearest(config, xy_m, noise_m2, predicted, allowed)
    return pair_sequentially(config, xy_m, noise_m2, predicted, cost, allowed)


def pair_nearest(
    config: AssociationConfig,
    xy_m: Array,
    noise_m2: Array,
    predicted: PredictedCones,
    allowed: Mask,
) -> Pairing:
    """Give each observation its nearest cone of the same type (section 4.4.3).

    Every observation decides alone, so two of them may share a cone.
    """
    d2, _ = mahalanobis(xy_m, noise_m2, predicted.xy_m, predicted.cov_m2)
    d2 = np.where(allowed, d2, np.inf)
    nearest = d2.argmin(axis=1).astype(np.int64)
    best = d2[np.arange(len(xy_m)), nearest]
    return Pairing(np.where(best <= config.gate_d2, nearest, -1), best, best)


def pair_sequentially(
    config: AssociationConfig,
    xy_m: Array,
    noise_m2: Array,
    predicted: PredictedCones,
    cost: Array,
    allowed: Mask,
) -> Pairing:
    """Accept the surest pairs, condition all other predictions on them, repeat.

    A pair must pass the gate given the pairs before it and beat every rival for
    either side by `ambiguity_d2`; pairs are accepted in the order of
    ``d2 + log|S| + colour``. The first pairs, which fix the car's pose, are made
    one at a time; then the rounds double, because conditioning on more hardly
    changes what is left. Pairs that pass their own gates but contradict each
    other jointly cannot arise, as they do when each is tested alone (Neira and
    Tardos 2001 on joint compatibility).
    """
    h, cov = predicted.xy_m.copy(), predicted.cov_m2.copy()
    m, k = len(xy_m), len(h)
    column = np.full(m, -1, dtype=np.int64)
    used = np.zeros(k, dtype=bool)
    matched_d2 = np.full(m, np.inf)
    rounds = 0
    while True:
        d2, logdet = mahalanobis(xy_m, noise_m2, h, cov)
        free = allowed & (column < 0)[:, None] & ~used
        weighed = np.where(free, d2 + cost, np.inf)
        sure = free & (d2 <= config.gate_d2) & _beats_rivals(weighed, config)
        rows, cols = np.nonzero(sure)
        if len(rows) == 0:
            break
        order = np.argsort((weighed + logdet)[rows, cols], kind="stable")
        size = 1 if rounds < 3 else 2 ** (rounds - 2)
        rows, cols = _one_to_one(rows[order], cols[order], size)
        column[rows], matched_d2[rows] = cols, d2[rows, cols]
        used[cols] = True
        h, cov = _condition(h, cov, xy_m[rows], noise_m2[rows], cols)
        rounds += 1
    d2, _ = mahalanobis(xy_m, noise_m2, h, cov)
    free_d2 = np.where(used, np.inf, d2).min(axis=1)
    return Pairing(column, np.where(column >= 0, matched_d2, d2.min(axis=1)), free_d2)


def _beats_rivals(weighed: Array, config: AssociationConfig) -> Mask:
    """(m, k) whether a pair is better than any other of its row and column."""
    wins = np.ones(weighed.shape, dtype=bool)
    for axis in (0, 1):
        if weighed.shape[axis] < 2:
            continue
        two = np.partition(weighed, 1, axis=axis)
        best, second = np.split(two.take([0, 1], axis=axis), 2, axis=axis)
        rival = np.where(weighed == best, second, best)
        with np.errstate(invalid="ignore"):
            wins &= rival - weighed >= config.ambiguity_d2
    return wins


def _one_to_one(
    rows: IntArray, cols: IntArray, limit: int
) -> tuple[IntArray, IntArray]:
    """Return the first pairs, at most ``limit``, with no row or column repeated."""
    taken_rows: set[int] = set()
    taken_cols: set[int] = set()
    chosen: list[int] = []
    for n, (i, j) in enumerate(zip(rows.tolist(), cols.tolist(), strict=True)):
        if len(chosen) == limit:
            break
        if i in taken_rows or j in taken_cols:
            continue
        taken_rows.add(i)
        taken_cols.add(j)
        chosen.append(n)
    return rows[chosen], cols[chosen]


def _condition(
    h: Array, cov: Array, xy_m: Array, noise_m2: Array, cols: IntArray
) -> tuple[Array, Array]:
    """Return predictions and covariance given that ``cols`` were seen at ``xy_m``.

    ``G = C_:j (C_jj + R)^-1, h += G (y - h_j), C -= G C_j:``.
    """
    index = np.stack([2 * cols, 2 * cols + 1], axis=1).ravel()
    S = cov[np.ix_(index, index)]
    i = 2 * np.arange(len(cols))
    for a in range(2):
        for b in range(2):
            S[i + a, i + b] += noise_m2[:, a, b]
    G = np.linalg.solve(S, cov[index]).T
    shift = G @ (xy_m - h[cols]).ravel()
    return h + shift.reshape(-1, 2), cov - G @ cov[index]
