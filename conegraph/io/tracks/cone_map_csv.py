"""Our own ``map.csv``: what a run writes, what users give as a map or a track."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.cone_columns import (
    CLASS_COLUMNS,
    COV_COLUMNS,
    class_prob_column,
    covariance_column,
)
from conegraph.io.csv_table import Mask, Table, labels, parse_numbers, read_table
from conegraph.io.row_checks import whole_numbers
from conegraph.io.tracks.cones import ConeCollector
from conegraph.types import ConeMap, IntArray, TrackLayout

COLUMNS = ("x", "y", "class")
DEFAULT_SIGMA_M = 0.05
"""How well a surveyed map is taken to be known where it does not say."""

EXACT = 2**53
"""Whole numbers below this are told apart in a float."""


def read_map_track(path: Path) -> TrackLayout:
    """Read ``x,y,class`` as a track; bad rows are counted, other columns ignored.

    Raises:
        FileFormatError: unreadable, a column missing, or without a cone.
    """
    table = read_table(path, COLUMNS)
    cones = ConeCollector(path)
    cones.drop("malformed row", table.overlong)
    cells = table.cells
    for name, x, y in zip(labels(cells["class"]), cells["x"], cells["y"], strict=True):
        cones.add(name, parse_numbers([x, y]))
    return cones.layout()


def read_cone_map(path: Path) -> ConeMap:
    """Read a map: ``x,y,class`` and optionally the other columns of ``map.csv``.

    Missing columns mean: ``id`` is the row from 0, the covariance 0.05 m in every
    direction, ``p_*`` a label that is 90 % sure, ``observations`` 1.

    Raises:
        FileFormatError: unreadable, a column missing, or a row that makes no sense:
            a map is a result, not a stream, so it must be whole.
    """
    optional = ("id", *CLASS_COLUMNS, *COV_COLUMNS, "observations")
    table = read_table(path, COLUMNS, optional)
    if table.overlong:
        raise FileFormatError(path, f"has {table.overlong} rows with too many cells")
    n = len(table)
    xy = np.stack([table.numbers(name)[0] for name in ("x", "y")], axis=1)
    _demand(table, ~np.isnan(xy[:, 0] + xy[:, 1]), "x or y is not a number")
    prob, named, sound = class_prob_column(table)
    _demand(table, named, "unknown class name")
    _demand(table, sound, "class probabilities make no sense")
    given = covariance_column(table)
    if given is None:
        cov = np.broadcast_to(DEFAULT_SIGMA_M**2 * np.eye(2), (n, 2, 2))
    else:
        cov, sound = given
        _demand(table, sound, "covariance is not positive definite or absurd")
    ids = _whole(table, "id", np.arange(n, dtype=np.int64))
    unique = np.zeros(n, dtype=np.bool_)
    unique[np.unique(ids, return_index=True)[1]] = True
    _demand(table, unique, "id occurs twice")
    seen = _whole(table, "observations", np.ones(n, dtype=np.int64))
    return ConeMap(ids, xy, cov, prob, seen)


def _whole(table: Table, name: str, default: IntArray) -> IntArray:
    if name not in table:
        return default
    number, sound, _ = whole_numbers(table, name)
    sound &= (number >= 0) & (number < EXACT)
    _demand(table, sound, f"{name} is not a whole number from 0 on")
    return number.astype(np.int64)


def _demand(table: Table, sound: Mask, reason: str) -> None:
    if not sound.all():
        row = int(np.flatnonzero(~sound)[0])
        raise FileFormatError(table.path, reason, line=table.line[row])
