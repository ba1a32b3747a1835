"""What all drawings of a report have in common: size, colours, SVG text."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

WIDTH_IN = 4.4
"""At the width of a phone, letters of a drawing this wide are as large as the text."""

HEIGHT_IN = 3.0
LETTERS_PT = 10.0
GRID_COLOUR = "#e4e4e8"
GOOD_COLOUR = "#d9d9de"
INK = "#1b1b1f"

_LINES = (
    ("#0072b2", "-", "o"),
    ("#d55e00", "--", "s"),
    ("#009e73", "-.", "^"),
    ("#cc79a7", (0, (1, 1)), "D"),
    ("#56b4e9", (0, (5, 1, 1, 1)), "v"),
    ("#e69f00", (0, (6, 2)), "P"),
    ("#000000", (0, (3, 1, 1, 1, 1, 1)), "X"),
)
"""Colours that the colour-blind tell apart (M. Okabe and K. Ito, 2008), and without
colours still dashes and markers."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """How one contender is drawn, the same in every figure."""

    colour: str
    dashes: str | tuple[int, tuple[int, ...]]
    marker: str


def strokes(names: Sequence[str]) -> dict[str, Stroke]:
    """Return a stroke a name, in order; they repeat after seven."""
    return {n: Stroke(*_LINES[i % len(_LINES)]) for i, n in enumerate(names)}


def new_axes(
    x_label: str, y_label: str, *, height_in: float = HEIGHT_IN
) -> tuple[Figure, Axes]:
    """Return an empty drawing with its axes named."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    axes.set_xlabel(x_label, fontsize=LETTERS_PT)
    axes.set_ylabel(y_label, fontsize=LETTERS_PT)
    dress(axes)
    return figure, axes


def dress(axes: Axes) -> None:
    """Give axes the report's letters, a faint grid and no frame above and right."""
    axes.tick_params(labelsize=LETTERS_PT)
    axes.grid(color=GRID_COLOUR, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def plain_decades(axis: Axis) -> None:
    """Write the decades of a logarithmic axis out: 0.01, 0.1, 1."""
    axis.set_major_locator(LogLocator(numticks=7))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_above(axes: Axes, columns: int = 3) -> None:
    """Put the legend over the drawing, where it hides nothing."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        fontsize=LETTERS_PT,
        frameon=False,
        borderaxespad=0.2,
        handlelength=2.6,
        columnspacing=1.2,
    )


def svg_text(figure: Figure, name: str) -> str:
    """Return a drawing as an ``<svg>`` element, the same bytes for the same drawing.

    Args:
        figure: the drawing.
        name: unique in the page; all ids in the drawing start with it.
    """
    text = io.StringIO()
    about = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    # Letters stay letters: smaller, and they can be searched, copied and read aloud.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "conegraph"}):
        figure.savefig(text, format="svg", metadata=about)
    drawing = text.getvalue()
    drawing = drawing[drawing.index("<svg") :].rstrip()
    # Groups are named for people who edit the file; nothing refers to them.
    drawing = re.sub(r'<g id="[^"]*"', "<g", drawing)
    ids = dict.fromkeys(re.findall(r'\bid="([^"]*)"', drawing))
    number = {found: f"{name}-{i}" for i, found in enumerate(ids)}
    return re.sub(
        r'(\bid="|href="#|url\(#)([^")]*)',
        lambda m: m[1] + number.get(m[2], m[2]),
        drawing,
    )
