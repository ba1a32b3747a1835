"""Which observation is which cone: five methods, one result.

All work on the cones of the map predicted into the car frame with their joint
covariance, so that they know nothing of the estimator behind it.
"""

from __future__ import annotations

import numpy as np

from conegraph.backends.jcbb import pair_jointly
from conegraph.backends.known import pair_known
from conegraph.backends.nearest import pair_nearest
from conegraph.backends.one_to_one import pair_one_to_one
from conegraph.backends.pairing_problem import Pairing, Problem
from conegraph.backends.sequential import pair_sequentially
from conegraph.config import AssociationConfig


def associate(config: AssociationConfig, problem: Problem) -> Pairing:
    """Pair observations with predicted cones by the configured method."""
    m, k = problem.cost.shape
    if m == 0 or k == 0:
        none = np.full(m, -1, dtype=np.int64)
        nowhere = np.full(m, np.inf)
        return Pairing(none, nowhere, nowhere, np.zeros(k, dtype=bool))
    match config.method:
        case "known":
            return pair_known(problem)
        case "nearest":
            return pair_nearest(config, problem)
        case "one_to_one":
            return pair_one_to_one(config, problem)
        case "jcbb":
            return pair_jointly(config, problem)
        case "sequential":
            return pair_sequentially(config, problem)


def is_careful(config: AssociationConfig) -> bool:
    """Whether the method may leave a frame unmatched for lack of certainty.

    Of such a method it means something that few cones match; `nearest` is the
    thesis's and never asks, `known` never doubts.
    """
    return config.method not in ("nearest", "known")
