"""Whether the cones of a map have the right colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.eval.matching import Matching
from conegraph.eval.record import Record
from conegraph.types import N_CLASSES, ConeClass, ConeMap, IntArray, TruthMap

ORANGES = (ConeClass.ORANGE, ConeClass.BIG_ORANGE)


@dataclass(frozen=True, slots=True)
class ColourMetrics(Record):
    """Classes of matched cones whose true class is known.

    Attributes:
        checked: matched cones whose true class is not UNKNOWN.
        errors: of those, with another class than the true one, not counting the
            next two.
        orange_size: small orange taken for big or the reverse: the colour is right.
        unknown: left UNKNOWN by the estimate.
        confusion: (5, 5) how many matched cones of each true class (row) have which
            class (column), in the order of `ConeClass`; also of UNKNOWN true class.
    """

    checked: int
    errors: int
    orange_size: int
    unknown: int
    confusion: IntArray


def colour_metrics(
    cone_map: ConeMap, truth: TruthMap, matching: Matching
) -> ColourMetrics | None:
    """Compare the classes of matched cones; a true class UNKNOWN never counts."""
    wanted = truth.cone_class[matching.truth]
    got = cone_map.cone_class[matching.estimate]
    confusion = np.zeros((N_CLASSES, N_CLASSES), dtype=np.int64)
    np.add.at(confusion, (wanted, got), 1)
    known = wanted != ConeClass.UNKNOWN
    if not known.any():
        return None
    unknown = known & (got == ConeClass.UNKNOWN)
    wrong = known & ~unknown & (got != wanted)
    size = wrong & np.isin(got, ORANGES) & np.isin(wanted, ORANGES)
    return ColourMetrics(
        checked=int(known.sum()),
        errors=int((wrong & ~size).sum()),
        orange_size=int(size.sum()),
        unknown=int(unknown.sum()),
        confusion=confusion,
    )
