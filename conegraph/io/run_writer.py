"""What a run leaves behind: written so that a killed run keeps its frames.

Every frame is one complete write per file, so that once `RunWriter.frame` has
returned, not even ``kill -9`` loses it. Files that are rewritten as a whole appear
under their name only when they are complete, and ``summary.json`` comes last: a
folder with it holds a finished run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from io import FileIO
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from conegraph.errors import ConegraphError
from conegraph.io.csv_table import exact, format_rows
from conegraph.io.plain import to_plain
from conegraph.types import (
    CLASS_LABELS,
    N_CLASSES,
    ConeMap,
    ConeObservations,
    FrameRecord,
    Revision,
    Trajectory,
)

SCHEMA_VERSION = 1

CONFIG = "config.toml"
TRAJECTORY = "trajectory.tum"
SMOOTHED = "trajectory_smoothed.tum"
TRUTH = "truth.tum"
MAP = "map.csv"
ASSOCIATIONS = "associations.csv"
TIMING = "timing.csv"
STATUS = "status.csv"
CONSISTENCY = "consistency.csv"
POSE_COV = "pose_cov.csv"
MOTION = "motion.csv"
OBSERVATIONS = "observations.csv"
SUMMARY = "summary.json"

HEADERS: Mapping[str, str] = {
    ASSOCIATIONS: "t,observation,status,landmark,d2\n",
    TIMING: "t,stage,ms\n",
    STATUS: "t,status,reason,reset_counter\n",
    CONSISTENCY: "t,nis,dof\n",
    OBSERVATIONS: "t,observation,x,y,cov_xx,cov_xy,cov_yy,class\n",
    MOTION: "t,odo_dx,odo_dy,odo_dyaw,yaw_rate_bias\n",
    POSE_COV: "t,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw\n",
    MAP: "id,x,y,class,p_blue,p_yellow,p_orange,p_big_orange,p_unknown,"
    "cov_xx,cov_xy,cov_yy,observations\n",
}
_GROWING = (
    TRAJECTORY,
    ASSOCIATIONS,
    TIMING,
    STATUS,
    CONSISTENCY,
    POSE_COV,
    MOTION,
    OBSERVATIONS,
)
_UPPER = np.triu_indices(3)
_ONE_CELL = str.maketrans({",": ";", '"': "'", "\n": " ", "\r": " "})


class RunWriter:
    """Writes the files of one run into a folder; a context manager.

    Args:
        folder: made if it does not exist; files of an older run are replaced.
        config_toml: the resolved configuration, written first.

    Raises:
        ConegraphError: on entering, if the folder cannot be made or is a file, and
            from every method when a file cannot be written, naming the file.
    """

    def __init__(self, folder: Path, config_toml: str) -> None:
        self.folder = folder
        self._config_toml = config_toml
        self._open_files = ExitStack()
        self._files: dict[str, FileIO] = {}

    def __enter__(self) -> Self:
        self._make_folder()
        for name in (SUMMARY, SMOOTHED, TRUTH, MAP):
            self._remove(name)
        self._replace(CONFIG, self._config_toml)
        with ExitStack() as opening:
            for name in _GROWING:
                self._files[name] = opening.enter_context(self._create(name))
                self._append(name, HEADERS.get(name, ""))
            self._open_files = opening.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open_files.close()

    def frame(self, record: FrameRecord) -> None:
        """Append one frame to every file that grows."""
        estimate, made = record.estimate, record.associations
        self._append(TRAJECTORY, tum_line(estimate.stamp_s, *estimate.pose.tolist()))
        if made.status:
            rows = zip(
                made.status, made.landmark_id.tolist(), made.d2.tolist(), strict=True
            )
            t = f"{made.stamp_s:.9f}"
            self._append(
                ASSOCIATIONS,
                "".join(
                    f"{t},{i},{status},{landmark},{f'{d2:.6g}' if d2 == d2 else ''}\n"
                    for i, (status, landmark, d2) in enumerate(rows)
                ),
            )
        if len(record.observations):
            self._append(OBSERVATIONS, _observation_lines(record.observations))
        t = f"{estimate.stamp_s:.9f}"
        self._append(
            TIMING, "".join(f"{t},{k},{v:.4f}\n" for k, v in record.stage_ms.items())
        )
        reason = record.reason.translate(_ONE_CELL)
        self._append(
            STATUS, f"{t},{estimate.status},{reason},{estimate.reset_counter}\n"
        )
        cov = ",".join(f"{v:.9g}" for v in estimate.pose_cov[_UPPER].tolist())
        self._append(POSE_COV, f"{t},{cov}\n")
        if made.nis_dof > 0:
            row = f"{made.stamp_s:.9f},{made.nis:.6g},{made.nis_dof}\n"
            self._append(CONSISTENCY, row)
        cells = ",,,"
        if record.odometry is not None:
            x, y, yaw = record.odometry.delta.tolist()
            bias = record.odometry.yaw_rate_bias_radps
            cells = f"{x:.9g},{y:.9g},{yaw:.9g},{bias:.6g}"
        self._append(MOTION, f"{made.stamp_s:.9f},{cells}\n")
        self.revise(record.revisions)

    def revise(self, revisions: Sequence[Revision]) -> None:
        """Append what became of earlier sightings: the last row holds."""
        for made in revisions:
            rows = zip(
                made.observation.tolist(),
                made.landmark_id.tolist(),
                made.d2.tolist(),
                strict=True,
            )
            t = f"{made.stamp_s:.9f}"
            lines = [f"{t},{i},{made.status},{cone},{d2:.6g}\n" for i, cone, d2 in rows]
            self._append(ASSOCIATIONS, "".join(lines))

    def checkpoint(self, cone_map: ConeMap) -> None:
        """Replace the map file as a whole."""
        self._replace(MAP, format_map(cone_map))

    def finish(
        self,
        cone_map: ConeMap,
        smoothed: Trajectory | None,
        summary: Mapping[str, object],
    ) -> None:
        """Write the final map, the smoothed trajectory if any, and the summary.

        Numbers in the summary that do not exist (NaN) become null; the schema's
        version is added to it.
        """
        self.checkpoint(cone_map)
        if smoothed is not None:
            rows = np.column_stack([smoothed.stamp_s, smoothed.pose]).tolist()
            self._replace(SMOOTHED, "".join(tum_line(*row) for row in rows))
        plain = to_plain({"schema_version": SCHEMA_VERSION, **summary})
        self._replace(SUMMARY, json.dumps(plain, indent=2, allow_nan=False) + "\n")

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except FileExistsError as error:
            text = f"{self.folder}: is a file; name a folder to write the run into"
            raise ConegraphError(text) from error
        except OSError as error:
            raise _unwritable(self.folder, error) from error

    def _create(self, name: str) -> FileIO:
        path = self.folder / name
        try:
            return path.open("wb", buffering=0)
        except OSError as error:
            raise _unwritable(path, error) from error

    def _remove(self, name: str) -> None:
        path = self.folder / name
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise _unwritable(path, error) from error

    def _append(self, name: str, text: str) -> None:
        rest = text.encode()
        try:
            while rest:
                rest = rest[self._files[name].write(rest) :]
        except OSError as error:
            raise _unwritable(self.folder / name, error) from error

    def _replace(self, name: str, text: str) -> None:
        replace_text(self.folder / name, text)


def replace_text(path: Path, text: str) -> None:
    """Write a file that appears under its name only when it is complete.

    Raises:
        ConegraphError: the file cannot be written; an older one is left as it was.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise _unwritable(path, error) from error


