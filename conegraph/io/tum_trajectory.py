"""Trajectories in the format of the TUM RGB-D benchmark.

One pose a line, ``t x y z qx qy qz qw``; ours are planar: z = qx = qy = 0,
qz = sin(yaw / 2), qw = cos(yaw / 2). Lines that start with ``#`` are comments.
(Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012.)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import format_rows, parse_numbers, read_text, text_lines
from conegraph.types import Array, Trajectory

COLUMNS = "t x y z qx qy qz qw"
LEAST_QUATERNION_NORM = 0.5
"""A shorter quaternion is not a rounded unit one, but something else."""


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory; of 3D poses the plane's part (x, y, yaw) is kept.

    Unlike rows of a log, a bad line is an error: this is a result, not a stream.

    Raises:
        FileFormatError: unreadable, without a pose, or a line that is not eight
            finite numbers with a unit quaternion and a stamp that does not go back.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(text_lines(read_text(path)), 1):
        content = line.strip()
        if not content or content.startswith("#"):
            continue
        row = _parse(path, number, content)
        if rows and row[0] < rows[-1][0]:
            raise FileFormatError(path, "stamp goes backwards", line=number)
        rows.append(row)
    if not rows:
        raise FileFormatError(path, "holds no pose")
    table = np.array(rows)
    return Trajectory(table[:, 0], np.column_stack([table[:, 1:3], _yaw(table[:, 4:])]))


def _parse(path: Path, number: int, content: str) -> list[float]:
    cells = content.split()
    if len(cells) != len(COLUMNS.split()):
        reason = f"has {len(cells)} numbers instead of {COLUMNS!r}"
        raise FileFormatError(path, reason, line=number)
    row = parse_numbers(cells)
    if row is None:
        reason = f"is not finite numbers: {content[:60]!r}"
        raise FileFormatError(path, reason, line=number)
    if sum(value * value for value in row[4:]) < LEAST_QUATERNION_NORM**2:
        raise FileFormatError(path, "has no unit quaternion", line=number)
    return row


def _yaw(quaternion: Array) -> Array:
    """Return the heading (N,) of the rotated x axis; rows are qx, qy, qz, qw."""
    x, y, z, w = quaternion.T
    yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.where(yaw == -np.pi, np.pi, yaw)


def format_tum(trajectory: Trajectory) -> str:
    """Return the text of a trajectory, with numbers that read back exactly."""
    zero = np.zeros(len(trajectory))
    x, y, yaw = trajectory.pose.T
    qz, qw = np.sin(yaw / 2.0), np.cos(yaw / 2.0)
    columns = [trajectory.stamp_s, x, y, zero, zero, zero, qz, qw]
    cells = [list(map(repr, column.tolist())) for column in columns]
    return format_rows(cells).replace(",", " ")


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory; see `format_tum`."""
    path.write_text(format_tum(trajectory), encoding="utf-8", newline="\n")
