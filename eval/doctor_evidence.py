"""A figure of a run beside what a good run shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from conegraph.eval.doctor_case import Case


@dataclass(frozen=True, slots=True)
class Evidence:
    """A figure of a run beside what a good run stays below.

    Attributes:
        name: what the figure is.
        unit: its unit, empty for counts and factors; of a share ``%``.
        measured: the figure; a share from 0 to 1.
        limit: what a healthy run does not exceed, likewise.
        at_s: the time to look at, NaN where there is none.
        text: what was measured, in words.
    """

    name: str
    unit: str
    measured: float
    limit: float
    at_s: float
    text: str

    @property
    def score(self) -> float:
        """How many times the limit was measured."""
        return self.measured / self.limit


Examine = Callable[[Case], Evidence | None]
"""Looks at one thing in a run; None where the run cannot tell."""
