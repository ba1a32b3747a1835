"""``rgb.txt`` and ``depth.txt`` of the TUM RGB-D layout: a stamp and a file a line."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from conegraph.io.csv_table import parse_number, read_text, text_lines
from conegraph.io.stamps import ascending
from conegraph.types import Array, IntArray


@dataclass(frozen=True, slots=True)
class PictureList:
    """Pictures in the order of their stamps.

    Attributes:
        stamp_s: (N,) not descending.
        path: the files.
    """

    stamp_s: Array
    path: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.path)


def read_picture_list(path: Path, rejected: Counter[str]) -> PictureList:
    """Read a list of pictures; lines that make no sense are counted.

    A line is a stamp in s and a file relative to the list's folder; ``#`` begins a
    comment. A file outside that folder is not opened.

    Raises:
        FileFormatError: the list cannot be read.
    """
    stamps: list[float] = []
    files: list[Path] = []
    for line in text_lines(read_text(path)):
        words = line.split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        stamp = parse_number(words[0])
        name = PurePosixPath(words[1].strip()) if len(words) > 1 else None
        if stamp is None or name is None:
            rejected[f"{path.name}: not a stamp and a file"] += 1
        elif name.is_absolute() or ".." in name.parts or "\0" in str(name):
            rejected[f"{path.name}: file outside the folder"] += 1
        else:
            stamps.append(stamp)
            files.append(path.parent / name)
    keep = ascending(np.array(stamps))
    lost = len(stamps) - int(keep.sum())
    if lost:
        rejected[f"{path.name}: stamp out of order"] += lost
    kept = np.flatnonzero(keep).tolist()
    return PictureList(np.array(stamps)[keep], tuple(files[k] for k in kept))


def associate(first_s: Array, second_s: Array, max_gap_s: float) -> IntArray:
    """Return pairs (P, 2) of rows whose stamps belong together, in the first's order.

    Each row is used once; of all pairs within the gap the closest are made first,
    as the TUM sequences' own tool does.

    Args:
        first_s: (N,) ascending stamps.
        second_s: (M,) ascending stamps.
        max_gap_s: longest time between the two of a pair.
    """
    low = np.searchsorted(second_s, first_s - max_gap_s, "left")
    high = np.searchsorted(second_s, first_s + max_gap_s, "right")
    # Nearer ones than these few would have to be crowded out by others still nearer.
    near = np.searchsorted(second_s, first_s)
    low, high = np.maximum(low, near - 4), np.minimum(high, near + 4)
    count = np.maximum(high - low, 0)
    a = np.repeat(np.arange(len(first_s)), count)
    within = np.arange(len(a)) - np.repeat(np.cumsum(count) - count, count)
    b = np.repeat(low, count) + within
    gap = np.abs(first_s[a] - second_s[b])
    free_a, free_b = np.ones(len(first_s), bool), np.ones(len(second_s), bool)
    chosen = []
    for k in np.lexsort((b, a, gap)).tolist():
        if free_a[a[k]] and free_b[b[k]]:
            free_a[a[k]] = free_b[b[k]] = False
            chosen.append((int(a[k]), int(b[k])))
    return np.array(sorted(chosen), dtype=np.int64).reshape(-1, 2)
