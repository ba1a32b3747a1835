"""Which rows of a log to keep so that time never runs backwards."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array


def ascending(stamp_s: Array) -> NDArray[np.bool_]:
    """Return the mask of the longest run of rows whose stamps never decrease.

    The longest non-decreasing subsequence, found by patience sorting in
    O(n log n): a single wild stamp costs one row, where comparing with the latest
    stamp would throw away all that follows a stamp in the far future. Of two rows
    that contradict each other, the earlier one stays.

    Args:
        stamp_s: (N,) stamps; rows with NaN are never kept.
    """
    keep = np.isfinite(stamp_s)
    valid = np.flatnonzero(keep)
    stamps = stamp_s[valid]
    if np.all(stamps[1:] >= stamps[:-1]):
        return keep

    # Walking from the end, with signs turned, makes ties fall to the earlier row.
    falling = (-stamps[::-1]).tolist()
    tails: list[float] = []
    tail_row: list[int] = []
    before = np.full(len(falling), -1)
    for row, value in enumerate(falling):
        place = bisect_right(tails, value)
        before[row] = tail_row[place - 1] if place else -1
        if place == len(tails):
            tails.append(value)
            tail_row.append(row)
        else:
            tails[place] = value
            tail_row[place] = row

    chosen = np.zeros(len(falling), dtype=np.bool_)
    row = tail_row[-1]
    while row >= 0:
        chosen[row] = True
        row = int(before[row])
    keep[valid] = chosen[::-1]
    return keep
