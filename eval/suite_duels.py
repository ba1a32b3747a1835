"""Two contenders over the same streams: their effects in a table and a drawing."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from conegraph.eval.document import Picture, Table, TableRow
from conegraph.eval.drawing import (
    INK,
    LETTERS_PT,
    QUIET,
    Margins,
    Stroke,
    new_axes,
    svg_text,
)
from conegraph.eval.paired import Duel, Effect, p_text

DRAWN = (
    "map_rmse_aligned_m",
    "map_rmse_start_m",
    "ate_aligned_m",
    "ate_start_m",
    "frame_p50_ms",
    "frame_p99_ms",
    "peak_mb",
)
"""Ratios that are drawn; of all of them less is better."""

RULE = (
    "A difference is shown where the interval leaves out "
    '"no difference" and p is below .05; p is corrected for how many figures are '
    "looked at, the interval is that of one figure by itself."
)

BARS = (
    "Each dot is the median ratio over the same drives, its bar the 95 % interval; "
    "coloured and filled where a difference is shown, grey and hollow where none is."
)
"""How to read the drawings."""

LABEL_LETTERS = 18
"""As many stand in the margin of a drawing."""

ROW_IN = 0.38
TICKS: tuple[tuple[float, tuple[float, ...]], ...] = (
    (1.3, (0.8, 0.9, 1.0, 1.1, 1.25)),
    (2.2, (0.5, 0.7, 1.0, 1.4, 2.0)),
    (5.5, (0.2, 0.5, 1.0, 2.0, 5.0)),
    (25.0, (0.05, 0.2, 1.0, 5.0, 20.0)),
)
"""How far a scale goes, and where it is marked; what is beyond is drawn at the edge."""


def duel_table(duel: Duel) -> Table:
    """Return every effect with its interval and what it shows."""
    first, second = duel.names
    ordered = sorted(duel.effects, key=lambda e: e.metric.effect != "ratio")
    rows = tuple(
        TableRow(
            effect.metric.label,
            (effect.text(effect.size.value), *_told(effect)),
            group=(
                f"Ratio, {second} / {first}"
                if effect.metric.effect == "ratio"
                else f"Difference, {second} - {first}"
            ),
        )
        for effect in ordered
    )
    return Table(
        f"{duel.scope}. Each p is corrected for how many there are, no interval is.",
        ("size", "95 % interval", "p", "shows"),
        rows,
        words=frozenset({3}),
    )


def _told(effect: Effect) -> tuple[str, str, str]:
    """Return the interval, p and what they show, in words."""
    interval = effect.size.interval
    if not effect.known:
        return "-", "-", effect.says
    ends = f"{effect.text(interval.low)} to {effect.text(interval.high)}"
    return ends, p_text(effect.p), effect.says


def duel_picture(duel: Duel, name: str, stroke: Mapping[str, Stroke]) -> Picture | None:
    """Draw the ratios of a duel with their intervals; None where there are none.

    Args:
        duel: what to draw.
        name: of the picture, unique in the page.
        stroke: of each contender.
    """
    of_name = {e.metric.name: e for e in duel.effects if e.known}
    effects = [of_name[name] for name in reversed(DRAWN) if name in of_name]
    if not effects:
        return None
    first, second = duel.names
    margins = Margins(left=1.4, right=0.15, bottom=0.5, top=0.3)
    height_in = margins.bottom + margins.top + ROW_IN * len(effects)
    figure, axes = new_axes(f"{second} / {first}", "", margins, height_in=height_in)
    far = max(max(e.size.interval.high, 1.0 / e.size.interval.low) for e in effects)
    limit, ticks = next((t for t in TICKS if t[0] >= far), TICKS[-1])
    _scale(axes, limit, ticks, [e.metric.label for e in effects])
    for row, effect in enumerate(effects):
        _bar(axes, row, effect, limit, stroke)
    for text, x, side in (
        (f"\u2190 {second} better", 0.0, "left"),
        (f"{first} better \u2192", 1.0, "right"),
    ):
        axes.text(x, 1.02, text, ha=side, transform=axes.transAxes, fontsize=LETTERS_PT)
    see = f"Left of the line {second} is better, right of it {first}."
    return Picture(name, f"{second} beside {first}", see, svg_text(figure, name))


def _scale(
    axes: Axes, limit: float, ticks: tuple[float, ...], labels: list[str]
) -> None:
    axes.set_xscale("log")
    axes.set_xlim(1.0 / limit, limit)
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_ylim(-0.6, len(labels) - 0.4)
    shown = [fill(label, LABEL_LETTERS) for label in labels]
    axes.set_yticks(range(len(labels)), shown, fontsize=LETTERS_PT - 1.0)
    axes.axvline(1.0, color=INK, lw=1.0)


def _bar(
    axes: Axes, row: int, effect: Effect, limit: float, stroke: Mapping[str, Stroke]
) -> None:
    ends = np.array([effect.size.interval.low, effect.size.interval.high])
    low, high = np.clip(ends, 1.0 / limit, limit)
    middle = np.clip(effect.size.value, 1.0 / limit, limit)
    colour = stroke[effect.better].colour if effect.better else QUIET
    axes.plot([low, high], [row, row], color=colour, lw=2.4)
    fill = colour if effect.better else "white"
    axes.plot(middle, row, "o", mec=colour, mfc=fill, ms=6.5, mew=1.6)
