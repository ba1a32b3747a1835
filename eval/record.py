"""What every result of the judge has in common: it becomes plain JSON."""

from __future__ import annotations

from typing import Any

from conegraph.io.plain import to_plain


class Record:
    """A frozen dataclass of results; numbers that do not exist are NaN."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Return nested dicts, lists, strings and numbers, with NaN as None."""
        plain = to_plain(self)
        if not isinstance(plain, dict):
            raise TypeError(f"{type(self).__name__} is not a dataclass")
        return plain
