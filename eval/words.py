"""How things are said in sentences."""

from __future__ import annotations


def counted(count: int, what: str) -> str:
    """Return ``1 cone`` or ``2 cones``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
