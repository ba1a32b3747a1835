"""Association one pair after the other, each given those before it."""

from __future__ import annotations

import numpy as np

from conegraph.backends.clusters import CLUSTER_M, settle_clusters
from conegraph.backends.pairing_problem import (
    Pairing,
    Problem,
    largest_sigma,
)
from conegraph.backends.pairing_state import PairingState, accept, conclude
from conegraph.config import AssociationConfig
from conegraph.types import Array, IntArray, Mask

CONSTELLATION = 4
"""Cones that must fit together before loosely known ones are recognised."""

CLUSTER = 2
"""Cones that must fit together before ambiguous ones are told apart."""

MAX_SEEDS = 12
"""Pairs tried as the first of a constellation."""


def pair_sequentially(config: AssociationConfig, problem: Problem) -> Pairing:
    """Accept the surest pairs, condition all other predictions on them, repeat.

    A pair must pass the gate given the pairs before it, beat every rival for
    either side by `ambiguity_d2`, and beat "this is a new cone" by its cone's margin;
    pairs are accepted in the order of ``d2 + log|S| + colour``. Pairs that pass
    their own gates but contradict each other jointly cannot arise, as they do when
    each is tested alone (Neira and Tardos, "Data association in stochastic mapping
    using the joint compatibility test", 2001).

    What is left over is paired together, if it can be: see `_recognise`.
    """
    state = _advance(config, problem, PairingState.start(problem))
    if (state.column < 0).any():
        state = _recognise(config, problem, state, vague=False)
        state = _recognise(config, problem, state, vague=True)
        state = settle_clusters(config, problem, state)
        state = _advance(config, problem, state)
    return conclude(config, problem, state)


def _advance(
    config: AssociationConfig, problem: Problem, state: PairingState
) -> PairingState:
    """Make every pair that is sure; the first, which fix the pose, one at a time.

    Later rounds double: conditioning on more pairs hardly changes what is left.
    """
    for rounds in range(len(problem.xy_m)):
        free = problem.allowed & state.free
        if not free.any():
            break
        weighed = np.where(free, state.pair_d2 + problem.cost, np.inf)
        sure = free & (state.pair_d2 <= config.gate_d2)
        sure &= state.gain >= problem.margin
        sure &= _beats_rivals(weighed, config.ambiguity_d2)
        row, col = np.nonzero(sure)
        if len(row) == 0:
            break
        order = np.argsort(-state.gain[row, col], kind="stable")
        limit = 1 if rounds < 2 else 2 ** (rounds - 1)
        row, col = _one_to_one(row[order], col[order], limit)
        state = accept(problem, state, row, col)
    return state


def _recognise(
    config: AssociationConfig, problem: Problem, state: PairingState, *, vague: bool
) -> PairingState:
    """Pair together what could not be paired one by one.

    After a lap the cones of the start are predicted with an uncertainty that may
    exceed their spacing (``vague``), and cones in a cluster are ambiguous even when
    they are not; but all are displaced together. Each possible pair is tried as a
    seed that fixes this common displacement, and the rest follow. The best
    constellation is taken if it has enough cones (`CONSTELLATION` vague ones, or
    `CLUSTER`) and its log-likelihood leads every other's by `ambiguity_d2`.
    """
    enough = CONSTELLATION if vague else CLUSTER
    loose = largest_sigma(state.cov) > problem.loose_m
    free = problem.allowed & state.free
    free &= (loose == vague) & (state.pair_d2 <= config.gate_d2)
    if not vague:
        free &= _clustered(free, state.h)[:, None]
    row, col = np.nonzero(free)
    if len(np.unique(row)) < enough:
        return state
    order = np.argsort(state.pair_d2[row, col], kind="stable")[:MAX_SEEDS]
    tried = []
    for i, j in zip(row[order], col[order], strict=True):
        seeded = accept(problem, state, np.array([i]), np.array([j]))
        tried.append(_advance(config, problem, seeded))
    best = max(tried, key=lambda s: s.score)
    settled = best.column >= 0
    if settled.sum() - (state.column >= 0).sum() < enough:
        return state
    rivals = [s for s in tried if (s.column[settled] != best.column[settled]).any()]
    runner_up = max((s.score for s in rivals), default=state.score)
    return best if best.score - runner_up >= config.ambiguity_d2 else state


def _clustered(free: Mask, h: Array) -> Mask:
    """(m,) whether an observation has several candidates, all in one cluster."""
    several = free.sum(axis=1) > 1
    highest = np.where(free[..., None], h, -np.inf).max(axis=1)
    lowest = np.where(free[..., None], h, np.inf).min(axis=1)
    size = np.where(several[:, None], highest - lowest, np.inf)
    together: Mask = several & (np.hypot(size[:, 0], size[:, 1]) < CLUSTER_M)
    return together


def _beats_rivals(weighed: Array, margin: float) -> Mask:
    """(m, k) whether a pair is better than any other of its row and column."""
    return _leads(weighed, margin) & _leads(weighed.T, margin).T


def _leads(weighed: Array, margin: float) -> Mask:
    """(m, k) whether a pair, if possible, is better than any other of its column."""
    if len(weighed) < 2:
        return np.ones(weighed.shape, dtype=bool)
    least, second = np.partition(weighed, 1, axis=0)[:2]
    leads: Mask = weighed <= np.where(second >= least + margin, least, -np.inf)
    return leads


def _one_to_one(row: IntArray, col: IntArray, limit: int) -> tuple[IntArray, IntArray]:
    """Return the first pairs, at most ``limit``, with no row or column repeated."""
    taken_rows: set[int] = set()
    taken_cols: set[int] = set()
    chosen: list[int] = []
    for n, (i, j) in enumerate(zip(row.tolist(), col.tolist(), strict=True)):
        if len(chosen) == limit:
            break
        if i not in taken_rows and j not in taken_cols:
            taken_rows.add(i)
            taken_cols.add(j)
            chosen.append(n)
    return row[chosen], col[chosen]
