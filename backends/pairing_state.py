"""Pairs made so far in one frame, and what they say of all that is left."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

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
        soft: (m,) pairs that may be another cone of the same cluster.
        spread_m2: (m, 2, 2) what this adds to the noise of the observation.
        beside: (m,) observations of a cone not yet mapped, beside mapped ones.
    """

    h: Array
    cov: Array
    column: IntArray
    d2: Array
    score: float
    soft: Mask
    spread_m2: Array
    beside: Mask

    @classmethod
    def start(cls, problem: Problem) -> PairingState:
        """Return the state in which nothing is paired."""
        m = len(problem.xy_m)
        return cls(
            problem.predicted.xy_m,
            problem.predicted.cov_m2,
            np.full(m, -1, dtype=np.int64),
            np.full(m, np.inf),
            0.0,
            np.zeros(m, dtype=bool),
            np.zeros((m, 2, 2)),
            np.zeros(m, dtype=bool),
        )

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
    d2: Array,
    gain: Array,
) -> PairingState:
    """Return the state with pairs added and predictions conditioned on them.

    ``G = C_:j (C_jj + R)^-1, h += G (y - h_j), C -= G C_j:``.
    """
    index = np.stack([2 * col, 2 * col + 1], axis=1).ravel()
    S = state.cov[np.ix_(index, index)]
    noise = problem.noise_m2[row] + state.spread_m2[row]
    i = 2 * np.arange(len(col))
    for a in range(2):
        for b in range(2):
            S[i + a, i + b] += noise[:, a, b]
    G = np.linalg.solve(S, state.cov[index]).T
    shift = G @ (problem.xy_m[row] - state.h[col]).ravel()
    column, matched_d2 = state.column.copy(), state.d2.copy()
    column[row], matched_d2[row] = col, d2[row, col]
    return replace(
        state,
        h=state.h + shift.reshape(-1, 2),
        cov=state.cov - G @ state.cov[index],
        column=column,
        d2=matched_d2,
        score=state.score + float(gain[row, col].sum()),
    )


def conclude(
    config: AssociationConfig, problem: Problem, state: PairingState
) -> Pairing:
    """Return the pairs, and how near the rest is to known cones given the pairs."""
    d2, logdet = mahalanobis(problem.xy_m, problem.noise_m2, state.h, state.cov)
    loose = largest_sigma(state.cov) > problem.loose_m
    likely = problem.new_cost - d2 - problem.cost - logdet > config.ambiguity_d2
    silent = state.used | (loose & ~likely)
    free_d2 = np.where(silent, np.inf, d2).min(axis=1)
    matched = state.column >= 0
    nearest_d2 = np.where(matched, state.d2, d2.min(axis=1))
    return Pairing(
        state.column,
        nearest_d2,
        free_d2,
        loose & ~state.used,
        ClusterVerdict(state.soft, state.spread_m2, state.beside),
    )
