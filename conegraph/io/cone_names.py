"""What files call a cone, and how sure a name makes us of its class."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from conegraph.types import N_CLASSES, Array, ConeClass, IntArray

HARD_LABEL_PROBABILITY = 0.9
"""How far a bare label is trusted: detectors confuse about one colour in ten."""

NO_CLASS = 1.0 / N_CLASSES
"""Probability of each class for a cone of which nothing is said."""

NOT_A_CLASS = -1

_NAMES: dict[str, ConeClass] = {
    **{c.label: c for c in ConeClass},
    "small_orange": ConeClass.ORANGE,
    "orange_small": ConeClass.ORANGE,
    "large_orange": ConeClass.BIG_ORANGE,
    "orange_large": ConeClass.BIG_ORANGE,
    "orange_big": ConeClass.BIG_ORANGE,
}


def cone_class(name: str) -> ConeClass | None:
    """Return the class that a name stands for, None if it is not a cone's name.

    Case does not matter, and ``-`` or a space stands for ``_``.
    """
    return _NAMES.get(name.strip().lower().replace("-", "_").replace(" ", "_"))


def cone_classes(names: Iterable[str]) -> IntArray:
    """Return the classes (N,) of many names; `NOT_A_CLASS` for unknown names."""
    found = [cone_class(name) for name in names]
    codes = [NOT_A_CLASS if c is None else int(c) for c in found]
    return np.array(codes, dtype=np.int64)


def hard_class_prob(classes: IntArray) -> Array:
    """Return class probabilities (N, 5) for bare labels (N,).

    The labelled class gets `HARD_LABEL_PROBABILITY` and the others share the rest;
    ``UNKNOWN`` and anything that is no class say nothing: 0.2 everywhere.
    """
    rest = (1.0 - HARD_LABEL_PROBABILITY) / (N_CLASSES - 1)
    table = np.full((N_CLASSES, N_CLASSES), rest)
    np.fill_diagonal(table, HARD_LABEL_PROBABILITY)
    table[ConeClass.UNKNOWN] = NO_CLASS
    known = np.where((classes >= 0) & (classes < N_CLASSES), classes, ConeClass.UNKNOWN)
    prob: Array = table[known]
    return prob
