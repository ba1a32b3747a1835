"""Pairs made so far in one frame, and what they say of all that is left."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from conegraph.backends.landmark_filter import add_blocks, components
from conegraph.backends.pairing_problem import (
    ClusterVerdict,
    Pairing,
    Problem,
    largest_sigma,
    mahalanobis,
)
from conegraph.config import AssociationConfig
from conegraph.types import Array, IntArray, Mask


@dataclass(frozen=True, slots=True)
class PairingState:
    """Pairs made so far, and the predictions given them.

    Attributes:
        h: (k, 2) predicted cones in the car frame.
        cov: (2k, 2k) their joint covariance.
        column: (m,) the cone of each observation, -1 where there is none.
        d2: (m,) squared Mahalanobis distance to it when it was accepted.
        score: sum of ``-2 log`` likelihood ratios of the pairs against new cones.
        pair_d2: (m, k) squared Mahalanobis distance of each pair to be made.
        gain: (m, k) what it would add to the score.
        soft: (m,) pairs that may be another cone of the same cluster.
        spread_m2: (m, 2, 2) what this adds to the noise of the observation.
        beside: (m,) observations of a cone not yet mapped, beside mapped ones.
    """

    h: Array
    cov: Array
    column: IntArray
    d2: Array
    score: float
    pair_d2: Array
    gain: Array
    soft: Mask
    spread_m2: Array
    beside: Mask

    @classmethod
    def start(cls, problem: Problem) -> PairingState:
        """Return the state in which nothing is paired."""
        m = len(problem.xy_m)
        h, cov = problem.predicted.xy_m, problem.predicted.cov_m2
        return cls(
            h,
            cov,
            np.full(m, -1, dtype=np.int64),
            np.full(m, np.inf),
            0.0,
            *_weigh(problem, h, cov),
            np.zeros(m, dtype=bool),
            np.zeros((m, 2, 2)),
            np.zeros(m, dtype=bool),
        )

    @property
    def free(self) -> Mask:
        """(m, k) pairs of which neither side is taken."""
        return (self.column < 0)[:, None] & ~self.used

    @property
    def used(self) -> Mask:
        """(k,) cones that have an observation."""
        mask = np.zeros(len(self.h), dtype=bool)
        mask[self.column[self.column >= 0]] = True
        return mask


def accept(
    problem: Problem,
    state: PairingState,
    row: IntArray,
    col: IntArray,
) -> PairingState:
    """Return the state with pairs added and predictions conditioned on them.

    ``G = C_:j (C_jj + R)^-1, h += G (y - h_j), C -= G C_j:``.
    """
    index = components(col)
    rows = state.cov[index]
    noise = problem.noise_m2[row] + state.spread_m2[row]
    G = np.linalg.solve(add_blocks(rows[:, index], noise), rows).T
    shift = G @ (problem.xy_m[row] - state.h[col]).ravel()
    h, cov = state.h + shift.reshape(-1, 2), state.cov - G @ rows
    column, matched_d2 = state.column.copy(), state.d2.copy()
    column[row], matched_d2[row] = col, state.pair_d2[row, col]
    pair_d2, gain = _weigh(problem, h, cov)
    return replace(
        state,
        h=h,
        cov=cov,
        column=column,
        d2=matched_d2,
        score=state.score + float(state.gain[row, col].sum()),
        pair_d2=pair_d2,
        gain=gain,
    )


def _weigh(problem: Problem, h: Array, cov: Array) -> tuple[Array, Array]:
    """Return d² (m, k) of each pair, and what it is better than a new cone by.

    The gain is ``n - d2 - log|S| - colour``, with n the cost of a new cone.
    """
    d2, logdet = mahalanobis(problem.xy_m, problem.noise_m2, h, cov)
    return d2, problem.new_cost - d2 - problem.cost - logdet


def conclude(
    config: AssociationConfig, problem: Problem, state: PairingState
) -> Pairing:
    """Return the pairs, and how near the rest is to known cones given the pairs."""
    loose = largest_sigma(state.cov) > problem.loose_m
    likely = state.gain > config.ambiguity_d2
    silent = state.used | (loose & ~likely)
    free_d2 = np.where(silent, np.inf, state.pair_d2).min(axis=1)
    matched = state.column >= 0
    nearest_d2 = np.where(matched, state.d2, state.pair_d2.min(axis=1))
    return Pairing(
        state.column,
        nearest_d2,
        free_d2,
        loose & ~state.used,
        ClusterVerdict(state.soft, state.spread_m2, state.beside),
    )
