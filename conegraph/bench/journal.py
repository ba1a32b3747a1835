"""Rows as JSON lines: a benchmark that was killed goes on where it was."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

from pydantic import ValidationError


class Line(Protocol):
    """A row that a journal can hold."""

    @property
    def key(self) -> str:
        """What tells it from all others."""

    @property
    def broke_off(self) -> bool:
        """Whether it is of a run that did not come to its end."""

    def model_dump_json(self) -> str:
        """Return it as a line."""

    @classmethod
    def model_validate_json(cls, json_data: str) -> Self:
        """Read it back; raises ValidationError for what it is not."""


R = TypeVar("R", bound=Line)


class Journal(Generic[R]):
    """The rows that there are, by key; a new one is on the disk once it is added."""

    def __init__(self, path: Path, kinds: Sequence[type[R]]) -> None:
        """Read the rows that are there; what was cut off or broke off is done again.

        Args:
            path: of the file; made with the first row.
            kinds: what a line may be, the likeliest first.
        """
        self._path = path
        self._lock = threading.Lock()
        self.rows: dict[str, R] = {}
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        self._torn = bool(text) and not text.endswith("\n")
        for line in text.splitlines():
            row = _parsed(line, kinds)
            if row is not None and not row.broke_off:
                self.rows[row.key] = row

    def add(self, row: R) -> None:
        """Append a row."""
        with self._lock, self._path.open("a", encoding="utf-8") as file:
            file.write("\n" * self._torn + row.model_dump_json() + "\n")
            file.flush()
            os.fsync(file.fileno())
            self._torn = False
            self.rows[row.key] = row


def _parsed(line: str, kinds: Sequence[type[R]]) -> R | None:
    for kind in kinds:
        try:
            return kind.model_validate_json(line)
        except ValidationError:
            continue
    return None
