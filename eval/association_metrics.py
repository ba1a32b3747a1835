"""How often an observation was given to the landmark of its own cone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.record import Record
from conegraph.io.run_folder import AssociationRows
from conegraph.types import IntArray, Mask, MatchStatus

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class AssociationMetrics(Record):
    """Associations against the true ids of the observations; shares are 0 to 1.

    A landmark stands for the cone that most of its matched and new rows show; a
    match is right if its observation shows that cone.

    Attributes:
        rows: observations in all.
        matched: observations that were matched to a landmark.
        precision: right matches / matches.
        recall: right matches / observations of cones that already had a landmark.
            Ambiguous and rejected rows, and a second landmark born for a mapped
            cone, lower it.
        false_detections: observations that show no cone.
        false_matched: of those, matched or made a landmark of.
        split_cones: cones that more than one landmark has stood for, at any time; of
            cones that are two in a faulty truth nobody can say so.

    Source: precision and recall as in C. van Rijsbergen, "Information Retrieval",
    1979, over observation-landmark pairs.
    """

    rows: int
    matched: int
    precision: float
    recall: float
    false_detections: int
    false_matched: int
    split_cones: int


def association_metrics(
    rows: AssociationRows, truth_id: IntArray, twin_id: IntArray | None = None
) -> AssociationMetrics:
    """Judge associations by the true ids of their rows.

    Args:
        rows: what became of each observation.
        truth_id: (N,) the true id of each, -1 for false detections.
        twin_id: ids that stand for two cones each (`without_twins`), if any do.
    """
    if len(truth_id) != len(rows):
        raise ValueError(f"{len(truth_id)} true ids for {len(rows)} association rows")
    matched = rows.status == MatchStatus.MATCHED
    assigned = matched | (rows.status == MatchStatus.NEW)
    _, cone = majority(rows.landmark_id[assigned], truth_id[assigned])
    right = right_rows(rows, truth_id)
    mapped = _already_mapped(right, truth_id)
    n_matched, n_mapped = int(matched.sum()), int(mapped.sum())
    right_matches = int((right & matched).sum())
    known = cone[(cone >= 0) & ~np.isin(cone, [] if twin_id is None else twin_id)]
    _, landmarks_of_cone = np.unique(known, return_counts=True)
    return AssociationMetrics(
        rows=len(rows),
        matched=n_matched,
        precision=right_matches / n_matched if n_matched else _NAN,
        recall=int((right & matched & mapped).sum()) / n_mapped if n_mapped else _NAN,
        false_detections=int((truth_id < 0).sum()),
        false_matched=int((assigned & (truth_id < 0)).sum()),
        split_cones=int((landmarks_of_cone > 1).sum()),
    )


def right_rows(rows: AssociationRows, truth_id: IntArray) -> Mask:
    """Mark the rows (N,) that show the cone which their landmark stands for.

    Args:
        rows: what became of each observation; only matched and new ones can be right.
        truth_id: (N,) true ids, -1 for false detections.
    """
    assigned = np.isin(rows.status, (MatchStatus.MATCHED, MatchStatus.NEW))
    landmark, cone = majority(rows.landmark_id[assigned], truth_id[assigned])
    shown = np.full(len(rows), -1)
    shown[assigned] = cone[np.searchsorted(landmark, rows.landmark_id[assigned])]
    right: Mask = assigned & (shown == truth_id) & (truth_id >= 0)
    return right


def majority(landmark_id: IntArray, truth_id: IntArray) -> tuple[IntArray, IntArray]:
    """Return the landmarks, ascending, and the cone each shows most often.

    Of cones shown equally often, the one with the smallest id counts.

    Args:
        landmark_id: (N,) to which landmark each observation was given.
        truth_id: (N,) which cone it shows.
    """
    pairs, count = np.unique(
        np.column_stack([landmark_id, truth_id]), axis=0, return_counts=True
    )
    order = np.lexsort((pairs[:, 1], -count, pairs[:, 0]))
    landmark, first = np.unique(pairs[order, 0], return_index=True)
    return landmark, pairs[order, 1][first]


def _already_mapped(right: Mask, truth_id: IntArray) -> Mask:
    """Mark the rows whose cone had been given its landmark in an earlier row."""
    row = np.arange(len(truth_id))
    cone, place = np.unique(truth_id, return_inverse=True)
    first = np.full(len(cone), len(truth_id))
    np.minimum.at(first, place[right], row[right])
    return (truth_id >= 0) & (row > first[place])
