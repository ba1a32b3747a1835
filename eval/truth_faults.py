"""What is wrong with the truth itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.align import distance
from conegraph.eval.matching import TWIN_DISTANCE_M, find_twins, one_row_each
from conegraph.eval.record import Record
from conegraph.types import IntArray, TruthMap

MAX_NAMED = 10


@dataclass(frozen=True, slots=True)
class Twins(Record):
    """Two true cones that stand so close that a file must err (`find_twins`).

    The judge takes them for one cone (see `MapMetrics`).

    Attributes:
        ids: of the two.
        distance_m: between them, m.
    """

    ids: tuple[int, int]
    distance_m: float


def truth_faults(cones: TruthMap) -> tuple[Twins, ...]:
    """Return all twins among the true cones."""
    a, b = find_twins(cones.xy_m).T
    apart_m = distance(cones.xy_m[a], cones.xy_m[b])
    rows = zip(
        cones.id[a].tolist(), cones.id[b].tolist(), apart_m.tolist(), strict=True
    )
    return tuple(Twins((one, other), d) for one, other, d in rows)


def without_twins(ids: IntArray, cones: TruthMap) -> IntArray:
    """Return true ids (N,) with one id for both of twins; others stay as they are."""
    result = ids.copy()
    stands = one_row_each(len(cones), find_twins(cones.xy_m))
    for row in np.flatnonzero(stands != np.arange(len(cones))).tolist():
        result[ids == cones.id[row]] = cones.id[stands[row]]
    return result


def in_words(faults: Sequence[Twins]) -> list[str]:
    """Return what is to be said of the truth, nothing where it is sound."""
    if not faults:
        return []
    named = ", ".join(f"{a} and {b}" for a, b in (f.ids for f in faults[:MAX_NAMED]))
    more = ", ..." if len(faults) > MAX_NAMED else ""
    return [
        f"the truth is faulty: {len(faults)} of its pairs of cones stand closer than "
        f"{TWIN_DISTANCE_M} m, which no two cones can (ids {named}{more}); each counts "
        "as one cone"
    ]
