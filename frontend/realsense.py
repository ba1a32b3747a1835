"""RealSense cameras: a live one, and recordings of one (``.db3``, ``.bag``)."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.errors import FileFormatError, SourceError
from conegraph.frontend.realsense_file import frames_in, mount_beside
from conegraph.frontend.realsense_frames import FrameReader, load_library
from conegraph.types import Event, SensorModel, Trajectory, TruthMap

FRAME_WAIT_MS = 1500
PLAYBACK_WAIT_MS = 200
RECONNECT_S = 30.0
MISSING = "frames missing in the recording"
INCOMPLETE = "frames without colour or depth"
BACKWARDS = "frame before the last one"


@dataclass(frozen=True, slots=True)
class RealsenseRecording:
    """A recording on disk, a `Stream`; frames are read when their turn comes.

    Attributes:
        path: the file.
        mount: where the camera sat; a file ``camera.toml`` beside the recording
            says so, the recording itself does not.
        n_frames: how many frames it was recorded with, None where nobody knows.
        left_out: frames that are missing or odd, counted while events are read.
    """

    path: Path
    mount: CameraMount
    n_frames: int | None
    left_out: Counter[str] = field(default_factory=Counter)
    sensor: SensorModel | None = None
    yaw_rate_bias_radps: float | None = None
    ids_are_given: bool = False
    truth_trajectory: Trajectory | None = None
    truth_map: TruthMap | None = None

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.stem

    @property
    def rejected(self) -> Mapping[str, int]:
        """What is missing or odd, counted by reason; complete after reading."""
        return self.left_out

    def events(self) -> Iterator[Event | RgbdFrame]:
        """Yield the frames in the order of recording, none of them dropped.

        Raises:
            FileFormatError: the file is no recording, or holds no frames.
        """
        self.left_out.clear()
        rs = load_library()
        pipe, config = _resolved(rs, self.path)
        try:
            profile = pipe.start(config)
        except RuntimeError as error:
            raise FileFormatError(self.path, f"cannot be played: {error}") from error
        try:
            reader = FrameReader(profile, self.mount)
            come = 0
            for frame in _checked(_framesets(rs, pipe, profile), reader, self.left_out):
                come += 1
                yield frame
        finally:
            pipe.stop()
        known = come + self.left_out[INCOMPLETE] + self.left_out[BACKWARDS]
        if self.n_frames is not None and self.n_frames > known:
            # What lies between frames was counted by their numbers already.
            ended = self.n_frames - known
            self.left_out["frames unreadable at the end of the recording"] += ended
        if not come:
            raise FileFormatError(self.path, "holds no frame with colour and depth")


def read_realsense(path: Path) -> RealsenseRecording:
    """Open a recording that was made with a RealSense camera.

    Raises:
        MissingDependencyError: the library cannot be loaded.
        FileFormatError: the file is none, or is cut off: then the text says how
            much of it is there.
    """
    rs = load_library()
    mount = mount_beside(path)
    frames = frames_in(path)
    _resolved(rs, path)
    return RealsenseRecording(path, mount, frames)


def _resolved(rs: Any, path: Path) -> tuple[Any, Any]:
    """Return a pipeline and the configuration that makes it play a file.

    It plays as fast as it is read; set before the start, because in real time the
    first frames would pass unseen.
    """
    pipe, config = rs.pipeline(), rs.config()
    try:
        config.enable_device_from_file(str(path), repeat_playback=False)
        device = config.resolve(rs.pipeline_wrapper(pipe)).get_device()
    except RuntimeError as error:
        why = str(error).rpartition("Reason: ")[2]
        raise FileFormatError(path, f"is no RealSense recording: {why}") from error
    device.as_playback().set_real_time(False)
    return pipe, config


def _framesets(rs: Any, pipe: Any, profile: Any) -> Iterator[Any]:
    """Yield framesets until the playback stops."""
    playback = profile.get_device().as_playback()
    while True:
        came, frameset = pipe.try_wait_for_frames(PLAYBACK_WAIT_MS)
        if came:
            yield frameset
        elif playback.current_status() == rs.playback_status.stopped:
            return


def _checked(
    framesets: Iterator[Any], reader: FrameReader, left_out: Counter[str]
) -> Iterator[RgbdFrame]:
    """Yield frames whose time runs forward; count those that are not there.

    A camera numbers its pictures: a gap in the numbers is that many missing.
    """
    last_number, last_s = -1, float("-inf")
    for frameset in framesets:
        color = frameset.get_color_frame()
        number = int(color.get_frame_number()) if color else -1
        if number > last_number + 1 > 0:
            left_out[MISSING] += number - last_number - 1
        last_number = max(number, last_number)
        frame = reader.frame(frameset)
        if frame is None:
            left_out[INCOMPLETE] += 1
        elif frame.stamp_s <= last_s:
            left_out[BACKWARDS] += 1
        else:
            last_s = frame.stamp_s
            yield frame


@dataclass(frozen=True, slots=True)
class LiveCamera:
    """A camera on this computer, a `Stream` without end.

    Attributes:
        serial: its serial number, empty for the only one.
        mount: where it sits; the configuration's ``[mount]`` says so.
        record_to: a ``.db3`` file to record into, None to record nothing.
        left_out: frames that were lost, and times that the camera was.
    """

    serial: str = ""
    mount: CameraMount = field(default_factory=CameraMount)
    record_to: Path | None = None
    left_out: Counter[str] = field(default_factory=Counter)
    sensor: SensorModel | None = None
    yaw_rate_bias_radps: float | None = None
    ids_are_given: bool = False
    truth_trajectory: Trajectory | None = None
    truth_map: TruthMap | None = None

    @property
    def name(self) -> str:
        """The camera's name for titles."""
        return f"realsense-{self.serial}" if self.serial else "realsense"

    @property
    def n_frames(self) -> int | None:
        """Nobody knows how many will come."""
        return None

    @property
    def rejected(self) -> Mapping[str, int]:
        """Frames that were lost, counted by reason."""
        return self.left_out

    def events(self) -> Iterator[Event | RgbdFrame]:
        """Yield frames until the camera is gone for good.

        A camera that is unplugged and comes back within 30 s goes on; a recording
        ends where the camera was lost.

        Raises:
            MissingDependencyError: the library cannot be loaded.
            SourceError: no such camera is connected, or it does not come back.
        """
        rs = load_library()
        self._find(rs, wait_s=0.0)
        while True:
            pipe, profile = self._start(rs)
            try:
                reader = FrameReader(profile, self.mount)
                yield from _checked(_live_framesets(pipe), reader, self.left_out)
            finally:
                with suppress(RuntimeError):
                    pipe.stop()
            self.left_out["camera lost and waited for"] += 1
            self._find(rs, wait_s=RECONNECT_S)

    def _find(self, rs: Any, wait_s: float) -> None:
        until = time.monotonic() + wait_s
        while True:
            found = [
                device.get_info(rs.camera_info.serial_number)
                for device in rs.context().query_devices()
            ]
            if self.serial in found or (found and not self.serial):
                return
            if time.monotonic() >= until:
                there = f"connected: {', '.join(found)}" if found else "none connected"
                raise SourceError(
                    f"{self.name}: no such RealSense camera ({there}); check the "
                    f"cable, or give a recording (.db3, .bag)"
                )
            time.sleep(0.5)

    def _start(self, rs: Any) -> tuple[Any, Any]:
        pipe, config = rs.pipeline(), rs.config()
        if self.serial:
            config.enable_device(self.serial)
        config.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
        config.enable_stream(rs.stream.color, 640, 480, rs.format.rgb8, 30)
        if (
            self.record_to is not None
            and not self.left_out["camera lost and waited for"]
        ):
            config.enable_record_to_file(str(self.record_to))
        try:
            return pipe, pipe.start(config)
        except RuntimeError as error:
            raise SourceError(f"{self.name}: cannot be started: {error}") from error


def _live_framesets(pipe: Any) -> Iterator[Any]:
    """Yield framesets until none comes for a while."""
    while True:
        try:
            came, frameset = pipe.try_wait_for_frames(FRAME_WAIT_MS)
        except RuntimeError:
            return
        if not came:
            return
        yield frameset
