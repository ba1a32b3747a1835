"""Victoria Park: 4 km of real driving among trees, as gtsam ships it.

(Guivant and Nebot, "Optimization of the simultaneous localization and map-building
algorithm for real-time implementation", IEEE T-RA 17(3), 2001; the data association
is part of the file.)
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError, MissingDependencyError
from conegraph.io.cone_names import NO_CLASS
from conegraph.io.csv_table import parse_numbers, read_text, text_lines
from conegraph.types import (
    N_CLASSES,
    Array,
    ConeObservations,
    Event,
    Recording,
    SensorModel,
    VelocityObservation,
)

FILE_NAME = "victoria_park.txt"
STEP_S = 0.2
"""Nominal time between two poses; the file has no stamps."""

N_ODOMETRY = 11
N_LANDMARK = 7


@dataclass
class _Drive:
    """What the file says, pose by pose; poses are numbered from 0."""

    step: list[list[float]] = field(default_factory=list)
    trees: dict[int, list[list[float]]] = field(
        default_factory=lambda: defaultdict(list)
    )


def read_victoria_park(path: Path | None = None) -> Recording:
    """Read the drive: every pose is a frame, and most of them see no tree.

    Lines are ``ODOMETRY i j dx dy dyaw`` and ``LANDMARK i j x y``, each followed by
    the upper triangle of a *covariance*: gtsam's loader takes six numbers with this
    pattern of zeros as one (``NoiseFormatCOV``), and gives sigmas of 0.01 m,
    0.002 m and 0.002 rad to the steps. Poses and trees share one numbering.

    The file has no time; a step takes 0.2 s here. Between two poses the car is
    taken to hold u and r, as one velocity at either end of the step with covariance
    ``diag(c_xx, c_yaw) / dt^2``. r is ``dyaw / dt`` and u the least-squares speed::

        u dt sinc(dyaw / 2) = dx cos(dyaw / 2) + dy sin(dyaw / 2)

    What this leaves of the step, across the chord, is 0.9 mm rms and 4.9 mm at
    most, below the file's own sigma of 2 mm in all but the sharpest turns. At equal
    stamps the end of a step comes before the frame, and the next step after it.

    ``truth_id`` is the tree's number in the file; there is no truth to the poses.

    Args:
        path: the file; None takes the one that gtsam ships.

    Raises:
        FileFormatError: unreadable, or the chain of odometry is broken.
        MissingDependencyError: no path given and no gtsam installed.
    """
    path = _shipped_file() if path is None else path
    rejected: Counter[str] = Counter()
    drive = _parse(path, rejected)
    trees = np.array(
        [row for rows in drive.trees.values() for row in rows], dtype=np.float64
    ).reshape(-1, 6)
    return Recording(
        name=path.stem,
        stream=_stream(drive),
        sensor=_sensor(trees) if len(trees) else None,
        rejected=dict(rejected),
        # Yaw rates come from the steering angle, not from a gyro.
        yaw_rate_bias_radps=0.0,
        # One tree in two poses, thinned out after association: no stream to associate.
        ids_are_given=True,
    )


def _shipped_file() -> Path:
    spec = find_spec("gtsam")
    if spec is None or not spec.submodule_search_locations:
        raise MissingDependencyError(
            f"{FILE_NAME} comes with gtsam, which is not installed; give the file"
        )
    return Path(spec.submodule_search_locations[0]) / "Data" / FILE_NAME


def _parse(path: Path, rejected: Counter[str]) -> _Drive:
    drive = _Drive()
    pose_number: dict[int, int] = {}
    last = -1
    for line_number, line in enumerate(text_lines(read_text(path)), 1):
        tag, *cells = line.split() or [""]
        if tag == "ODOMETRY":
            row = _numbers(cells, N_ODOMETRY)
            if row is None:
                raise FileFormatError(path, "malformed ODOMETRY", line=line_number)
            start, end = int(row[0]), int(row[1])
            if not pose_number:
                pose_number[start], last = 0, start
            if start != last or end in pose_number:
                reason = f"ODOMETRY from {start} to {end} does not continue {last}"
                raise FileFormatError(path, reason, line=line_number)
            pose_number[end], last = len(pose_number), end
            drive.step.append([*row[2:6], row[10]])
        elif tag == "LANDMARK":
            row = _numbers(cells, N_LANDMARK)
            if row is None:
                rejected["malformed LANDMARK"] += 1
            elif int(row[0]) not in pose_number:
                rejected["LANDMARK from an unknown pose"] += 1
            else:
                drive.trees[pose_number[int(row[0])]].append(row[1:])
        elif tag:
            rejected["unknown tag"] += 1
    if not drive.step:
        raise FileFormatError(path, "has no line 'ODOMETRY i j dx dy dyaw ...'")
    return drive


def _numbers(cells: list[str], count: int) -> list[float] | None:
    row = parse_numbers(cells)
    if row is None or len(row) != count:
        return None
    # The noise is the upper triangle of a matrix of 2 or 3 rows, at the end.
    variances = (row[-6], row[-3], row[-1]) if count == N_ODOMETRY else row[-3::2]
    numbered = row[0].is_integer() and row[1].is_integer()
    return row if numbered and min(variances) > 0.0 else None


def _stream(drive: _Drive) -> tuple[Event, ...]:
    dx, dy, dyaw, var_x, var_yaw = np.array(drive.step).T
    half = dyaw / 2.0
    chord = dx * np.cos(half) + dy * np.sin(half)
    u = (chord / (STEP_S * np.sinc(half / np.pi))).tolist()
    r = (dyaw / STEP_S).tolist()
    cov = np.zeros((len(dx), 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = var_x / STEP_S**2, var_yaw / STEP_S**2

    stream: list[Event] = [_frame(0.0, drive.trees.get(0, []))]
    for step in range(len(dx)):
        begin, end = step * STEP_S, (step + 1) * STEP_S
        stream.append(VelocityObservation(begin, u[step], r[step], cov[step]))
        stream.append(VelocityObservation(end, u[step], r[step], cov[step]))
        stream.append(_frame(end, drive.trees.get(step + 1, [])))
    return tuple(stream)


def _frame(stamp_s: float, rows: list[list[float]]) -> ConeObservations:
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return ConeObservations(
        stamp_s,
        table[:, 1:3],
        table[:, [3, 4, 4, 5]].reshape(-1, 2, 2),
        np.full((len(table), N_CLASSES), NO_CLASS),
        table[:, 0].astype(np.int64),
    )


def _sensor(trees: Array) -> SensorModel:
    reach = np.hypot(trees[:, 1], trees[:, 2])
    side = np.abs(np.arctan2(trees[:, 2], trees[:, 1]))
    return SensorModel(
        range_sigma_m=np.zeros(3),
        bearing_sigma_rad=0.0,
        floor_m=float(np.sqrt(np.median(trees[:, [3, 5]]))),
        min_range_m=float(reach.min()),
        max_range_m=float(reach.max()),
        half_fov_rad=float(side.max()),
    )