def tum_line(t_s: float, x_m: float, y_m: float, yaw_rad: float) -> str:
    """Return ``t x y z qx qy qz qw`` for a pose in the plane, as TUM files have it."""
    qz, qw = math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)
    return f"{t_s:.9f} {x_m:z.9f} {y_m:z.9f} 0 0 0 {qz:z.9f} {qw:z.9f}\n"


def _observation_lines(frame: ConeObservations) -> str:
    """Return the rows of a frame, formatted at once: this is in the frame path."""
    numbers = np.hstack([frame.xy_m, frame.cov_m2.reshape(-1, 4)[:, (0, 1, 3)]])
    # Of equally likely classes the last counts: a cone without a colour is unknown.
    last = N_CLASSES - 1 - frame.class_prob[:, ::-1].argmax(axis=1)
    named = [CLASS_LABELS[c] for c in last.tolist()]
    rows = zip(range(len(frame)), *numbers.T.tolist(), named, strict=True)
    line = f"{frame.stamp_s:.9f},%d,%.4f,%.4f,%.4g,%.4g,%.4g,%s\n"
    return (line * len(frame)) % tuple(chain.from_iterable(rows))


def _unwritable(path: Path, error: OSError) -> ConegraphError:
    return ConegraphError(f"{path}: cannot be written: {error.strerror or error}")


def format_map(cone_map: ConeMap) -> str:
    """Return ``map.csv``; its numbers read back as the very same floats."""
    cov = cone_map.cov_m2
    return HEADERS[MAP] + format_rows(
        [
            [str(i) for i in cone_map.id.tolist()],
            *(exact(cone_map.xy_m[:, k]) for k in (0, 1)),
            [CLASS_LABELS[c] for c in cone_map.cone_class.tolist()],
            *(exact(cone_map.class_prob[:, k]) for k in range(len(CLASS_LABELS))),
            *(exact(cov[:, r, c]) for r, c in ((0, 0), (0, 1), (1, 1))),
            [str(n) for n in cone_map.observations.tolist()],
        ]
    )
