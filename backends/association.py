"""Which observation is which cone: three methods, one result.

All work on the cones of the map predicted into the car frame with their joint
covariance, so that they know nothing of the estimator behind it.
"""

from __future__ import annotations

import numpy as np

from conegraph.backends.pairing_problem import Pairing, Problem, mahalanobis
from conegraph.backends.sequential import pair_sequentially
from conegraph.config import AssociationConfig


def associate(config: AssociationConfig, problem: Problem) -> Pairing:
    """Pair observations with predicted cones by the configured method."""
    m, k = problem.cost.shape
    if m == 0 or k == 0:
        none = np.full(m, -1, dtype=np.int64)
        nowhere = np.full(m, np.inf)
        return Pairing(none, nowhere, nowhere, np.zeros(k, dtype=bool))
    if config.method == "nearest":
        return pair_nearest(config, problem)
    if config.method == "known":
        return pair_known(problem)
    return pair_sequentially(config, problem)


def pair_known(problem: Problem) -> Pairing:
    """Give each observation the one cone it is allowed to have, however far."""
    predicted = problem.predicted
    d2, _ = mahalanobis(
        problem.xy_m, problem.noise_m2, predicted.xy_m, predicted.cov_m2
    )
    d2 = np.where(problem.allowed, d2, np.inf)
    known = problem.allowed.any(axis=1)
    column = np.where(known, problem.allowed.argmax(axis=1), -1)
    loose = np.zeros(d2.shape[1], dtype=bool)
    return Pairing(column, d2.min(axis=1), np.full(len(d2), np.inf), loose)


def pair_nearest(config: AssociationConfig, problem: Problem) -> Pairing:
    """Give each observation its nearest cone of the same type (section 4.4.3).

    Every observation decides alone, so two of them may share a cone.
    """
    predicted = problem.predicted
    d2, _ = mahalanobis(
        problem.xy_m, problem.noise_m2, predicted.xy_m, predicted.cov_m2
    )
    d2 = np.where(problem.allowed, d2, np.inf)
    nearest = d2.argmin(axis=1).astype(np.int64)
    best = d2.min(axis=1)
    column = np.where(best <= config.gate_d2, nearest, -1)
    return Pairing(column, best, best, np.zeros(d2.shape[1], dtype=bool))
