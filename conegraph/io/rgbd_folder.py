"""RGB-D sequences in the layout of the TUM benchmark (Sturm and others, 2012).

A folder with ``rgb.txt`` and ``depth.txt``, lists of stamps and pictures, and
``camera.toml``. Depth is 16-bit PNG. As in a cone log, ``odometry.csv``,
``truth.csv`` and ``map.csv`` may lie beside them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.errors import FileFormatError
from conegraph.io.camera_toml import CAMERA_TOML, CameraFile, read_camera_toml
from conegraph.io.cone_log import read_velocities
from conegraph.io.csv_table import find_file
from conegraph.io.depth_units import unit_problem
from conegraph.io.picture_file import read_color, read_depth
from conegraph.io.picture_list import PictureList, associate, read_picture_list
from conegraph.io.truth_tables import read_truth, read_truth_map
from conegraph.types import (
    Event,
    IntArray,
    SensorModel,
    Trajectory,
    TruthMap,
    VelocityObservation,
)

RGB_LIST = "rgb.txt"
DEPTH_LIST = "depth.txt"
_FRAMES_TO_JUDGE = 5


@dataclass(frozen=True, slots=True)
class RgbdFolder:
    """A sequence on disk, a `Stream`: each picture is read when its turn comes.

    Attributes:
        folder: where it lies.
        file: what ``camera.toml`` says.
        color: the colour pictures.
        depth: the depth pictures.
        pairs: (P, 2) rows of colour and depth that belong together.
        velocities: odometry, empty without it.
        on_reading: what was left out of the lists, counted by reason.
        truth_trajectory: true poses, None without.
        truth_map: true cones, None without.
        sensor: None, the front end knows better.
        yaw_rate_bias_radps: None, nobody knows.
        ids_are_given: False, pictures have none.
        unread: pictures that could not be used, counted while events are read.
    """

    folder: Path
    file: CameraFile
    color: PictureList
    depth: PictureList
    pairs: IntArray
    velocities: tuple[VelocityObservation, ...]
    on_reading: Mapping[str, int]
    truth_trajectory: Trajectory | None = None
    truth_map: TruthMap | None = None
    sensor: SensorModel | None = None
    yaw_rate_bias_radps: float | None = None
    ids_are_given: bool = False
    unread: Counter[str] = field(default_factory=Counter)

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.resolve().name

    @property
    def n_frames(self) -> int:
        """How many pairs of pictures there are."""
        return len(self.pairs)

    @property
    def rejected(self) -> Mapping[str, int]:
        """What was left out, counted by reason; complete once events are read."""
        return dict(Counter(self.on_reading) + self.unread)

    def events(self) -> Iterator[Event | RgbdFrame]:
        """Yield odometry and frames by stamp, odometry first where they tie.

        A pair with a picture that is missing, damaged or of another size is left
        out and counted.

        Raises:
            FileFormatError: no pair at all can be used, or depths are not in the
                unit that ``camera.toml`` says.
        """
        self.unread.clear()
        waiting, read = 0, 0
        problems: list[str] = []
        for first, second in self.pairs.tolist():
            stamp = float(self.color.stamp_s[first])
            while (
                waiting < len(self.velocities)
                and self.velocities[waiting].stamp_s <= stamp
            ):
                yield self.velocities[waiting]
                waiting += 1
            frame = self._frame(stamp, self.color.path[first], self.depth.path[second])
            if frame is None:
                continue
            read += 1
            if read <= _FRAMES_TO_JUDGE:
                self._check_units(frame, problems)
            yield frame
        yield from self.velocities[waiting:]
        if not read:
            why = ", ".join(f"{n} x {reason}" for reason, n in self.unread.items())
            raise FileFormatError(self.folder, f"no frame can be used: {why}")

    def _frame(self, stamp_s: float, color: Path, depth: Path) -> RgbdFrame | None:
        camera = self.file.camera
        shape = (camera.height_px, camera.width_px)
        try:
            picture, stored = read_color(color), read_depth(depth)
        except FileFormatError as error:
            kind = "depth" if error.path == depth else "colour"
            reason = str(error).removeprefix(f"{error.path}: ").partition(":")[0]
            self.unread[f"{kind} picture {reason.partition(';')[0]}"] += 1
            return None
        for kind, size in (("colour", picture.shape[:2]), ("depth", stored.shape)):
            if size != shape:
                self.unread[
                    f"{kind} picture is {size[1]} x {size[0]}, not {shape[1]} x "
                    f"{shape[0]} as in {CAMERA_TOML}"
                ] += 1
                return None
        depth_m = stored.astype(np.float32) * np.float32(1.0 / self.file.units_per_m)
        mount = self.file.mount or CameraMount()
        return RgbdFrame(stamp_s, picture, depth_m, camera, mount)

    def _check_units(self, frame: RgbdFrame, problems: list[str]) -> None:
        """Collect what is odd; several frames that agree are a wrong unit.

        Raises:
            FileFormatError: most of the frames so far say so.
        """
        odd = unit_problem(frame.depth_m, frame.camera, self.file.mount)
        if odd is not None:
            problems.append(odd)
        if len(problems) >= min(_FRAMES_TO_JUDGE // 2 + 1, self.n_frames):
            raise FileFormatError(
                self.folder / CAMERA_TOML,
                f"depth.units_per_m: {self.file.units_per_m:g} cannot be: "
                f"{problems[0]} (1000 for millimetres, 5000 as the TUM sequences "
                f"have it, 1 for metres)",
            )


def read_rgbd_folder(folder: Path) -> RgbdFolder:
    """Read the lists of a sequence; its pictures are read later, one by one.

    Raises:
        FileFormatError: a list or ``camera.toml`` is missing or cannot be read, or
            no colour picture has a depth picture near in time.
    """
    rejected: Counter[str] = Counter()
    lists = []
    for name in (RGB_LIST, DEPTH_LIST):
        path = folder / name
        if not path.is_file():
            raise FileFormatError(path, "is missing: not an RGB-D sequence")
        lists.append(read_picture_list(path, rejected))
    color, depth = lists
    file = read_camera_toml(folder / CAMERA_TOML)
    pairs = associate(color.stamp_s, depth.stamp_s, file.max_gap_s)
    if not len(pairs):
        raise FileFormatError(
            folder / RGB_LIST,
            f"none of {len(color)} pictures has one of {len(depth)} depth pictures "
            f"within {file.max_gap_s:g} s",
        )
    alone = len(color) - len(pairs)
    if alone:
        rejected[f"{RGB_LIST}: no depth within {file.max_gap_s:g} s"] += alone
    odometry = find_file(folder, "odometry.csv")
    truth, truth_map = find_file(folder, "truth.csv"), find_file(folder, "map.csv")
    return RgbdFolder(
        folder,
        file,
        color,
        depth,
        pairs,
        tuple(read_velocities(odometry, rejected)) if odometry else (),
        dict(rejected),
        read_truth(truth, rejected) if truth else None,
        read_truth_map(truth_map, rejected) if truth_map else None,
    )
