"""Associations against true ids."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.eval.association_metrics import association_metrics
from conegraph.io.run_folder import AssociationRows


def rows(*given: tuple[str, int]) -> AssociationRows:
    n = len(given)
    return AssociationRows(
        stamp_s=np.arange(n, dtype=float),
        observation=np.zeros(n, dtype=np.int64),
        status=np.array([status for status, _ in given]),
        landmark_id=np.array([landmark for _, landmark in given], dtype=np.int64),
        d2=np.full(n, np.nan),
    )


def test_right_wrong_and_missed_associations_are_counted() -> None:
    """Landmark 0 shows cone 7, landmark 1 cone 9; one match is wrong, one missed."""
    made = rows(
        ("new", 0),
        ("new", 1),
        ("matched", 0),
        ("matched", 1),
        ("matched", 0),
        ("ambiguous", -1),
        ("matched", 0),
        ("rejected", -1),
    )
    m = association_metrics(made, np.array([7, 9, 7, 9, 9, 7, 7, -1]))
    assert (m.rows, m.matched) == (8, 4)
    assert m.precision == pytest.approx(3 / 4)
    assert m.recall == pytest.approx(3 / 5)
    assert (m.false_detections, m.false_matched, m.split_cones) == (1, 0, 0)


def test_a_second_landmark_for_a_cone_splits_it_and_costs_recall_once() -> None:
    made = rows(("new", 0), ("matched", 0), ("new", 1), ("matched", 1))
    m = association_metrics(made, np.array([7, 7, 7, 7]))
    assert m.split_cones == 1
    assert m.precision == 1.0
    assert m.recall == pytest.approx(2 / 3)


def test_a_landmark_born_from_false_detections_shows_no_cone() -> None:
    made = rows(("new", 4), ("matched", 4), ("tentative", -1))
    m = association_metrics(made, np.array([-1, -1, 3]))
    assert m.precision == 0.0
    assert (m.false_detections, m.false_matched, m.split_cones) == (2, 2, 0)
    assert np.isnan(m.recall)


def test_two_landmarks_for_cones_that_are_two_in_a_faulty_truth_are_no_split() -> None:
    made = rows(("new", 0), ("matched", 0), ("new", 1), ("matched", 1))
    m = association_metrics(made, np.array([7, 7, 7, 7]), np.array([7]))
    assert m.split_cones == 0
    assert m.precision == 1.0


def test_ids_that_do_not_pair_up_are_refused() -> None:
    with pytest.raises(ValueError, match="2 true ids for 1"):
        association_metrics(rows(("new", 0)), np.array([1, 2]))


def test_no_rows_give_no_shares() -> None:
    m = association_metrics(rows(), np.zeros(0, dtype=np.int64))
    assert np.isnan(m.precision)
    assert np.isnan(m.recall)
