"""Association of a whole frame by joint compatibility.

(Neira and Tardos, "Data association in stochastic mapping using the joint
compatibility test", IEEE Transactions on Robotics and Automation, 2001.)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import chi2

from conegraph.backends.clusters import settle_clusters
from conegraph.backends.pairing_problem import Pairing, Problem, mahalanobis
from conegraph.backends.pairing_state import PairingState, accept, conclude
from conegraph.backends.sensor_noise import squared_mahalanobis
from conegraph.config import AssociationConfig
from conegraph.types import Array, IntArray, Mask

MAX_NODES = 1500
"""Pairs tried in one frame; then the best interpretation so far is the answer."""

PAIR_DOF = 2
"""Degrees of freedom of one pair."""


def pair_jointly(config: AssociationConfig, problem: Problem) -> Pairing:
    """Take the largest set of pairs that are compatible all together.

    Of equally large sets the one of least cost is taken, see `Interpretation`. A row
    that another set, as large and not dearer by `ambiguity_d2`, pairs otherwise stays
    unmatched, and so does a pair that, judged by all the others, does not beat
    "this is a new cone" by its cone's margin.
    """
    state = PairingState.start(problem)
    column = _Search(config, problem).best()
    row = np.flatnonzero(column >= 0)
    if len(row):
        d2, logdet = judged_by_others(problem, row, column[row])
        colour = problem.cost[row, column[row]]
        gain = problem.new_cost - d2 - logdet - colour
        kept = (gain >= problem.margin[column[row]]) & (d2 <= config.gate_d2)
        row = row[kept]
    if len(row):
        state = accept(problem, state, row, column[row])
    return conclude(config, problem, settle_clusters(config, problem, state))


@cache
def joint_gate(pairs: int, probability: float) -> float:
    """Return the quantile of chi² that so many pairs may reach together."""
    return float(chi2.ppf(probability, PAIR_DOF * pairs))


@dataclass(frozen=True, slots=True)
class Interpretation:
    """A set of compatible pairs, with what the next pair needs to be tested.

    With L the Cholesky factor of the joint innovation covariance S of the pairs and
    w = L^-1 z their whitened innovations, a pair that joins with innovation z', own
    covariance S' and covariance C to the others has

        W = L^-1 C,  D = S' - W' W,  e = z' - W' w,  d2 += e' D^-1 e,

    so that the joint test of n pairs costs O(n^2), not O(n^3).

    Attributes:
        column: (m,) the cone of each row settled so far, -1 for none.
        row: rows of the pairs, in the order in which they joined.
        chol: (2n, 2n) L.
        white: (2n,) w.
        d2: joint squared Mahalanobis distance, ``|w|^2``.
        cost: d2 and, for each pair, ``log|D| - log|R|`` and the colour's cost beyond
            the least of the row: it never decreases as pairs join.
    """

    column: IntArray
    row: tuple[int, ...] = ()
    chol: Array = field(default_factory=lambda: np.zeros((0, 0)))
    white: Array = field(default_factory=lambda: np.zeros(0))
    d2: float = 0.0
    cost: float = 0.0

    def joined_by(
        self, problem: Problem, i: int, j: int, colour: float
    ) -> Interpretation:
        """Return the interpretation in which row i is column j, too."""
        predicted, noise = problem.predicted, problem.noise_m2[i]
        used = self.column[list(self.row)]
        others = np.stack([2 * used, 2 * used + 1], axis=1).ravel()
        own = slice(2 * j, 2 * j + 2)
        n = len(others)
        W: Array = np.zeros((0, 2))
        if n:
            cross = predicted.cov_m2[others, own]
            W = solve_triangular(self.chol, cross, lower=True, check_finite=False)
        factor = np.linalg.cholesky(predicted.cov_m2[own, own] + noise - W.T @ W)
        z = problem.xy_m[i] - predicted.xy_m[j] - W.T @ self.white
        white = np.linalg.solve(factor, z)
        step = float(white @ white)
        chol = np.zeros((n + 2, n + 2))
        chol[:n, :n], chol[n:, :n], chol[n:, n:] = self.chol, W.T, factor
        column = self.column.copy()
        column[i] = j
        doubt = 2.0 * np.log(np.diag(factor)).sum() - np.linalg.slogdet(noise)[1]
        return Interpretation(
            column,
            (*self.row, i),
            chol,
            np.concatenate([self.white, white]),
            self.d2 + step,
            self.cost + step + float(doubt) + colour,
        )


class _Search:
    """Depth first through the interpretation tree, the likeliest cone first."""

    def __init__(self, config: AssociationConfig, problem: Problem) -> None:
        """Find the candidates of each row, each pair by itself."""
        self._config, self._problem = config, problem
        self._confidence = float(chi2.cdf(config.gate_d2, PAIR_DOF))
        h, cov = problem.predicted.xy_m, problem.predicted.cov_m2
        d2, logdet = mahalanobis(problem.xy_m, problem.noise_m2, h, cov)
        self._possible: Mask = problem.allowed & (d2 <= config.gate_d2)
        colour = np.where(self._possible, problem.cost, np.inf)
        least = np.where(self._possible.any(axis=1), colour.min(axis=1), 0.0)
        self._colour = problem.cost - least[:, None]
        rivals = self._possible.sum(axis=1)
        weighed = np.where(self._possible, d2 + logdet + problem.cost, np.inf)
        order = np.lexsort((weighed.min(axis=1), rivals))
        self._order: list[int] = order[rivals[order] > 0].tolist()
        self._nodes = 0
        self._pairs = 0
        self._found: list[Interpretation] = []

    def best(self) -> IntArray:
        """Return the column (m,) of each row, -1 where none or not unambiguous."""
        nothing = np.full(len(self._problem.xy_m), -1, dtype=np.int64)
        self._descend(Interpretation(nothing), 0)
        first = min(self._found, key=lambda found: found.cost)
        column = first.column.copy()
        for rival in self._found:
            if rival.cost - first.cost < self._config.ambiguity_d2:
                column[rival.column != first.column] = -1
        return column

    def _descend(self, node: Interpretation, depth: int) -> None:
        """Settle the row at this depth in every way that can still be the best."""
        left = len(self._order) - depth
        if not self._hopeful(node, left):
            return
        if left == 0:
            self._record(node)
            return
        i = self._order[depth]
        for child in sorted(self._children(node, i), key=lambda child: child.cost):
            self._descend(child, depth + 1)
        self._descend(node, depth + 1)

    def _hopeful(self, node: Interpretation, left: int) -> bool:
        """Whether nothing found so far beats all that can come of this node."""
        if not self._found:
            return True
        pairs = len(node.row) + left
        if self._nodes > MAX_NODES or pairs < self._pairs:
            return False
        least = min(found.cost for found in self._found)
        return pairs > self._pairs or node.cost - least < self._config.ambiguity_d2

    def _record(self, leaf: Interpretation) -> None:
        if len(leaf.row) > self._pairs:
            self._pairs, self._found = len(leaf.row), []
        self._found.append(leaf)

    def _children(self, node: Interpretation, i: int) -> list[Interpretation]:
        """Return the interpretations with row i paired too, the compatible ones."""
        free = self._possible[i].copy()
        free[node.column[list(node.row)]] = False
        gate = joint_gate(len(node.row) + 1, self._confidence)
        children = []
        for j in np.flatnonzero(free).tolist():
            self._nodes += 1
            child = node.joined_by(self._problem, i, j, self._colour[i, j])
            if child.d2 - node.d2 <= self._config.gate_d2 and child.d2 <= gate:
                children.append(child)
        return children


def judged_by_others(
    problem: Problem, row: IntArray, column: IntArray
) -> tuple[Array, Array]:
    """Return d² and log-determinant (n,) of each pair given all the others.

    With S the joint innovation covariance, z the innovations and P = S^-1, a pair's
    innovation given the others has covariance ``P_ii^-1`` and mean ``P_ii^-1 (P z)_i``.
    """
    index = np.stack([2 * column, 2 * column + 1], axis=1).ravel()
    S = problem.predicted.cov_m2[np.ix_(index, index)]
    n = len(row)
    blocks = S.reshape(n, 2, n, 2)
    blocks[range(n), :, range(n), :] += problem.noise_m2[row]
    P = np.asarray(np.linalg.inv(S), dtype=np.float64)
    own = P.reshape(n, 2, n, 2)[range(n), :, range(n), :]
    pull = (P @ (problem.xy_m[row] - problem.predicted.xy_m[column]).ravel()).reshape(
        n, 2
    )
    return squared_mahalanobis(pull, own), -np.linalg.slogdet(own)[1]
