"""Tables on the terminal, and the same figures in a file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from conegraph.io.plain import to_plain

if TYPE_CHECKING:
    from conegraph.bench.figure import Figure

WIDTH_WITHOUT_TERMINAL = 100
WIDTH_OF_FIGURES = 120


def console(width: int = WIDTH_WITHOUT_TERMINAL) -> Console:
    """Return where tables are printed: as wide as the terminal, if there is one."""
    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=width)


def show_figures(figures: Sequence[Figure], title: str, file: Path | None) -> None:
    """Print the figures of a benchmark, and write them as JSON where a file is given.

    Raises:
        OSError: the file cannot be written.
    """
    from conegraph.bench.figure import render_figures

    console(WIDTH_OF_FIGURES).print(render_figures(figures, title))
    if file is not None:
        text = json.dumps({"figures": to_plain(figures)}, indent=1)
        file.write_text(text + "\n", encoding="utf-8")
