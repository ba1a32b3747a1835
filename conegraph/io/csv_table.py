"""Plain text tables of which one bad row costs one row, and no more.

Every cell is kept as text until a column is asked for, so that numbers survive
to the last bit and a malformed cell is told apart from an empty one. Sizes are
limited, also those that a compressed file unfolds to.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conegraph.errors import FileFormatError
from conegraph.types import Array

Mask = NDArray[np.bool_]

MAX_TABLE_BYTES = 512 * 2**20
"""About 70 laps of lidar cones; more is refused instead of filling the memory."""

LARGEST_NUMBER = 1e12
"""Larger magnitudes are no stamp and no length, and would overflow when squared."""


@dataclass(frozen=True)
class Table:
    """The known columns of a CSV file, cell by cell as text.

    Attributes:
        path: the file.
        cells: column name to its cells; a missing trailing cell is "".
        line: (N,) line number of each row, counted from 1.
        overlong: how many rows were left out because they had too many cells.
    """

    path: Path
    cells: dict[str, list[str]]
    line: list[int]
    overlong: int = 0

    def __len__(self) -> int:
        return len(self.line)

    def __contains__(self, name: str) -> bool:
        return name in self.cells

    def numbers(self, name: str) -> tuple[Array, Mask]:
        """Return a column as numbers (N,) and where its cells are blank (N,).

        Cells that are blank, not a number or beyond `LARGEST_NUMBER` become NaN.
        """
        cells = self.cells[name]
        try:
            filled = [cell or "nan" for cell in cells]
            values = np.fromiter(map(float, filled), np.float64, len(cells))
        except ValueError:
            parsed = map(parse_number, cells)
            values = np.array([np.nan if v is None else v for v in parsed])
        values[~(np.abs(values) <= LARGEST_NUMBER)] = np.nan
        blank = np.zeros(len(cells), dtype=np.bool_)
        for row in np.flatnonzero(np.isnan(values)).tolist():
            blank[row] = not cells[row].strip()
        return values, blank


def parse_number(cell: str) -> float | None:
    """Return a cell as a number, None if it is none or beyond `LARGEST_NUMBER`."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST_NUMBER else None


def parse_numbers(cells: Iterable[str]) -> list[float] | None:
    """Return cells as numbers, None if one of them is none."""
    values: list[float] = []
    for cell in cells:
        value = parse_number(cell)
        if value is None:
            return None
        values.append(value)
    return values


def read_text(path: Path, max_bytes: int = MAX_TABLE_BYTES) -> str:
    """Return the text of a file, unpacked if it ends in ``.gz``.

    Bytes that are not UTF-8 are replaced, so that they spoil their row only.

    Raises:
        FileFormatError: missing, unreadable, too large or a broken gzip file.
    """
    try:
        with path.open("rb") as raw:
            if path.suffix == ".gz":
                with gzip.GzipFile(fileobj=raw) as unpacked:
                    data = unpacked.read(max_bytes + 1)
            else:
                data = raw.read(max_bytes + 1)
    except (OSError, EOFError, zlib.error, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise FileFormatError(path, f"cannot be read: {reason or error}") from error
    if len(data) > max_bytes:
        raise FileFormatError(path, f"is larger than {max_bytes / 2**20:.0f} MiB")
    return data.decode("utf-8-sig", errors="replace")


def text_lines(text: str) -> list[str]:
    """Return the lines of a text, whatever system wrote them."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def header_columns(line: str) -> list[str]:
    """Return the column names in a header line, in lower case.

    The line may start with ``#``, as those of numpy and of the TUM tools do.
    """
    return [_unquoted(name).lower() for name in line.removeprefix("#").split(",")]


def read_table(
    path: Path, required: Sequence[str], optional: Iterable[str] = ()
) -> Table:
    """Read the named columns of a CSV file; others are ignored.

    The first line that is not blank is the header. Rows that are shorter count as
    having blank cells at the end; rows that are longer are left out and counted.

    Args:
        path: the file, which may be compressed (``.gz``).
        required: columns that must be there.
        optional: columns that are read where they are.

    Raises:
        FileFormatError: unreadable or empty, not text, or a required column is
            missing or named twice.
    """
    lines = text_lines(read_text(path))
    start = next((i for i, line in enumerate(lines) if line.strip()), None)
    if start is None:
        raise FileFormatError(path, "is empty")
    if "\0" in lines[start] or "\ufffd" in lines[start]:
        raise FileFormatError(path, "is not a text file", line=start + 1)
    header = header_columns(lines[start])
    index = _column_index(path, start + 1, header, required, optional)

    rows: list[list[str]] = []
    number: list[int] = []
    overlong = 0
    for at, line in enumerate(lines[start + 1 :], start + 2):
        if not line or line.isspace():
            continue
        row = line.split(",")
        if len(row) > len(header) and any(map(str.strip, row[len(header) :])):
            overlong += 1
            continue
        rows.append(row)
        number.append(at)
    return Table(path, _columns(rows, index), number, overlong)


def _column_index(
    path: Path,
    line: int,
    header: Sequence[str],
    required: Sequence[str],
    optional: Iterable[str],
) -> dict[str, int]:
    index: dict[str, int] = {}
    for name in (*required, *optional):
        found = header.count(name)
        if found > 1:
            raise FileFormatError(path, f"has column {name!r} twice", line=line)
        if found:
            index[name] = header.index(name)
        elif name in required:
            shown = ", ".join(header)[:80]
            reason = f"has no column {name!r} (it has {shown})"
            raise FileFormatError(path, reason, line=line)
    return index


def _columns(rows: list[list[str]], index: dict[str, int]) -> dict[str, list[str]]:
    width = max(index.values(), default=-1) + 1
    blank = [""] * width
    full = [r if len(r) >= width else (r + blank)[:width] for r in rows]
    return {name: [row[i] for row in full] for name, i in index.items()}


def labels(cells: Iterable[str]) -> list[str]:
    """Return cells without the spaces and quotes that spreadsheets put around."""
    return [_unquoted(cell) for cell in cells]


def _unquoted(cell: str) -> str:
    return cell.strip().strip("\"'").strip()


def find_file(folder: Path, name: str) -> Path | None:
    """Return ``folder/name`` or its compressed twin, None where neither exists."""
    plain = folder / name
    packed = folder / f"{name}.gz"
    return plain if plain.exists() else packed if packed.exists() else None


def format_rows(columns: Sequence[Sequence[str]]) -> str:
    """Return the lines of a CSV table from its columns of cells."""
    return "".join(f"{','.join(row)}\n" for row in zip(*columns, strict=True))


def exact(values: Array) -> list[str]:
    """Return the shortest texts that read back as the very same numbers."""
    return list(map(repr, np.asarray(values, dtype=np.float64).tolist()))
