"""The question that every association method answers, and the shape of its answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.backends.landmark_filter import PredictedCones
from conegraph.types import Array, IntArray, Mask


@dataclass(frozen=True, slots=True)
class Problem:
    """Which of m observations are which of k predicted cones?

    Attributes:
        xy_m: (m, 2) observations in the car frame.
        noise_m2: (m, 2, 2) their covariances.
        predicted: the cones with their joint covariance.
        cost: (m, k) additional cost of a pair (colour).
        allowed: (m, k) pairs that may be made at all.
        loose_m: (k,) sigma beyond which a predicted place says too little.
        new_cost: what it costs to call an observation a new cone, on the scale of
            ``d2 + log|S|``.
        margin: (k,) by how much a match with a cone must beat this.
    """

    xy_m: Array
    noise_m2: Array
    predicted: PredictedCones
    cost: Array
    allowed: Mask
    loose_m: Array
    new_cost: float
    margin: Array


@dataclass(frozen=True, slots=True)
class ClusterVerdict:
    """What is known of observations whose candidates stand close together.

    Attributes:
        soft: (m,) matches that may be another cone of the same cluster.
        spread_m2: (m, 2, 2) what this adds to the noise of the observation.
        beside: (m,) observations of a cone not yet mapped, beside mapped ones.
    """

    soft: Mask
    spread_m2: Array
    beside: Mask

    @classmethod
    def none(cls, m: int) -> ClusterVerdict:
        """Return the verdict on m observations that no cluster concerns."""
        nowhere = np.zeros(m, dtype=bool)
        return cls(nowhere, np.zeros((m, 2, 2)), nowhere)


@dataclass(frozen=True, slots=True)
class Pairing:
    """What was matched with what.

    Attributes:
        column: (m,) index into the predicted cones, -1 where nothing matched.
        d2: (m,) squared Mahalanobis distance to the match; where there is none,
            to the nearest cone; infinite without any cone.
        free_d2: (m,) the same to the nearest cone that nothing else matched and
            whose place is known well enough to speak of.
        loose: (k,) cones whose place is not known well enough.
        cluster: what clusters leave open, None for methods that do not ask.
    """

    column: IntArray
    d2: Array
    free_d2: Array
    loose: Mask
    cluster: ClusterVerdict | None = None

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
    xx, xy, yy = _own_covariances(cov_m2)
    a = xx + noise_m2[:, None, 0, 0]
    b = xy + noise_m2[:, None, 0, 1]
    c = yy + noise_m2[:, None, 1, 1]
    ex = xy_m[:, None, 0] - predicted_m[:, 0]
    ey = xy_m[:, None, 1] - predicted_m[:, 1]
    det = np.maximum(a * c - b * b, 1e-18)
    return (ex * ex * c - 2.0 * ex * ey * b + ey * ey * a) / det, np.log(det)


def largest_sigma(cov: Array) -> Array:
    """(k,) largest sigma of each of k places, from their joint covariance (2k, 2k)."""
    a, b, c = _own_covariances(cov)
    half = 0.5 * (a + c)
    largest = half + np.sqrt(np.maximum(half**2 - (a * c - b * b), 0.0))
    sigma: Array = np.sqrt(np.maximum(largest, 0.0))
    return sigma


def _own_covariances(cov: Array) -> tuple[Array, Array, Array]:
    """Return each place's xx, xy and yy (k,), from their joint covariance (2k, 2k)."""
    own = cov.diagonal()
    return own[::2], cov.diagonal(1)[::2], own[1::2]


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
