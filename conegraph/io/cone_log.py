"""The cone log: a folder of plain CSV files that anyone can write.

``cones.csv`` (``t,x,y``), and optionally ``odometry.csv`` (``t,u,r``),
``truth.csv`` (``t,x,y,yaw``) and ``map.csv`` (``x,y,class``); each may be
``.csv.gz``. Columns are found by name. What a row may lack, and what it then
means, stands at `read_cone_log`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from conegraph.errors import FileFormatError
from conegraph.io.cone_columns import (
    CLASS_COLUMNS,
    COV_COLUMNS,
    class_prob_column,
    covariance_column,
)
from conegraph.io.csv_table import Mask, Table, exact, find_file, read_table
from conegraph.io.row_checks import RowChecks, whole_numbers
from conegraph.io.sensor_fit import fit_sensor_model, model_seeing
from conegraph.io.truth_tables import (
    format_truth,
    format_truth_map,
    read_truth,
    read_truth_map,
)
from conegraph.types import (
    Array,
    ConeObservations,
    Event,
    IntArray,
    Recording,
    SensorModel,
    VelocityObservation,
)

DEFAULT_RANGE_SIGMA_M = (0.05, 0.0, 0.0025)
DEFAULT_BEARING_SIGMA_RAD = 0.01
DEFAULT_U_SIGMA_MPS = 0.1
DEFAULT_R_SIGMA_RADPS = 0.01

VELOCITY_COV_COLUMNS = ("cov_uu", "cov_ur", "cov_rr")
BAD_COVARIANCE = "covariance is not positive definite or absurd"


def read_cone_log(folder: Path) -> Recording:
    """Read a cone log into memory.

    Rows of `cones.csv` with the same stamp are one frame; a row with a stamp only
    is a frame that saw no cone. Without covariance columns the default sensor
    stands in: range sigma 0.05 + 0.0025 r^2 m, bearing sigma 0.01 rad; odometry
    without them has sigmas of 0.1 m/s and 0.01 rad/s. Without ``p_*`` columns a
    ``class`` counts as 90 % sure; without either all classes are equally likely.
    At equal stamps odometry comes before cones.

    Rows that make no sense (no number, stamps running backwards, a covariance
    that is none, an unknown class) are left out and counted in `rejected`, with
    ``file: reason`` as key. Probabilities or a true id that make no sense are
    counted too, but their row stays, as if they had not been given.

    Where the log has covariances, `sensor` is fitted to them.

    Args:
        folder: the folder that holds ``cones.csv``.

    Raises:
        FileFormatError: no ``cones.csv``, an unreadable or empty file, or a
            required column missing.
    """
    path = find_file(folder, "cones.csv")
    if path is None:
        raise FileFormatError(folder / "cones.csv", "is missing: not a cone log")
    rejected: Counter[str] = Counter()
    frames, sensor = _read_frames(path, rejected)
    if not frames and not rejected:
        raise FileFormatError(path, "holds no frames")
    odometry = find_file(folder, "odometry.csv")
    velocities = read_velocities(odometry, rejected) if odometry else []
    truth = find_file(folder, "truth.csv")
    truth_map = find_file(folder, "map.csv")
    return Recording(
        name=folder.resolve().name,
        stream=_merged(velocities, frames),
        sensor=sensor,
        truth_trajectory=read_truth(truth, rejected) if truth else None,
        truth_map=read_truth_map(truth_map, rejected) if truth_map else None,
        rejected=dict(rejected),
    )


def write_cone_log(folder: Path, recording: Recording) -> None:
    """Write a recording as a cone log that reads back to the last bit.

    Parts of an older log in the same folder that this recording lacks are
    removed, so that they are not taken for its own. Not stored: the sensor model,
    which is fitted anew on reading, the order in which delayed events reached the
    computer, and that two frames had the same stamp.

    Args:
        folder: made where it does not exist.
        recording: what to write.
    """
    frames = [e for e in recording.stream if isinstance(e, ConeObservations)]
    velocities = [e for e in recording.stream if isinstance(e, VelocityObservation)]
    truth, truth_map = recording.truth_trajectory, recording.truth_map
    files = {
        "cones.csv": _format_frames(frames),
        "odometry.csv": format_velocities(velocities) if velocities else None,
        "truth.csv": None if truth is None else format_truth(truth),
        "map.csv": None if truth_map is None else format_truth_map(truth_map),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.gz").unlink(missing_ok=True)
        if text is None:
            (folder / name).unlink(missing_ok=True)
        else:
            (folder / name).write_text(text, encoding="utf-8", newline="\n")


def _read_frames(
    path: Path, rejected: Counter[str]
) -> tuple[list[ConeObservations], SensorModel | None]:
    optional = (*COV_COLUMNS, *CLASS_COLUMNS, "class", "true_id")
    table = read_table(path, ("t", "x", "y"), optional)
    checks = RowChecks(table, rejected)
    stamp, timed = checks.stamps()
    xy, cone = checks.positions(timed & ~_without_cone(table))
    fallback = _default_sensor(xy[cone])
    given = covariance_column(table)
    if given is None:
        cov = fallback.covariance(xy)
    else:
        cov, sound = given
        cone = checks.keep(cone, sound, BAD_COVARIANCE)
    prob, named, sound = class_prob_column(table)
    cone = checks.keep(cone, named, "unknown class name")
    checks.keep(cone, sound, "class probabilities replaced")
    ids = _true_ids(table, cone, checks)

    rows = np.flatnonzero(cone)
    xy, cov, prob = xy[rows], cov[rows], prob[rows]
    ids = None if ids is None else ids[rows]
    frames = [
        ConeObservations(t, xy[s], cov[s], prob[s], None if ids is None else ids[s])
        for t, s in _slices(np.unique(stamp[timed]), stamp[rows])
    ]
    return frames, fallback if given is None else fit_sensor_model(xy, cov)


def _slices(frame_stamp: Array, row_stamp: Array) -> list[tuple[float, slice]]:
    """Return each frame's stamp and its rows; both stamps ascending."""
    begin = np.searchsorted(row_stamp, frame_stamp, side="left").tolist()
    end = np.searchsorted(row_stamp, frame_stamp, side="right").tolist()
    stamps = frame_stamp.tolist()
    return [(t, slice(a, b)) for t, a, b in zip(stamps, begin, end, strict=True)]


