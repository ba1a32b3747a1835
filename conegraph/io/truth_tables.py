"""What a cone log knows of the truth: where the car was and where cones stand."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from conegraph.geometry import wrap_angle
from conegraph.io.cone_names import NOT_A_CLASS, cone_classes
from conegraph.io.csv_table import exact, format_rows, labels, read_table
from conegraph.io.row_checks import RowChecks, whole_numbers
from conegraph.types import CLASS_LABELS, Trajectory, TruthMap


def read_truth(path: Path, rejected: Counter[str]) -> Trajectory:
    """Read ``t,x,y,yaw``; bad rows are counted into ``rejected``.

    Raises:
        FileFormatError: unreadable or empty, or a column missing.
    """
    table = read_table(path, ("t", "x", "y", "yaw"))
    checks = RowChecks(table, rejected)
    stamp, keep = checks.stamps()
    xy, keep = checks.positions(keep)
    yaw, _ = table.numbers("yaw")
    keep = checks.keep(keep, ~np.isnan(yaw), "yaw is not a number")
    yaw = yaw[keep]
    outside = ~((yaw > -np.pi) & (yaw <= np.pi))
    yaw[outside] = wrap_angle(yaw[outside])
    return Trajectory(stamp[keep], np.column_stack([xy[keep], yaw]))


def read_truth_map(path: Path, rejected: Counter[str]) -> TruthMap:
    """Read ``x,y,class`` and optionally ``id``, which else is the row from 0.

    Raises:
        FileFormatError: unreadable or empty, or a column missing.
    """
    table = read_table(path, ("x", "y", "class"), ("id",))
    checks = RowChecks(table, rejected)
    xy, keep = checks.positions(checks.all_rows())
    classes = cone_classes(labels(table.cells["class"]))
    keep = checks.keep(keep, classes != NOT_A_CLASS, "unknown class name")
    ids = np.arange(len(table), dtype=np.int64)
    if "id" in table:
        number, sound, _ = whole_numbers(table, "id")
        keep = checks.keep(keep, sound, "id is not a whole number")
        ids = np.where(keep, number, -1).astype(np.int64)
        rows = np.flatnonzero(keep)
        first = np.zeros(len(table), dtype=np.bool_)
        first[rows[np.unique(ids[rows], return_index=True)[1]]] = True
        keep = checks.keep(keep, first, "id occurs twice")
    return TruthMap(ids[keep], xy[keep], classes[keep])


def format_truth(truth: Trajectory) -> str:
    """Return the text of ``truth.csv``."""
    columns = [exact(truth.stamp_s), *map(exact, truth.pose.T)]
    return "t,x,y,yaw\n" + format_rows(columns)


def format_truth_map(truth: TruthMap) -> str:
    """Return the text of ``map.csv`` with ids."""
    names = [CLASS_LABELS[c] for c in truth.cone_class.tolist()]
    ids = list(map(str, truth.id.tolist()))
    return "id,x,y,class\n" + format_rows([ids, *map(exact, truth.xy_m.T), names])
