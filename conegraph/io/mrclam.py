"""The UTIAS multi-robot data set (MRCLAM): real odometry, ranges and bearings.

Small robots drive among posts with barcodes in a room watched by Vicon. (Leung,
Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping
dataset", IJRR 30(8), 2011.) Only the posts are used here, not the other robots.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.geometry import wrap_angle
from conegraph.io.cone_names import NO_CLASS
from conegraph.io.csv_table import parse_numbers, read_text, text_lines
from conegraph.io.stamps import ascending
from conegraph.types import (
    N_CLASSES,
    Array,
    ConeClass,
    ConeObservations,
    Event,
    Recording,
    SensorModel,
    Trajectory,
    TruthMap,
    VelocityObservation,
)

DEPTH_PER_M = 1.025
DEPTH_OFFSET_M = 0.03
"""The camera measures how tall a barcode looks, so that what the files call range is
depth along its axis: ``1.025 r cos(bearing) + 0.03 m`` against Vicon, over all robots
of set 6. As a range it would be 0.3 m short at the edge of the view."""

RANGE_SIGMA_M = 0.07
BEARING_SIGMA_RAD = 0.012
"""Sigmas of the barcode camera against Vicon, without its gross outliers; most of the
first is that the robots' cameras differ in scale by a few percent."""

SAME_PICTURE_S = 0.02
"""Barcodes of one picture carry stamps up to a few ms apart; pictures, 0.2 s."""

U_DENSITY = 0.05**2
"""Variance of the driven distance per distance, m^2/m."""
R_DENSITY_TURN = 0.15**2
"""Variance of the heading per turned angle, rad^2/rad."""
R_DENSITY_DRIVE = 0.035**2
"""Variance of the heading per driven distance, rad^2/m."""
U_FLOOR_MPS = 0.01
R_FLOOR_RADPS = 0.01
"""Sigmas of one sample at standstill: a robot that is pushed reports nothing."""

FIRST_LANDMARK_SUBJECT = 6
"""Subjects 1 to 5 are the robots."""

SHORTEST_INTERVAL_S = 1e-3


def read_mrclam(folder: Path, robot: str) -> Recording:
    """Read one robot's drive, with Vicon's poses and posts as the truth.

    Measurements less than `SAME_PICTURE_S` apart are one frame. Left out
    and counted in `rejected` are malformed rows, other robots, barcodes that nobody
    has, and measurements outside the time of the odometry. Posts have no colour:
    all classes are equally likely. ``truth_id`` is the post's subject number. Ranges
    are corrected for what the camera really measures, see `DEPTH_PER_M`.

    The noise of the odometry is a random walk: the variance of the driven distance
    grows by 0.05^2 |u| m^2/s, that of the heading by 0.15^2 |r| + 0.035^2 |u| rad^2/s.
    A sample stands for half the time to either neighbour; its covariance is that
    density divided by this interval, plus a floor.

    Args:
        folder: holds ``Barcodes.dat``, ``Landmark_Groundtruth.dat`` and, for each
            robot, ``RobotN_Odometry.dat``, ``_Measurement.dat``, ``_Groundtruth.dat``.
        robot: which one, such as ``Robot1``.

    Raises:
        FileFormatError: a file is missing, unreadable or without a usable row.
    """
    rejected: Counter[str] = Counter()
    odometry = _read_log(folder / f"{robot}_Odometry.dat", 3, rejected)
    sightings = _read_log(folder / f"{robot}_Measurement.dat", 4, rejected)
    truth = _read_log(folder / f"{robot}_Groundtruth.dat", 4, rejected)
    posts = _read_rows(folder / "Landmark_Groundtruth.dat", 3, rejected)
    subject_of = _read_barcodes(folder / "Barcodes.dat", rejected)

    span = (float(odometry[0, 0]), float(odometry[-1, 0]))
    seen = _posts_seen(sightings, subject_of, span, rejected)
    if not len(seen):
        path = folder / f"{robot}_Measurement.dat"
        raise FileFormatError(path, f"has no usable row: {dict(rejected)}")
    sensor = _sensor(seen)
    stream: list[Event] = [*_velocities(odometry), *_frames(seen, sensor)]
    return Recording(
        name=f"{folder.resolve().name}/{robot}",
        stream=tuple(sorted(stream, key=lambda event: event.stamp_s)),
        sensor=sensor,
        truth_trajectory=Trajectory(
            truth[:, 0], np.column_stack([truth[:, 1:3], wrap_angle(truth[:, 3])])
        ),
        truth_map=TruthMap(
            posts[:, 0].astype(np.int64),
            posts[:, 1:3],
            np.full(len(posts), ConeClass.UNKNOWN, dtype=np.int64),
        ),
        rejected=dict(rejected),
        # Yaw rates come from the wheels: they slip, but have no bias.
        yaw_rate_bias_radps=0.0,
    )


