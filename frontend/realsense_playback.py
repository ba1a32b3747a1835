"""One stream of a recording, played without losing a picture.

A playback reads on as soon as its first sensor starts, and drops what belongs to a
sensor that starts later; whoever plays two sensors of one file together loses the
beginning of one when the computer is busy. Hence every stream has a playback of its
own here, and the streams are joined by their time stamps.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from threading import Condition
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conegraph.errors import FileFormatError
from conegraph.frontend.realsense_frames import load_library

AHEAD = 8
MOST_AHEAD = 200
# The library gives a last picture 10 s to be taken, then throws it away.
PATIENCE_S = 3.0
STALLED_S = 20.0


@dataclass(frozen=True, slots=True)
class Picture:
    """What one camera eye saw, copied out of the library's memory.

    Attributes:
        stamp_s: time of the exposure.
        number: the camera's own count of pictures.
        pixels: as the camera sends them.
        units_m: metres of one step in depth, 0 for colour.
    """

    stamp_s: float
    number: int
    pixels: NDArray[Any]
    units_m: float


class StreamPlayback:
    """Plays one stream of a recording, as fast as it is read and no faster.

    Args:
        path: the recording.
        kind: ``rs.stream.color`` or ``rs.stream.depth``.

    Raises:
        FileFormatError: the file is no recording, or has no such stream.
    """

    def __init__(self, path: Path, kind: Any) -> None:
        """Open the file; nothing is read before `pictures`."""
        self._path = path
        self._device = load_playback(path)
        self._sensor, self.profile = _stream_of(path, self._device, kind)

    def beside(self, kind: Any) -> Any:
        """Return the profile of another stream of the same device."""
        return _stream_of(self._path, self._device, kind)[1]

    def pictures(self) -> Generator[Picture, None, None]:
        """Yield the stream's pictures once; closing the iterator stops the playback.

        Raises:
            FileFormatError: the library cannot play the stream.
        """
        ahead = _Ahead()
        self._device.set_status_changed_callback(ahead.note_status)
        try:
            self._sensor.open(self.profile)
            self._sensor.start(ahead.take)
        except RuntimeError as error:
            raise FileFormatError(self._path, f"cannot be played: {error}") from error
        try:
            while (picture := ahead.next()) is not None:
                yield picture
        finally:
            ahead.end()
            self._sensor.stop()
            self._sensor.close()


class _Ahead:
    """The pictures that the library's thread has read and nobody has taken yet.

    It knows nothing of the device, which holds it: the two would never be freed.
    """

    def __init__(self) -> None:
        self._pictures: deque[Picture] = deque()
        self._changed = Condition()
        self._ended = False

    def next(self) -> Picture | None:
        """Return the next picture, None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._pictures or self._ended, STALLED_S)
            if not self._pictures:
                return None
            picture = self._pictures.popleft()
            self._changed.notify_all()
            return picture

    def take(self, frame: Any) -> None:
        """Copy a picture; wait while enough are there."""
        depth = frame.as_depth_frame()
        picture = Picture(
            float(frame.get_timestamp()) / 1000.0,
            int(frame.get_frame_number()),
            np.array(frame.get_data()),
            float(depth.get_units()) if depth else 0.0,
        )
        with self._changed:
            patience_s = PATIENCE_S if len(self._pictures) < MOST_AHEAD else None
            self._changed.wait_for(
                lambda: len(self._pictures) < AHEAD or self._ended, patience_s
            )
            self._pictures.append(picture)
            self._changed.notify_all()

    def note_status(self, status: Any) -> None:
        """End when the library says that it stops: the last picture was taken."""
        if status == load_library().playback_status.stopped:
            self.end()

    def end(self) -> None:
        """Let nobody wait any longer."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()


def _stream_of(path: Path, device: Any, kind: Any) -> tuple[Any, Any]:
    """Return the sensor and the profile of a device's first stream of a kind.

    Raises:
        FileFormatError: there is none.
    """
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() == kind:
                return sensor, profile.as_video_stream_profile()
    raise FileFormatError(path, f"has no {kind.name} stream")


def load_playback(path: Path) -> Any:
    """Return the device that plays a file, not in real time.

    Raises:
        FileFormatError: the file is no recording.
    """
    try:
        device = load_library().context().load_device(str(path))
    except RuntimeError as error:
        why = str(error).rpartition("Reason: ")[2]
        raise FileFormatError(path, f"is no RealSense recording: {why}") from error
    device.set_real_time(False)
    return device
