"""Peak resident memory of this process and its children, one stretch at a time."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress
from pathlib import Path

_PROC = Path("/proc")


def give_back() -> None:
    """Free what nobody holds, so that a run is not charged with that of another.

    The C library keeps freed memory for later; glibc's ``malloc_trim`` returns it.
    Elsewhere nothing is returned.
    """
    gc.collect()
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


class PeakMemory:
    """Reads and resets the kernel's high-water marks; NaN where there are none.

    Linux keeps the greatest resident size of a process as ``VmHWM`` and forgets it
    when 5 is written to ``clear_refs`` (see proc(5)).
    """

    def take_mb(self) -> float:
        """Return the peak in MB since the last call, children added, and reset it."""
        try:
            peaks = [_peak_mb(folder) for folder in _family(_PROC / "self")]
        except OSError:
            return float("nan")
        return sum(peaks)


def _family(folder: Path) -> list[Path]:
    """Return a process and all that came from it."""
    found = [folder]
    for task in (folder / "task").iterdir():
        for child in (task / "children").read_text(encoding="ascii").split():
            found += _family(_PROC / child)
    return found


def _peak_mb(folder: Path) -> float:
    status = (folder / "status").read_text(encoding="utf-8")
    (line,) = (row for row in status.splitlines() if row.startswith("VmHWM:"))
    (folder / "clear_refs").write_text("5", encoding="ascii")
    return int(line.split()[1]) / 1024.0
