"""Writes an RGB-D sequence in the TUM layout, picture by picture."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.errors import ConegraphError
from conegraph.io.camera_toml import (
    CAMERA_TOML,
    UNITS_PER_M,
    CameraFile,
    format_camera_toml,
)
from conegraph.io.cone_log import format_velocities
from conegraph.io.rgbd_folder import DEPTH_LIST, RGB_LIST
from conegraph.io.truth_tables import format_truth, format_truth_map
from conegraph.types import Trajectory, TruthMap, VelocityObservation

_HEADER = "# timestamp filename\n"
_LARGEST_UNIT = 65535


class RgbdWriter:
    """Writes frames into a folder; a context manager.

    A picture is complete on disk before its line is in the list, so that a killed
    recording reads back up to its last frame. Colour is PNG, or JPEG of quality 95
    without colour subsampling at a quarter of the size; depth is PNG of whole
    millimetres.

    Args:
        folder: made where it does not exist.
        camera: the lens of all frames.
        mount: where it sits.
        lossless: PNG in place of JPEG.

    Raises:
        ConegraphError: the folder holds a sequence already.
    """

    def __init__(
        self,
        folder: Path,
        camera: Camera,
        mount: CameraMount | None,
        *,
        lossless: bool = False,
    ) -> None:
        """Write ``camera.toml`` and open the lists."""
        if (folder / RGB_LIST).exists():
            raise ConegraphError(
                f"{folder}: holds an RGB-D sequence already; name another folder"
            )
        self.frames = 0
        self._folder = folder
        self._suffix = ".png" if lossless else ".jpg"
        for name in ("rgb", "depth"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        about = format_camera_toml(CameraFile(camera, mount))
        (folder / CAMERA_TOML).write_text(about, encoding="utf-8", newline="\n")
        self._lists = {name: _new(folder / name) for name in (RGB_LIST, DEPTH_LIST)}

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the lists."""
        for file in self._lists.values():
            file.close()

    def add(self, frame: RgbdFrame) -> None:
        """Write one frame.

        Raises:
            ConegraphError: a picture cannot be written.
        """
        import cv2

        full_color = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        quality = {
            ".png": [cv2.IMWRITE_PNG_COMPRESSION, 1],
            ".jpg": [
                *(cv2.IMWRITE_JPEG_QUALITY, 95),
                *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full_color),
            ],
        }
        # A running number keeps two frames of one microsecond apart.
        stem = f"{frame.stamp_s:.6f}-{self.frames}"
        stored = np.clip(np.round(frame.depth_m * UNITS_PER_M), 0, _LARGEST_UNIT)
        pictures: list[tuple[str, str, NDArray[np.integer[Any]]]] = [
            (RGB_LIST, f"rgb/{stem}{self._suffix}", frame.color[..., ::-1]),
            (DEPTH_LIST, f"depth/{stem}.png", stored.astype(np.uint16)),
        ]
        for name, file, picture in pictures:
            suffix = Path(file).suffix
            ok, coded = cv2.imencode(suffix, picture, quality[suffix])
            if not ok:
                raise ConegraphError(f"{self._folder / file}: cannot be encoded")
            (self._folder / file).write_bytes(coded.tobytes())
            self._lists[name].write(f"{float(frame.stamp_s)!r} {file}\n")
            self._lists[name].flush()
        self.frames += 1

    def add_truth(
        self,
        velocities: list[VelocityObservation],
        truth: Trajectory | None,
        truth_map: TruthMap | None,
    ) -> None:
        """Write odometry and what is known of the truth beside the pictures."""
        files = {
            "odometry.csv": format_velocities(velocities) if velocities else None,
            "truth.csv": None if truth is None else format_truth(truth),
            "map.csv": None if truth_map is None else format_truth_map(truth_map),
        }
        for name, text in files.items():
            if text is not None:
                path = self._folder / name
                path.write_text(text, encoding="utf-8", newline="\n")


def _new(path: Path) -> TextIO:
    file = path.open("w", encoding="utf-8", newline="\n")
    file.write(_HEADER)
    return file
