"""A figure of a run beside what a good run shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from conegraph.eval.doctor_case import Case


@dataclass(frozen=True, slots=True)
class Evidence:
    """A figure of a run beside what a good run stays below.

    Attributes:
        measured: the figure.
        limit: what a healthy run does not exceed, in the same unit.
        at_s: the time to look at, NaN where there is none.
        text: what was measured, in words.
    """

    measured: float
    limit: float
    at_s: float
    text: str


Examine = Callable[[Case], Evidence | None]
"""Looks at one thing in a run; None where the run cannot tell."""
