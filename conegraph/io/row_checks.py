"""Counting the rows of one table that fail a check, by reason."""

from __future__ import annotations

from collections import Counter

import numpy as np

from conegraph.io.csv_table import Mask, Table
from conegraph.io.stamps import ascending
from conegraph.types import Array


class RowChecks:
    """Counts rows that fail, under ``file: reason``, into a shared counter."""

    def __init__(self, table: Table, counter: Counter[str]) -> None:
        self._table = table
        self._counter = counter
        self._name = table.path.name.removesuffix(".gz")
        self._add("too many cells in a row", table.overlong)

    def _add(self, reason: str, rows: int) -> None:
        if rows:
            self._counter[f"{self._name}: {reason}"] += rows

    def all_rows(self) -> Mask:
        """Return a mask of every row (N,)."""
        return np.ones(len(self._table), dtype=np.bool_)

    def keep(self, candidates: Mask, sound: Mask, reason: str) -> Mask:
        """Return the candidates (N,) that are sound (N,); count the others."""
        self._add(reason, int(np.count_nonzero(candidates & ~sound)))
        return candidates & sound

    def stamps(self) -> tuple[Array, Mask]:
        """Return the column ``t`` and the rows whose stamps are usable."""
        stamp, _ = self._table.numbers("t")
        timed = self.keep(self.all_rows(), ~np.isnan(stamp), "stamp is not a number")
        return stamp, self.keep(timed, ascending(stamp), "stamp goes backwards")

    def positions(self, candidates: Mask) -> tuple[Array, Mask]:
        """Return ``x, y`` as (N, 2) and the candidates that have both."""
        xy = np.stack([self._table.numbers(name)[0] for name in ("x", "y")], axis=1)
        sound = ~(np.isnan(xy[:, 0]) | np.isnan(xy[:, 1]))
        return xy, self.keep(candidates, sound, "x or y is not a number")


def whole_numbers(table: Table, name: str) -> tuple[Array, Mask, Mask]:
    """Return a column (N,), which cells are usable as ids, and which are blank."""
    number, blank = table.numbers(name)
    return number, number == np.round(number), blank
