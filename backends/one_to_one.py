"""Association of a whole frame at once, each cone to one observation at most."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from conegraph.backends.clusters import settle_clusters
from conegraph.backends.pairing_problem import Pairing, Problem
from conegraph.backends.pairing_state import PairingState, accept, conclude
from conegraph.config import AssociationConfig
from conegraph.types import Array, IntArray, Mask


def pair_one_to_one(config: AssociationConfig, problem: Problem) -> Pairing:
    """Take the assignment with the greatest likelihood of the frame as a whole.

    With ``c_ij = d2_ij + log|S_ij| + colour_ij`` and the cost n of a new cone, it
    minimises ``sum c_ij - (n - margin_j)`` over the pairs made, each row and
    column in one pair at most; pairs beyond the gate are not made (Hungarian
    method; Blackman and Popoli, "Design and Analysis of Modern Tracking Systems",
    1999, section 6.4). A pair stays only if no assignment that gives either of the
    two to another costs less than `ambiguity_d2` more.

    Each pair is weighed by its own covariance: what the frame's cones have in
    common, the car's drift, is not used; `sequential` and `jcbb` use it.
    """
    state = PairingState.start(problem)
    possible = problem.allowed & (state.pair_d2 <= config.gate_d2)
    possible &= state.gain >= problem.margin
    cost = np.where(possible, problem.margin - state.gain, np.inf)
    column = assign(cost)
    column[~unambiguous(cost, column, config.ambiguity_d2)] = -1
    row = np.flatnonzero(column >= 0)
    if len(row):
        state = accept(problem, state, row, column[row])
    return conclude(config, problem, settle_clusters(config, problem, state))


def assign(cost: Array) -> IntArray:
    """Return the column (m,) of each row in the cheapest assignment, -1 for none.

    Args:
        cost: (m, k) of the pairs beside leaving both alone; infinite if forbidden.
    """
    m, k = cost.shape
    alone = np.zeros((m, m))
    _, column = linear_sum_assignment(np.hstack([cost, alone]))
    return np.where(column < k, column, -1).astype(np.int64)


def unambiguous(cost: Array, column: IntArray, margin: float) -> Mask:
    """(m,) whether each row's pair leads all assignments with another by a margin.

    Another is one in which the row or its column is in a different pair. Only what
    a chain of possible pairs connects can change places, so each such component of
    the problem is looked at alone.
    """
    clear = column >= 0
    for rows, columns in _components(np.isfinite(cost)):
        part = cost[np.ix_(rows, columns)]
        place = np.searchsorted(columns, column[rows])
        pairs = [(i, int(place[i])) for i in np.flatnonzero(column[rows] >= 0).tolist()]
        best = sum(part[pair] for pair in pairs)
        for i, j in pairs:
            rival = min(
                _cheapest_elsewhere(part, i, j), _cheapest_elsewhere(part.T, j, i)
            )
            clear[rows[i]] = rival - best >= margin
    return clear


def _components(possible: Mask) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield rows and columns, ascending, that possible pairs connect."""
    m, k = possible.shape
    edges = np.zeros((m + k, m + k), dtype=bool)
    edges[:m, m:] = possible
    n, label = connected_components(csr_array(edges), directed=False)
    size = np.bincount(label, minlength=n)
    for part in np.flatnonzero(size > 2).tolist():
        member = np.flatnonzero(label == part)
        yield member[member < m], member[member >= m] - m


def _cheapest_elsewhere(cost: Array, i: int, j: int) -> float:
    """Return the cost of the best assignment with row i in a pair other than j's."""
    columns = np.flatnonzero(np.isfinite(cost[i]))
    cheapest = np.inf
    for other in columns[columns != j].tolist():
        rest = np.delete(np.delete(cost, i, axis=0), other, axis=1)
        column = assign(rest)
        row = np.flatnonzero(column >= 0)
        total = cost[i, other] + rest[row, column[row]].sum()
        cheapest = min(cheapest, float(total))
    return cheapest
