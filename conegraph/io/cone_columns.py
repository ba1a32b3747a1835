"""The columns that describe a cone in every CSV file of ours."""

from __future__ import annotations

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.cone_names import (
    NO_CLASS,
    NOT_A_CLASS,
    cone_classes,
    hard_class_prob,
)
from conegraph.io.csv_table import Mask, Table, labels
from conegraph.types import CLASS_LABELS, N_CLASSES, Array, ConeClass

COV_COLUMNS = ("cov_xx", "cov_xy", "cov_yy")
CLASS_COLUMNS = tuple(f"p_{label}" for label in CLASS_LABELS)

SMALLEST_SIGMA = 1e-6
LARGEST_SIGMA = 1e3
"""Sigmas outside are no property of a sensor, whatever their unit."""

SUM_TOLERANCE = 1e-9
"""Probabilities that sum to 1 so closely are taken as they are, to the last bit."""


def complete(table: Table, names: tuple[str, ...]) -> bool:
    """Return whether all columns of a group are there, or none.

    Raises:
        FileFormatError: some are there and some are not.
    """
    missing = [name for name in names if name not in table]
    if missing and len(missing) < len(names):
        reason = f"has no column {missing[0]!r}, but others of {', '.join(names)}"
        raise FileFormatError(table.path, reason)
    return not missing


def covariance_column(
    table: Table, names: tuple[str, ...] = COV_COLUMNS
) -> tuple[Array, Mask] | None:
    """Return covariances (N, 2, 2) and which are sound (N,); None without columns.

    Sound are finite, positive definite matrices with sigmas between 1e-6 and 1e3
    along both axes.
    """
    if not complete(table, names):
        return None
    a, b, c = (table.numbers(name)[0] for name in names)
    mean, spread = (a + c) / 2.0, np.hypot((a - c) / 2.0, b)
    # det / largest keeps the digits that mean - spread loses.
    largest = mean + spread
    with np.errstate(divide="ignore", invalid="ignore"):
        smallest = (a * c - b * b) / largest
    sound = (
        (a > 0)
        & (c > 0)
        & (smallest >= SMALLEST_SIGMA**2)
        & (largest <= LARGEST_SIGMA**2)
    )
    return np.stack([np.stack([a, b], -1), np.stack([b, c], -1)], -2), sound


def class_prob_column(table: Table) -> tuple[Array, Mask, Mask]:
    """Return class probabilities (N, 5), whose names are known and which are sound.

    ``p_*`` columns are scaled to sum to 1. Where they are blank, ``class`` counts
    as a label; a row with neither, and one whose ``p_*`` make no sense, gets 0.2
    everywhere. The masks (N,) say whether the class name is known or not needed,
    and whether the ``p_*`` made sense or were not given.
    """
    n = len(table)
    known = np.ones(n, dtype=np.bool_)
    prob = np.full((n, N_CLASSES), NO_CLASS)
    if "class" in table:
        names = labels(table.cells["class"])
        blank = np.array([not name for name in names], dtype=np.bool_)
        classes = cone_classes(names)
        known = blank | (classes != NOT_A_CLASS)
        prob = hard_class_prob(np.where(blank, ConeClass.UNKNOWN, classes))
    if not complete(table, CLASS_COLUMNS):
        return prob, known, np.ones(n, dtype=np.bool_)
    columns = [table.numbers(name) for name in CLASS_COLUMNS]
    given = np.stack([values for values, _ in columns], axis=1)
    unsaid = np.stack([blank for _, blank in columns], axis=1).all(axis=1)
    total = given.sum(axis=1)
    sound = (given >= 0.0).all(axis=1) & (total > 0.0)
    prob[~unsaid & ~sound] = NO_CLASS
    scale = np.where(np.abs(total - 1.0) <= SUM_TOLERANCE, 1.0, total)
    prob[sound] = given[sound] / scale[sound, None]
    return prob, known | sound, sound | unsaid
