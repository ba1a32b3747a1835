"""Association by the ids that a source publishes."""

from __future__ import annotations

import numpy as np

from conegraph.backends.pairing_problem import Pairing, Problem, mahalanobis


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
