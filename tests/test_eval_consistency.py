"""NEES against closed forms and drawn errors."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.eval.consistency import (
    independent_samples,
    innovation_consistency,
    nees,
    nees_bounds,
    pose_consistency,
    pose_nees,
)


def test_nees_in_closed_form() -> None:
    error = np.array([[0.2, 0.0, 0.01], [0.1, 0.3, 0.0]])
    cov = np.stack([np.diag([0.04, 1.0, 1e-4]), np.diag([0.01, 0.09, 1.0])])
    np.testing.assert_allclose(nees(error, cov), [2.0, 2.0])


def test_nees_counts_correlation() -> None:
    cov = np.array([[[2.0, 1.0], [1.0, 2.0]]])
    # C^-1 = [2 -1; -1 2] / 3.
    np.testing.assert_allclose(nees(np.array([[1.0, 1.0]]), cov), [2.0 / 3.0])
    np.testing.assert_allclose(nees(np.array([[1.0, -1.0]]), cov), [2.0])


def test_the_unusable_is_left_out_and_units_do_not_matter() -> None:
    cov = np.stack(
        [
            np.zeros((3, 3)),
            np.diag([1.0, -1.0, 1.0]),
            np.ones((3, 3)),
            np.full((3, 3), np.nan),
            np.diag([1e-6, 1e2, 1e-8]),
        ]
    )
    error = np.tile([1e-3, 10.0, 1e-4], (5, 1))
    values = nees(error, cov)
    assert np.isnan(values[:4]).all()
    assert values[4] == pytest.approx(3.0)


def test_headings_are_compared_around_the_circle() -> None:
    estimate = np.array([[0.0, 0.0, np.pi - 0.05]])
    truth = np.array([[0.0, 0.0, -np.pi + 0.05]])
    cov = np.diag([1.0, 1.0, 0.01])[None]
    np.testing.assert_allclose(pose_nees(estimate, cov, truth), [1.0])


def test_drawn_errors_are_consistent_and_halved_ones_are_not() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3)) * (0.1, 0.1, 0.01)
    cov = np.tile(root.T @ root, (400, 1, 1))
    error = rng.standard_normal((400, 3)) @ root
    fine = pose_consistency(error, cov, np.zeros((400, 3)))
    low, high = nees_bounds(3, 400, 0.999)
    assert low < fine.nees_per_dof < high
    # Of 400 a share of .95 has a standard deviation of .011.
    assert fine.share_inside == pytest.approx(0.95, abs=0.035)
    proud = pose_consistency(error, 0.25 * cov, np.zeros((400, 3)))
    assert proud.nees_per_dof == pytest.approx(4.0 * fine.nees_per_dof)
    assert proud.share_inside < 0.7
    assert fine.independent == pytest.approx(400, rel=0.25)
    assert fine.band.inside
    assert not proud.band.inside
    nothing = pose_consistency(error[:0], cov[:0], error[:0])
    assert nothing.poses == 0
    assert not nothing.band.inside
    assert np.isnan(nothing.nees_per_dof)


def test_bounds_in_closed_form() -> None:
    # chi² with 2 degrees of freedom has quantiles -2 ln(1 - p).
    low, high = nees_bounds(2, 1, 0.95)
    assert low == pytest.approx(-np.log(0.975))
    assert high == pytest.approx(-np.log(0.025))
    narrow = nees_bounds(3, 1000)
    assert narrow[0] == pytest.approx(1.0 - 1.96 * np.sqrt(2 / 3000), abs=2e-3)


def test_values_that_resemble_each_other_count_as_fewer() -> None:
    """x_k = a x_k-1 + e is worth n (1 - a) / (1 + a) independent values."""
    rng = np.random.default_rng(8)
    n, a = 40_000, 0.9
    series = np.zeros(n)
    for k, e in enumerate(rng.standard_normal(n - 1), 1):
        series[k] = a * series[k - 1] + e
    expected = n * (1 - a) / (1 + a)
    assert independent_samples(series) == pytest.approx(expected, rel=0.15)
    assert independent_samples(rng.standard_normal(n)) == pytest.approx(n, rel=0.1)
    assert independent_samples(np.full(50, 7.0)) == 1.0
    assert independent_samples(np.arange(50.0)) < 5.0


def test_a_path_that_is_off_all_along_says_as_little_as_one_pose() -> None:
    error = np.tile([0.2, 0.0, 0.0], (500, 1))
    cov = np.tile(np.diag([0.01, 0.01, 1e-4]), (500, 1, 1))
    m = pose_consistency(error, cov, np.zeros((500, 3)))
    assert m.nees_per_dof == pytest.approx(4.0 / 3.0)
    assert m.independent == 1.0
    assert (m.band.low, m.band.high) == pytest.approx(nees_bounds(3, 1))
    assert m.band.inside


def test_innovations_are_summed_over_all_their_degrees_of_freedom() -> None:
    rng = np.random.default_rng(2)
    dof = rng.integers(2, 20, 3000)
    nis = rng.chisquare(dof)
    nis[5] = np.nan
    m = innovation_consistency(nis, dof)
    assert m is not None
    assert (m.frames, m.dof) == (2999, int(dof.sum() - dof[5]))
    assert m.nis_per_dof == pytest.approx(np.nansum(nis) / m.dof)
    assert m.band.inside
    # chi² with n degrees of freedom has a variance of 2 n.
    half_m = 1.96 * np.sqrt(2.0 / m.dof)
    assert (m.band.low, m.band.high) == pytest.approx((1 - half_m, 1 + half_m), 1e-3)
    assert m.share_inside == pytest.approx(0.95, abs=0.015)
    proud = innovation_consistency(1.2 * nis, dof)
    assert proud is not None
    assert not proud.band.inside
    assert innovation_consistency(nis[:0], dof[:0]) is None
