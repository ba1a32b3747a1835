"""The nearest of some points: by all distances if they are few, else by a tree."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from conegraph.types import Array, IntArray

_FEW = 128
"""Up to here all distances take less time than building and asking a tree."""


class Nearest:
    """Finds the nearest of some points."""

    def __init__(self, xy_m: Array) -> None:
        """Take the points (N, 2) to be found."""
        self._xy_m = xy_m
        self._tree = cKDTree(xy_m) if len(xy_m) > _FEW else None

    def __len__(self) -> int:
        return len(self._xy_m)

    def one(self, from_m: Array) -> tuple[Array, IntArray]:
        """Return distance and row of the point nearest to each of (A, 2); (A,) each."""
        if self._tree is not None:
            away, row = self._tree.query(from_m)
            return np.asarray(away), np.asarray(row)
        all_away = cdist(from_m, self._xy_m)
        row = all_away.argmin(axis=1)
        return all_away[np.arange(len(row)), row], row

    def some(self, from_m: Array, count: int) -> tuple[Array, IntArray]:
        """Return the same of so many points or all, the nearest first; (A, K) each."""
        k = min(count, len(self))
        if self._tree is not None:
            away, row = self._tree.query(from_m, k=np.arange(1, k + 1))
            return np.asarray(away), np.asarray(row)
        all_away = cdist(from_m, self._xy_m)
        row = all_away.argsort(axis=1, kind="stable")[:, :k]
        return all_away[np.arange(len(row))[:, None], row], row
