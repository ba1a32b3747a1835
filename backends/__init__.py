"""Back ends: from cones in the car frame to a pose and a cone map."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from conegraph.backends.base import Backend, FrameEvents
    from conegraph.backends.registry import make_backend

__all__ = ["Backend", "FrameEvents", "make_backend"]

_HOME = {"Backend": "base", "FrameEvents": "base", "make_backend": "registry"}


def __getattr__(name: str) -> object:
    """Import what is asked for when it is asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