def _read_rows(path: Path, n_columns: int, rejected: Counter[str]) -> Array:
    """Return the rows (N, n_columns) that start with that many finite numbers."""
    rows: list[list[float]] = []
    for line in text_lines(read_text(path)):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        row = parse_numbers(cells[:n_columns])
        if row is None or len(row) < n_columns:
            rejected[f"{path.name}: malformed row"] += 1
        else:
            rows.append(row)
    if not rows:
        raise FileFormatError(path, f"has no row of {n_columns} numbers")
    return np.array(rows)


def _read_log(path: Path, n_columns: int, rejected: Counter[str]) -> Array:
    rows = _read_rows(path, n_columns, rejected)
    keep = ascending(rows[:, 0])
    if not keep.all():
        rejected[f"{path.name}: stamp goes backwards"] += int((~keep).sum())
    return rows[keep]


def _read_barcodes(path: Path, rejected: Counter[str]) -> dict[int, int]:
    rows = _read_rows(path, 2, rejected).astype(np.int64).tolist()
    return {barcode: subject for subject, barcode in rows}


def _posts_seen(
    sightings: Array,
    subject_of: dict[int, int],
    span: tuple[float, float],
    rejected: Counter[str],
) -> Array:
    """Return rows (N, 4) of stamp, subject, true range and bearing of posts only."""
    codes = sightings[:, 1].astype(np.int64).tolist()
    subject = np.array([subject_of.get(code, 0) for code in codes])
    stamp, depth_m, bearing = sightings[:, 0], sightings[:, 2], sightings[:, 3]
    range_m = (depth_m - DEPTH_OFFSET_M) / (DEPTH_PER_M * np.cos(bearing))
    reasons = {
        "unknown barcode": subject == 0,
        "another robot": (subject > 0) & (subject < FIRST_LANDMARK_SUBJECT),
        "range not positive": range_m <= 0.0,
        "outside the time of the odometry": (stamp < span[0]) | (stamp > span[1]),
    }
    keep = np.ones(len(sightings), dtype=np.bool_)
    for reason, failed in reasons.items():
        if count := int(np.count_nonzero(keep & failed)):
            rejected[f"measurements: {reason}"] += count
        keep &= ~failed
    return np.column_stack([stamp, subject, range_m, bearing])[keep]


def _sensor(seen: Array) -> SensorModel:
    return SensorModel(
        range_sigma_m=np.array([RANGE_SIGMA_M, 0.0, 0.0]),
        bearing_sigma_rad=BEARING_SIGMA_RAD,
        min_range_m=float(seen[:, 2].min()),
        max_range_m=float(seen[:, 2].max()),
        half_fov_rad=float(np.abs(wrap_angle(seen[:, 3])).max()),
        # Posts hide one another and barcodes are often not read.
        detection_probability=0.0,
    )


def _frames(seen: Array, sensor: SensorModel) -> list[ConeObservations]:
    begin = np.flatnonzero(np.diff(seen[:, 0], prepend=-np.inf) > SAME_PICTURE_S)
    stamp = seen[begin, 0]
    range_m, bearing = seen[:, 2], seen[:, 3]
    xy = np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing)])
    cov = sensor.covariance(xy)
    prob = np.full((len(seen), N_CLASSES), NO_CLASS)
    subject = seen[:, 1].astype(np.int64)
    end = [*begin[1:].tolist(), len(seen)]
    return [
        ConeObservations(t, xy[a:b], cov[a:b], prob[a:b], subject[a:b])
        for t, a, b in zip(stamp.tolist(), begin.tolist(), end, strict=True)
    ]


def _velocities(odometry: Array) -> list[VelocityObservation]:
    stamp, u, r = odometry.T
    gap = np.diff(stamp)
    interval = (np.append(gap, gap[-1:]) + np.insert(gap, 0, gap[:1])) / 2.0
    if not len(gap):
        interval = np.ones(1)
    interval = np.maximum(interval, SHORTEST_INTERVAL_S)
    cov = np.zeros((len(stamp), 2, 2))
    cov[:, 0, 0] = U_DENSITY * np.abs(u) / interval + U_FLOOR_MPS**2
    turning = R_DENSITY_TURN * np.abs(r) + R_DENSITY_DRIVE * np.abs(u)
    cov[:, 1, 1] = turning / interval + R_FLOOR_RADPS**2
    rows = zip(stamp.tolist(), u.tolist(), r.tolist(), cov, strict=True)
    return [VelocityObservation(*row) for row in rows]
