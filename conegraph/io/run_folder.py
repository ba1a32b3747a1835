"""Reading back what a run wrote, finished or killed.

The layout is checked to the letter, but values are not judged: a run that ended in
NaN must be readable, so that it can be said that it did.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import read_text
from conegraph.io.run_rows import (
    AssociationRows,
    ConsistencyRows,
    MotionRows,
    Names,
    ObservationRows,
    PoseCovariances,
    StatusRows,
)
from conegraph.io.run_writer import (
    ASSOCIATIONS,
    CONSISTENCY,
    HEADERS,
    MAP,
    MOTION,
    OBSERVATIONS,
    POSE_COV,
    SMOOTHED,
    STATUS,
    SUMMARY,
    TIMING,
    TRAJECTORY,
    RunWriter,
)
from conegraph.types import (
    CLASS_LABELS,
    Array,
    ConeMap,
    IntArray,
    MatchStatus,
    Status,
    Trajectory,
)

__all__ = [
    "AssociationRows",
    "ConsistencyRows",
    "MotionRows",
    "ObservationRows",
    "PoseCovariances",
    "RunFolder",
    "RunWriter",
    "StatusRows",
    "read_run",
]

T = TypeVar("T")

_SINCE_LATER = (CONSISTENCY, POSE_COV, MOTION, OBSERVATIONS)
"""Files that finished runs of older versions do not have."""

_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where each entry of a covariance (3, 3) is in its row of upper entries."""


@dataclass(frozen=True, slots=True)
class RunFolder:
    """Everything that a run wrote down.

    Attributes:
        folder: where it was read from.
        trajectory: the causal estimate, one pose a frame.
        smoothed: the final estimate of the path, None where the run has none.
        cone_map: the last map written; empty if the run was killed before any.
        associations: what became of each observation.
        timing_ms: times by stage; the stage ``frame`` is the whole.
        status: the status after each frame.
        summary: ``summary.json``; empty if the run did not finish.
        consistency: the innovation of each frame; empty in older runs.
        pose_cov: the covariance of each causal pose; empty in older runs.
        motion: what odometry said, frame by frame; empty in older runs.
        observations: the cones of every frame; empty in older runs.
    """

    folder: Path
    trajectory: Trajectory
    smoothed: Trajectory | None
    cone_map: ConeMap
    associations: AssociationRows
    timing_ms: Mapping[str, Array]
    status: StatusRows
    summary: Mapping[str, object]
    consistency: ConsistencyRows = field(default_factory=ConsistencyRows.empty)
    pose_cov: PoseCovariances = field(default_factory=PoseCovariances.empty)
    motion: MotionRows = field(default_factory=MotionRows.empty)
    observations: ObservationRows = field(default_factory=ObservationRows.empty)

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return bool(self.summary)


def read_run(folder: Path) -> RunFolder:
    """Read the folder that a run wrote.

    Without ``summary.json`` the run was killed or is still going: then a last line
    without its end is left out, and tables that were never begun are empty.

    Raises:
        FileFormatError: no run in the folder, or a file that is not what its name
            promises; names the line.
    """
    summary = _read_summary(folder / SUMMARY)
    finished = bool(summary)
    smoothed, cones = folder / SMOOTHED, folder / MAP
    return RunFolder(
        folder=folder,
        trajectory=_read_trajectory(folder / TRAJECTORY, finished),
        smoothed=_read_trajectory(smoothed, True) if smoothed.exists() else None,
        cone_map=_read_map(cones) if finished or cones.exists() else ConeMap.empty(),
        associations=_read_associations(folder / ASSOCIATIONS, finished),
        timing_ms=_read_timing(folder / TIMING, finished),
        status=_read_status(folder / STATUS, finished),
        summary=summary,
        consistency=_read_consistency(folder / CONSISTENCY, finished),
        pose_cov=_read_pose_cov(folder / POSE_COV, finished),
        motion=_read_motion(folder / MOTION, finished),
        observations=_read_observations(folder / OBSERVATIONS, finished),
    )


@dataclass(frozen=True, slots=True)
class _Columns:
    """Cells of a file, column by column, with the line number of the first row."""

    path: Path
    cells: Sequence[Sequence[str]]
    first_line: int

    def floats(self, column: int) -> Array:
        return np.array(self._convert(column, float, "a number"), dtype=np.float64)

    def ints(self, column: int) -> IntArray:
        return np.array(self._convert(column, int, "a whole number"), dtype=np.int64)

    def optional_floats(self, column: int) -> Array:
        def convert(cell: str) -> float:
            return float(cell) if cell else float("nan")

        return np.array(self._convert(column, convert, "a number"), dtype=np.float64)

    def classes(self, column: int) -> IntArray:
        wanted = "one of " + ", ".join(CLASS_LABELS)
        return np.array(
            self._convert(column, CLASS_LABELS.index, wanted), dtype=np.int64
        )

    def names(self, column: int, allowed: type[MatchStatus] | type[Status]) -> Names:
        wanted = "one of " + ", ".join(a.value for a in allowed)
        named = self._convert(column, lambda cell: allowed(cell).value, wanted)
        return np.array(named, dtype=np.str_)

    def _convert(self, column: int, convert: Callable[[str], T], kind: str) -> list[T]:
        cells = self.cells[column]
        try:
            return [convert(cell) for cell in cells]
        except ValueError:
            row = next(i for i, cell in enumerate(cells) if not _fits(convert, cell))
        reason = f"{cells[row]!r} is not {kind}"
        raise FileFormatError(self.path, reason, line=self.first_line + row)


