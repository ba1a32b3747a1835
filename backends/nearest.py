"""Association by the nearest cone, each observation for itself."""

from __future__ import annotations

import numpy as np

from conegraph.backends.pairing_problem import Pairing, Problem, mahalanobis
from conegraph.config import AssociationConfig


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
