"""A measured figure beside what it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from conegraph.eval.record import Record


@dataclass(frozen=True, slots=True)
class Figure(Record):
    """One row of a verdict table.

    Attributes:
        name: what was measured, on what.
        target: what it should be, in words.
        measured: what it is, in words.
        met: whether that is enough; None where nothing was measured.
        values: the numbers behind it, by name.
    """

    name: str
    target: str
    measured: str
    met: bool | None
    values: dict[str, float]


def not_measured(name: str, target: str) -> Figure:
    """Return a row that says that nothing was measured."""
    return Figure(name, target, "not measured", None, {})


def at_most(name: str, values: Sequence[float], limit: float) -> Figure:
    """Return a figure whose median must not exceed a limit.

    Values that are not finite count as infinitely bad.
    """
    target = f"≤ {limit:g}"
    if len(values) == 0:
        return not_measured(name, target)
    bad = np.where(np.isfinite(values), values, np.inf)
    median, worst = float(np.median(bad)), float(np.max(bad))
    measured = f"{median:.3g} (worst {worst:.3g}, n {len(bad)})"
    found = {"median": median, "worst": worst, "n": float(len(bad))}
    return Figure(name, target, measured, median <= limit, found)


def at_least(name: str, values: Sequence[float], limit: float) -> Figure:
    """Return a figure whose mean must reach a limit; what is not known counts as 0."""
    target = f"≥ {limit:g}"
    if len(values) == 0:
        return not_measured(name, target)
    shares = np.nan_to_num(np.array(values), nan=0.0)
    mean, worst = float(shares.mean()), float(shares.min())
    found = {"mean": mean, "worst": worst, "n": float(len(shares))}
    measured = f"{mean:.4f} (worst {worst:.3f}, n {len(shares)})"
    return Figure(name, target, measured, mean >= limit, found)


def none_of(name: str, counts: Sequence[int]) -> Figure:
    """Return a figure that counts what should never happen, over runs."""
    if len(counts) == 0:
        return not_measured(name, "0")
    total, runs = sum(counts), sum(count > 0 for count in counts)
    measured = f"{total} (in {runs} of {len(counts)} runs)"
    found = {"total": float(total), "runs": float(runs), "n": float(len(counts))}
    return Figure(name, "0", measured, total == 0, found)


def near_one(name: str, values: Sequence[float]) -> Figure:
    """Return a mean over independent runs, which chi² says should be one."""
    target = "0.8 to 1.25"
    known = np.array([value for value in values if np.isfinite(value)])
    if len(known) == 0:
        return not_measured(name, target)
    mean, median = float(known.mean()), float(np.median(known))
    found = {"mean": mean, "median": median, "worst": float(known.max())}
    measured = (
        f"{mean:.3g} (median {median:.3g}, worst {known.max():.3g}, n {len(known)})"
    )
    return Figure(name, target, measured, 0.8 <= mean <= 1.25, found)


def render_figures(figures: Sequence[Figure], title: str) -> Table:
    """Return a table for the terminal: figure, target, measured, met or not."""
    table = Table(title=title, title_justify="left")
    for heading in ("figure", "target", "measured", "met"):
        table.add_column(heading, overflow="fold")
    words = {True: "yes", False: "NO", None: "-"}
    for figure in figures:
        table.add_row(figure.name, figure.target, figure.measured, words[figure.met])
    return table
