"""Observations whose candidates stand so close together that none can be told.

The posts of a gate stand nearer to each other than a sensor is precise. Which is
which may stay open; that it is one of them corrects the car all the same, and two
observations of one frame are two posts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from conegraph.backends.landmark_filter import add_blocks, components
from conegraph.backends.pairing_problem import Problem
from conegraph.backends.pairing_state import PairingState, accept
from conegraph.backends.sensor_noise import squared_mahalanobis
from conegraph.config import AssociationConfig
from conegraph.geometry import distances
from conegraph.types import Array, IntArray, Mask

CLUSTER_M = 0.8
"""Size of a cluster: the posts of a gate, not two cones of a boundary."""

LARGEST = 4
"""Observations and cones of the largest cluster whose pairings are all tried."""

APART_D2 = 1.0
"""Two observations of one frame nearer than this may show one cone twice."""


@dataclass(frozen=True, slots=True)
class _Cluster:
    """Observations (rows) that share candidates (columns)."""

    row: IntArray
    column: IntArray
    allowed: Mask


def settle_clusters(
    config: AssociationConfig, problem: Problem, state: PairingState
) -> PairingState:
    """Pair what a cluster leaves ambiguous, softly, and say what must be new.

    All ways to pair a cluster's observations with its cones, each at most once, the
    rest new, are weighed by their joint likelihood (Fortmann, Bar-Shalom, Scheffe,
    "Sonar tracking of multiple targets using joint probabilistic data association",
    1983). The best is taken. Its pairs get the second moment of the alternatives
    about them as additional noise, so that they say no more than "one of these".
    """
    state = replace(state, beside=_beside_matched(problem, state))
    for cluster in _clusters(config, problem, state):
        state = _settle(config, problem, state, cluster)
    return state


def _beside_matched(problem: Problem, state: PairingState) -> Mask:
    """(m,) observations without candidates, close to one that has been matched."""
    matched = state.column >= 0
    gap = distances(problem.xy_m, problem.xy_m[matched])
    near: Mask = ~matched & (gap.min(axis=1, initial=np.inf) < CLUSTER_M)
    return near & _apart(problem, matched) if near.any() else near


def _apart(problem: Problem, others: Mask) -> Mask:
    """(m,) observations that cannot show the same cone as any of the others."""
    noise = problem.noise_m2
    difference = problem.xy_m[:, None] - problem.xy_m
    d2 = squared_mahalanobis(difference, noise[:, None] + noise)
    np.fill_diagonal(d2, np.inf)
    lone: Mask = np.where(others, d2, np.inf).min(axis=1, initial=np.inf) > APART_D2
    return lone


def _clusters(
    config: AssociationConfig, problem: Problem, state: PairingState
) -> Iterator[_Cluster]:
    """Yield the clusters among the observations and cones not yet paired."""
    free = problem.allowed & state.free & (state.pair_d2 <= config.gate_d2)
    weighed = np.where(free, -state.gain, np.inf)
    free &= weighed <= weighed.min(axis=1, keepdims=True) + config.ambiguity_d2
    highest = np.where(free[..., None], state.h, -np.inf).max(axis=1)
    lowest = np.where(free[..., None], state.h, np.inf).min(axis=1)
    with np.errstate(invalid="ignore"):
        free &= (np.hypot(*(highest - lowest).T) < CLUSTER_M)[:, None]
    left: Mask = np.asarray(free.any(axis=1))
    while left.any():
        row: Mask = np.asarray(np.arange(len(left)) == left.argmax())
        while True:
            column = free[row].any(axis=0)
            more: Mask = np.asarray(free[:, column].any(axis=1))
            if (more == row).all():
                break
            row = more
        left = np.asarray(left & ~row)
        i, j = np.flatnonzero(row), np.flatnonzero(column)
        if len(i) <= LARGEST and len(j) <= LARGEST and len(i) + len(j) > 2:
            yield _Cluster(i, j, free[np.ix_(i, j)])


def _settle(
    config: AssociationConfig, problem: Problem, state: PairingState, cluster: _Cluster
) -> PairingState:
    """Take a cluster's best pairing."""
    ways = np.array(list(_ways(cluster.allowed)))
    score = np.array([_score(problem, state, cluster, way) for way in ways])
    best = ways[score.argmax()]
    weight = np.exp(0.5 * (score - score.max()))
    weight /= weight.sum()
    n_new = (ways < 0).sum(axis=1)
    fewer = score[n_new < n_new[score.argmax()]].max(initial=-np.inf)
    crowd = np.zeros(len(problem.xy_m), dtype=bool)
    crowd[cluster.row] = True
    if score.max() - fewer >= config.ambiguity_d2:
        new = np.zeros_like(crowd)
        new[cluster.row[best < 0]] = len(cluster.row) > 1
        state = replace(state, beside=state.beside | (new & _apart(problem, crowd)))
    taken = (ways[:, :, None] == best).any(axis=1) | (ways >= 0)
    known = (weight[:, None] * taken).sum(axis=0)
    kept = (best >= 0) & (known > 1.0 / (1.0 + np.exp(-0.5 * config.new_margin)))
    row, column = cluster.row[kept], cluster.column[best[kept]]
    if len(row) == 0:
        return state
    spread = state.spread_m2.copy()
    for i in np.flatnonzero(kept).tolist():
        spread[cluster.row[i]] = _spread(problem, state, cluster, ways, weight, best, i)
    soft = state.soft.copy()
    soft[row] = score.max() - np.partition(score, -2)[-2] < config.ambiguity_d2
    state = replace(state, soft=soft, spread_m2=spread)
    return accept(problem, state, row, column)


def _ways(allowed: Mask, used: tuple[int, ...] = ()) -> Iterator[tuple[int, ...]]:
    """Yield each assignment of the rows to columns, none twice, -1 for none."""
    if len(allowed) == 0:
        yield ()
        return
    for j in [-1, *np.flatnonzero(allowed[0]).tolist()]:
        if j >= 0 and j in used:
            continue
        for rest in _ways(allowed[1:], (*used, j)):
            yield (j, *rest)


def _score(
    problem: Problem, state: PairingState, cluster: _Cluster, way: IntArray
) -> float:
    """Return twice the log-likelihood of a way over "all are new"."""
    row, column = cluster.row[way >= 0], cluster.column[way[way >= 0]]
    if len(row) == 0:
        return 0.0
    index = components(column)
    S = add_blocks(state.cov[index[:, None], index], problem.noise_m2[row])
    z = (problem.xy_m[row] - state.h[column]).ravel()
    d2 = float(z @ np.linalg.solve(S, z)) + float(np.linalg.slogdet(S)[1])
    return len(row) * problem.new_cost - d2 - float(problem.cost[row, column].sum())


def _spread(
    problem: Problem,
    state: PairingState,
    cluster: _Cluster,
    ways: IntArray,
    weight: Array,
    best: IntArray,
    i: int,
) -> Array:
    """Return the second moment (2, 2) of what an observation may be instead.

    In a way that gives it another cone, that is the cones' distance; in one that
    gives its cone to another observation, the observations'.
    """
    h, y = state.h[cluster.column], problem.xy_m[cluster.row]
    total = np.zeros((2, 2))
    for way, w in zip(ways, weight, strict=True):
        other = np.flatnonzero(way == best[i])
        if way[i] >= 0:
            off = h[way[i]] - h[best[i]]
        elif len(other):
            off = y[other[0]] - y[i]
        else:
            continue
        total += w * np.outer(off, off)
    return total
