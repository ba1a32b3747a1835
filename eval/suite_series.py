"""What happened along the way in one run of a suite, small enough to keep of each."""

from __future__ import annotations

import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conegraph.errors import FileFormatError
from conegraph.eval.series import MAX_SAMPLES, PlacedMap, RunSeries
from conegraph.types import Array, IntArray

MAX_BYTES = 8_000_000
"""A series file of a suite has some 20 kB, and inflates to some 60 kB."""

_ALONG = tuple(field.name for field in fields(RunSeries))
_PLACED = tuple(field.name for field in fields(PlacedMap))


def write_series(path: Path, series: RunSeries, placed: PlacedMap) -> None:
    """Write both compressed, each array under the name of its attribute.

    Numbers become float32 and int32, which is finer than anybody can draw.
    Paths are thinned to as many points as the series has samples at most. The file
    appears under its name only when it is complete.
    """
    true_path_m = None if placed.true_path_m is None else _thin(placed.true_path_m)
    thin = replace(placed, path_m=_thin(placed.path_m), true_path_m=true_path_m)
    found = {name: getattr(series, name) for name in _ALONG}
    found |= {name: getattr(thin, name) for name in _PLACED}
    found = {name: values for name, values in found.items() if values is not None}
    columns = {k: _as(v, np.float32, np.int32) for k, v in found.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    with part.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **columns)
    part.replace(path)


def read_series(path: Path) -> tuple[RunSeries, PlacedMap]:
    """Read what `write_series` wrote, as float64 and integers again.

    Raises:
        FileFormatError: there is no such file, or it is another.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_BYTES:
            raise FileFormatError(path, f"inflates to more than {MAX_BYTES} bytes")
        with np.load(path, allow_pickle=False) as archive:
            columns = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise FileFormatError(path, f"is no series of a run: {error}") from None
    wide: dict[str, Any] = {k: _as(v, np.float64, np.int64) for k, v in columns.items()}
    try:
        along = RunSeries(**{k: v for k, v in wide.items() if k in _ALONG})
        return along, PlacedMap(**{k: v for k, v in wide.items() if k in _PLACED})
    except TypeError as error:
        raise FileFormatError(path, f"is no series of a run: {error}") from None


def _thin(path_m: Array) -> Array:
    rows = np.linspace(0, len(path_m) - 1, min(len(path_m), MAX_SAMPLES))
    return path_m[rows.astype(np.int64)]


def _as(
    values: Array | IntArray, real: type[np.floating], whole: type[np.integer]
) -> NDArray[np.generic]:
    return values.astype(real if values.dtype.kind == "f" else whole)
