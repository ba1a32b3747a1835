"""Cone SLAM for Formula Student Driverless: front end, back ends, judge."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from conegraph.config import load_config
    from conegraph.pipeline import Pipeline

__all__ = ["Pipeline", "load_config"]

_HOME = {"Pipeline": "conegraph.pipeline", "load_config": "conegraph.config"}


def __getattr__(name: str) -> object:
    """Import what is asked for when it is asked for: the command line must be quick."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