def _fits(convert: Callable[[str], object], cell: str) -> bool:
    try:
        convert(cell)
    except ValueError:
        return False
    return True


def _read_columns(
    path: Path, width: int, finished: bool, separator: str = ","
) -> _Columns:
    """Read all cells of a table; an unfinished run's last line may be torn."""
    header = HEADERS.get(path.name, "")
    first_line = 2 if header else 1
    may_be_missing = not finished or path.name in _SINCE_LATER
    if may_be_missing and header and not path.exists():
        return _Columns(path, [[]] * width, first_line)
    text = read_text(path)
    lines = text.split("\n")
    if lines[-1] and finished:
        raise FileFormatError(path, "the last line has no end", line=len(lines))
    lines = lines[:-1]
    if header and lines and f"{lines[0]}\n" != header:
        wanted = f"the columns must be {header.strip()}, but are {lines[0][:80]}"
        raise FileFormatError(path, wanted, line=1)
    rows = [line.split(separator) for line in lines[first_line - 1 :]]
    for number, row in enumerate(rows, first_line):
        if len(row) != width:
            reason = f"has {len(row)} columns, not {width}"
            raise FileFormatError(path, reason, line=number)
    return _Columns(path, list(zip(*rows, strict=True)) or [[]] * width, first_line)


def _read_trajectory(path: Path, finished: bool) -> Trajectory:
    table = _read_columns(path, 8, finished, separator=" ")
    t, x, y, _, qx, qy, qz, qw = (table.floats(k) for k in range(8))
    yaw = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy**2 + qz**2))
    return Trajectory(t, np.column_stack([x, y, yaw]))


def _read_map(path: Path) -> ConeMap:
    table = _read_columns(path, 13, True)
    xx, xy, yy = (table.floats(k) for k in (9, 10, 11))
    return ConeMap(
        id=table.ints(0),
        xy_m=np.column_stack([table.floats(1), table.floats(2)]),
        cov_m2=np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2),
        class_prob=np.column_stack([table.floats(k) for k in range(4, 9)]),
        observations=table.ints(12),
    )


def _read_associations(path: Path, finished: bool) -> AssociationRows:
    """Read what became of every observation: where rows speak of one, the last holds.

    Frames are written in the order of their stamps, so what is left is in the order
    in which it was first written.
    """
    table = _read_columns(path, 5, finished)
    key = np.stack([table.floats(0), table.ints(1)], axis=1)[::-1]
    last = len(key) - 1 - np.unique(key, axis=0, return_index=True)[1]
    return AssociationRows(
        stamp_s=table.floats(0)[last],
        observation=table.ints(1)[last],
        status=table.names(2, MatchStatus)[last],
        landmark_id=table.ints(3)[last],
        d2=table.optional_floats(4)[last],
    )


def _read_timing(path: Path, finished: bool) -> dict[str, Array]:
    table = _read_columns(path, 3, finished)
    stages, ms = np.array(table.cells[1], dtype=np.str_), table.floats(2)
    return {stage: ms[stages == stage] for stage in dict.fromkeys(table.cells[1])}


def _read_status(path: Path, finished: bool) -> StatusRows:
    table = _read_columns(path, 4, finished)
    return StatusRows(
        stamp_s=table.floats(0),
        status=table.names(1, Status),
        reason=tuple(table.cells[2]),
        reset_counter=table.ints(3),
    )


def _read_consistency(path: Path, finished: bool) -> ConsistencyRows:
    table = _read_columns(path, 3, finished)
    return ConsistencyRows(table.floats(0), table.floats(1), table.ints(2))


def _read_pose_cov(path: Path, finished: bool) -> PoseCovariances:
    table = _read_columns(path, 7, finished)
    upper = np.column_stack([table.floats(k) for k in range(1, 7)])
    return PoseCovariances(table.floats(0), upper[:, _SYMMETRIC])


def _read_motion(path: Path, finished: bool) -> MotionRows:
    table = _read_columns(path, 5, finished)
    odometry = np.column_stack([table.optional_floats(k) for k in (1, 2, 3)])
    return MotionRows(table.floats(0), odometry, table.optional_floats(4))


def _read_observations(path: Path, finished: bool) -> ObservationRows:
    table = _read_columns(path, 8, finished)
    xx, xy, yy = (table.floats(k) for k in (4, 5, 6))
    return ObservationRows(
        stamp_s=table.floats(0),
        observation=table.ints(1),
        xy_m=np.column_stack([table.floats(2), table.floats(3)]),
        cov_m2=np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2),
        cone_class=table.classes(7),
    )


def _read_summary(path: Path) -> dict[str, object]:
    if not path.exists():
        return {}
    try:
        summary = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise FileFormatError(path, f"is not JSON: {error}") from error
    if not isinstance(summary, dict) or not summary:
        raise FileFormatError(path, "must hold a JSON object with a run's summary")
    return summary
