"""The exceptions that a user can cause, under one root.

Bad configuration and bad files raise one of these; bad data inside a stream is
counted and never raises; a programming error raises what Python raises.
"""

from __future__ import annotations

from pathlib import Path


class ConegraphError(Exception):
    """Root of everything that the command line turns into one line and exit 1."""


class ConfigError(ConegraphError):
    """A configuration key or value that cannot be used; the text names it."""


class FileFormatError(ConegraphError):
    """A file that is missing, unreadable or not what its name promises."""

    def __init__(
        self, path: Path | str, reason: str, *, line: int | None = None
    ) -> None:
        """Say which file, optionally which line (counted from 1), and why."""
        self.path = Path(path)
        self.line = line
        place = f"{path}" if line is None else f"{path}:{line}"
        super().__init__(f"{place}: {reason}")


class SourceError(ConegraphError):
    """A SOURCE argument that names nothing this program can open."""


class MissingDependencyError(ConegraphError):
    """An optional package or system library that the request needs is absent."""
