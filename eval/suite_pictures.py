"""What a benchmark's runs look like: maps, and what happened along the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from conegraph.errors import FileFormatError
from conegraph.eval.document import Picture
from conegraph.eval.matching import TWIN_DISTANCE_M, find_twins
from conegraph.eval.overlay import draw_overlays
from conegraph.eval.series import PlacedMap, RunSeries
from conegraph.eval.suite_rows import SuiteRow
from conegraph.eval.suite_series import read_series

MAP_ERROR = "map_rmse_aligned_m"
NONE = "-"

Grouped = Mapping[str, Sequence[SuiteRow]]


def by_contender(rows: Sequence[SuiteRow]) -> dict[str, list[SuiteRow]]:
    """Return the rows of each contender, those with the default profile first."""
    order = sorted({(r.profile != "default", r.contender) for r in rows})
    return {name: [r for r in rows if r.contender == name] for _, name in order}


def badness(row: SuiteRow) -> tuple[bool, float]:
    """Return what puts the worst run last: failed ones, then those with bad maps."""
    error_m = row.metrics[MAP_ERROR]
    return row.failed, error_m if math.isfinite(error_m) else math.inf


def number_text(value: float, digits: int) -> str:
    """Return a number with so many decimals, a dash where there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else NONE


def stream_kind(row: SuiteRow) -> str:
    """Return what kind of stream a row is over, in words."""
    odometry = "wheels and gyro" if row.odometry else "no odometry"
    return f"{row.sensor}, {odometry}"


def where(row: SuiteRow) -> str:
    """Return over which stream a row is, in words."""
    faults = f", {row.faults}" if row.faults else ""
    return f"{row.track}, {stream_kind(row)}{faults}, seed {row.seed}"


class SeriesFolder:
    """The series of a benchmark, each read once; what is not there is counted.

    Attributes:
        missing: rows whose series cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[str, tuple[RunSeries, PlacedMap] | None] = {}
        self.missing = 0

    def of(self, row: SuiteRow) -> tuple[RunSeries, PlacedMap] | None:
        """Return a row's series and its map, None where there is none."""
        if row.series not in self._read:
            try:
                self._read[row.series] = read_series(self._folder / row.series)
            except FileFormatError:
                self._read[row.series] = None
                self.missing += 1
        return self._read[row.series]


def truth_notes(rows: Sequence[SuiteRow], series: SeriesFolder) -> tuple[str, ...]:
    """Return which tracks have true cones that stand where only one can."""
    twins: dict[str, int] = {}
    for row in rows:
        found = series.of(row)
        if found is not None and found[1].true_xy_m is not None:
            count = len(find_twins(found[1].true_xy_m))
            twins[row.track] = max(count, twins.get(row.track, 0))
    return tuple(
        f"the truth of {track} is faulty: {count} of its pairs of cones stand closer "
        f"than {TWIN_DISTANCE_M} m, which no two cones can"
        for track, count in sorted(twins.items())
        if count
    )


def median_maps(grouped: Grouped, series: SeriesFolder) -> tuple[Picture, ...]:
    """Draw the map of each contender's median run over the truth."""
    return _maps(grouped, series, 0.5, "median")


def worst_maps(grouped: Grouped, series: SeriesFolder) -> tuple[Picture, ...]:
    """Draw the map of each contender's worst run over the truth."""
    return _maps(grouped, series, 1.0, "worst")


def _maps(
    grouped: Grouped, series: SeriesFolder, quantile: float, which: str
) -> tuple[Picture, ...]:
    maps, titles, about = {}, {}, {}
    for name, rows in grouped.items():
        ranked = sorted((r for r in rows if series.of(r) is not None), key=badness)
        if not ranked:
            continue
        row = ranked[int(quantile * (len(ranked) - 1))]
        found = series.of(row)
        if found is not None:
            failed = f" Failed: {row.reason}." if row.failed else ""
            maps[name] = found[1]
            error = number_text(row.metrics[MAP_ERROR], 3)
            titles[name] = f"{name}, {which} run: {error} m off"
            about[name] = f"{where(row)}.{failed}"
    return draw_overlays(maps, titles, about=about, prefix=f"{which}-map")


def way_pictures(
    grouped: Grouped,
    series: SeriesFolder,
    draw: Callable[..., Picture | None],
    name: str,
) -> tuple[Picture, ...]:
    """Draw something along the way, for each sensor with and without odometry.

    Runs that failed are left out: one that is lost hides all others.

    Args:
        grouped: the rows of each contender.
        series: where their series are.
        draw: takes the series of each contender, a name and a title's end.
        name: of the pictures, numbered.
    """
    kinds = sorted({stream_kind(row) for rows in grouped.values() for row in rows})
    drawn = (
        draw(sound_series(grouped, series, kind), f"{name}-{number}", f": {kind}")
        for number, kind in enumerate(kinds, 1)
    )
    return tuple(picture for picture in drawn if picture is not None)


def sound_series(
    grouped: Grouped, series: SeriesFolder, kind: str | None = None
) -> dict[str, list[RunSeries]]:
    """Return the series of each contender's runs that did not fail."""
    result = {}
    for name, rows in grouped.items():
        these = [r for r in rows if kind in (None, stream_kind(r)) and not r.failed]
        found = [series.of(row) for row in these]
        result[name] = [one[0] for one in found if one is not None]
    return result
