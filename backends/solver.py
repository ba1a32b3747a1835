"""How graphs are solved: incrementally, in batch, and with their past summed up."""

from __future__ import annotations

from collections.abc import Iterable

import gtsam
import numpy as np

UNSOLVABLE = (RuntimeError, np.linalg.LinAlgError)
"""What gtsam and numpy raise where a system has no solution."""

WILDFIRE = 1e-3
"""Smallest change that is passed on through the tree."""


def new_isam(*, careful: bool = False) -> gtsam.ISAM2:
    """Return a solver with thresholds by kind of variable, in m and rad.

    Velocities enter almost linearly and are never linearised anew; one scalar
    threshold for all variables makes the median update twelve times slower.
    (Kaess, Johannsson, Roberts, Ila, Leonard, Dellaert, "iSAM2: Incremental
    smoothing and mapping using the Bayes tree", IJRR 2012.)

    Args:
        careful: factorise by QR instead of Cholesky, which squares the system's
            condition number and fails on long ways without a closure. An update takes
            a quarter longer.
    """
    thresholds = gtsam.ISAM2ThresholdMap()
    thresholds.insert(("x", np.array([0.05, 0.05, 0.005])))
    thresholds.insert(("l", np.array([0.05, 0.05])))
    thresholds.insert(("v", np.array([1e3, 1e3, 1e3])))
    thresholds.insert(("b", np.array([5e-4])))
    params = gtsam.ISAM2Params()
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(WILDFIRE))
    params.setRelinearizeThreshold(thresholds)
    params.relinearizeSkip = 1
    params.findUnusedFactorSlots = False
    if careful:
        params.setFactorization("QR")
    return gtsam.ISAM2(params)


def solve(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    *,
    iterations: int = 30,
    tolerance: float = 1e-6,
) -> gtsam.Values:
    """Solve a graph in batch by Levenberg-Marquardt.

    Args:
        graph: the factors.
        values: where to start, for every variable.
        iterations: at most so many.
        tolerance: relative decrease of the error at which it is solved.

    Raises:
        RuntimeError: the graph does not determine its variables.
    """
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(tolerance)
    params.setlambdaInitial(1e-9)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


def summarise(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, gone: list[int]
) -> gtsam.NonlinearFactor:
    """Marginalise variables out of a graph: one factor on those that are left.

    The graph is linearised at the values; of ``A' A x = A' b`` the rows of the
    variables that go are eliminated, and what remains on the others stays linear
    at the values for good (Schur complement).

    Args:
        graph: the factors to sum up, all of them on at least one variable.
        values: where to linearise.
        gone: keys of the variables that go.

    Raises:
        RuntimeError: the graph does not determine the variables that go.
    """
    _, rest = graph.linearize(values).eliminatePartialMultifrontal(gone)
    hessian = gtsam.HessianFactor(rest)
    return gtsam.LinearContainerFactor(hessian, restricted(values, hessian.keys()))


def restricted(values: gtsam.Values, keys: Iterable[int]) -> gtsam.Values:
    """Return only the values of the given keys."""
    wanted = set(keys)
    kept = gtsam.Values(values)
    for key in list(kept.keys()):
        if key not in wanted:
            kept.erase(key)
    return kept


def kind(key: int) -> str:
    """Return the letter of a variable's key."""
    return chr(key >> 56)


def number(key: int) -> int:
    """Return the number of a variable's key."""
    return key & ((1 << 56) - 1)
