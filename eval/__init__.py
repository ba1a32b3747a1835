"""The judge: what a run wrote down, against the truth."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from conegraph.eval.comparison import Comparison, compare
    from conegraph.eval.judge import RunMetrics, Truth, evaluate
    from conegraph.eval.report import render_table, write_report

__all__ = [
    "Comparison",
    "RunMetrics",
    "Truth",
    "compare",
    "evaluate",
    "render_table",
    "write_report",
]

_HOME = {
    "Comparison": "comparison",
    "RunMetrics": "judge",
    "Truth": "judge",
    "compare": "comparison",
    "evaluate": "judge",
    "render_table": "report",
    "write_report": "report",
}


def __getattr__(name: str) -> object:
    """Import what is asked for when it is asked for: scipy and rich take time."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
