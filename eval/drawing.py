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
LEGEND_ROW_IN = 0.22
NARROW = 100.0
LETTERS_PT = 10.0
GRID_COLOUR = "#e4e4e8"
GOOD_COLOUR = "#d9d9de"
INK = "#1b1b1f"
QUIET = "#77777f"

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


@dataclass(frozen=True, slots=True)
class Margins:
    """Room around the axes, in inches."""

    left: float = 0.72
    right: float = 0.25
    bottom: float = 0.5
    top: float = 0.1

    @staticmethod
    def below_legend(entries: int) -> Margins:
        """Return margins with room for a legend of so many entries above."""
        rows = -(-entries // _legend_columns(entries))
        return Margins(top=0.1 + LEGEND_ROW_IN * rows)


def strokes(names: Sequence[str]) -> dict[str, Stroke]:
    """Return a stroke a name, in order; they repeat after seven."""
    return {n: Stroke(*_LINES[i % len(_LINES)]) for i, n in enumerate(names)}


def new_axes(
    x_label: str, y_label: str, margins: Margins, *, height_in: float = HEIGHT_IN
) -> tuple[Figure, Axes]:
    """Return an empty drawing with its axes named.

    Its places are fixed, so that axes of drawings beside each other are level; a
    layout engine would also draw everything twice.
    """
    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasSVG(figure)
    width = WIDTH_IN - margins.left - margins.right
    height = height_in - margins.bottom - margins.top
    axes = figure.add_axes(
        (
            margins.left / WIDTH_IN,
            margins.bottom / height_in,
            width / WIDTH_IN,
            height / height_in,
        )
    )
    axes.set_xlabel(x_label, fontsize=LETTERS_PT)
    axes.set_ylabel(y_label, fontsize=LETTERS_PT)
    axes.tick_params(labelsize=LETTERS_PT)
    axes.grid(color=GRID_COLOUR, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def plain_decades(axis: Axis) -> None:
    """Write the decades of a logarithmic axis out: 0.01, 0.1, 1.

    Where what is drawn spans less than two, write 2 and 5 of each as well.
    """
    low, high = axis.get_view_interval()
    steps = (1.0,) if high / low > NARROW else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=steps, numticks=7))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_above(axes: Axes) -> None:
    """Put the legend over the drawing, where it hides nothing."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(-0.12, 1.0),
        ncols=_legend_columns(len(axes.get_legend_handles_labels()[1])),
        fontsize=LETTERS_PT,
        frameon=False,
        borderaxespad=0.2,
        labelspacing=0.2,
        handlelength=2.6,
        columnspacing=1.2,
    )


def _legend_columns(entries: int) -> int:
    """Return how many fit beside each other, without one left over."""
    return 2 if entries in (2, 4) else 3


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
