"""The solver holds where the system is badly conditioned."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from conegraph.backends.solver import new_isam


def far_but_close_together() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Two points a micrometre sure of each other and a megametre of the world."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    far = gtsam.noiseModel.Isotropic.Sigma(2, 1e6)
    near = gtsam.noiseModel.Isotropic.Sigma(2, 1e-6)
    graph.add(gtsam.PriorFactorPoint2(L(0), np.array([1.0, 2.0]), far))
    step = np.array([3.0, 0.0])
    graph.add(gtsam.BetweenFactorPoint2(L(0), L(1), step, near))
    values.insert(L(0), np.array([1.0, 2.0]))
    values.insert(L(1), np.zeros(2))
    return graph, values


def test_a_careful_solver_solves_what_the_squared_condition_number_hides() -> None:
    with pytest.raises(RuntimeError, match="Indeterminate"):
        new_isam().update(*far_but_close_together())
    careful = new_isam(careful=True)
    careful.update(*far_but_close_together())
    np.testing.assert_allclose(careful.calculateEstimatePoint2(L(1)), [4.0, 2.0])