def _without_cone(table: Table) -> Mask:
    """Return which rows (N,) hold nothing but a stamp."""
    empty = table.numbers("x")[1] & table.numbers("y")[1]
    others = [cells for name, cells in table.cells.items() if name != "t"]
    for row in np.flatnonzero(empty).tolist():
        empty[row] = not any(cells[row].strip() for cells in others)
    return empty


def _default_sensor(xy_m: Array) -> SensorModel:
    model = SensorModel(np.array(DEFAULT_RANGE_SIGMA_M), DEFAULT_BEARING_SIGMA_RAD)
    return model_seeing(model, xy_m)


def _true_ids(table: Table, cone: Mask, checks: RowChecks) -> IntArray | None:
    if "true_id" not in table:
        return None
    number, sound, blank = whole_numbers(table, "true_id")
    checks.keep(cone, sound | blank, "true_id ignored")
    return np.where(sound, number, -1).astype(np.int64)


def read_velocities(path: Path, rejected: Counter[str]) -> list[VelocityObservation]:
    """Read ``odometry.csv``; bad rows are counted into ``rejected``.

    Raises:
        FileFormatError: unreadable or empty, or a column missing.
    """
    table = read_table(path, ("t", "u", "r"), VELOCITY_COV_COLUMNS)
    checks = RowChecks(table, rejected)
    stamp, keep = checks.stamps()
    ur = np.stack([table.numbers("u")[0], table.numbers("r")[0]], axis=1)
    sound = ~(np.isnan(ur[:, 0]) | np.isnan(ur[:, 1]))
    keep = checks.keep(keep, sound, "u or r is not a number")
    given = covariance_column(table, VELOCITY_COV_COLUMNS)
    if given is None:
        default = np.diag([DEFAULT_U_SIGMA_MPS**2, DEFAULT_R_SIGMA_RADPS**2])
        cov = np.broadcast_to(default, (len(table), 2, 2))
    else:
        cov, sound = given
        keep = checks.keep(keep, sound, BAD_COVARIANCE)
    rows = zip(stamp[keep].tolist(), ur[keep].tolist(), cov[keep], strict=True)
    return [VelocityObservation(t, u, r, c) for t, (u, r), c in rows]


def _merged(velocities: Sequence[Event], frames: Sequence[Event]) -> tuple[Event, ...]:
    # A stable sort keeps velocities first at equal stamps.
    return tuple(sorted([*velocities, *frames], key=lambda event: event.stamp_s))


def _format_frames(frames: Sequence[ConeObservations]) -> str:
    with_ids = any(frame.truth_id is not None for frame in frames)
    header = ["t", "x", "y", *COV_COLUMNS, *CLASS_COLUMNS, *(["true_id"] * with_ids)]
    lines = [",".join(header)]
    for frame in frames:
        stamp = repr(float(frame.stamp_s))
        if not len(frame):
            lines.append(stamp + "," * (len(header) - 1))
            continue
        cov = frame.cov_m2.reshape(-1, 4)[:, [0, 1, 3]]
        cells = np.hstack([frame.xy_m, cov, frame.class_prob]).tolist()
        ids = [] if frame.truth_id is None else frame.truth_id.tolist()
        for row, numbers in enumerate(cells):
            line = f"{stamp},{','.join(map(repr, numbers))}"
            lines.append(f"{line},{ids[row] if ids else ''}" if with_ids else line)
    return "\n".join(lines) + "\n"


def format_velocities(velocities: Sequence[VelocityObservation]) -> str:
    """Return the text of ``odometry.csv``."""
    header = ",".join(("t", "u", "r", *VELOCITY_COV_COLUMNS))
    table = np.array(
        [
            (v.stamp_s, v.u_mps, v.r_radps, v.cov[0, 0], v.cov[0, 1], v.cov[1, 1])
            for v in velocities
        ]
    )
    return f"{header}\n" + "".join(f"{','.join(exact(row))}\n" for row in table)
