"""Recordings that were made with a RealSense camera (``.db3``, ``.bag``)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.errors import FileFormatError
from conegraph.frontend.realsense_file import frames_in, mount_beside
from conegraph.frontend.realsense_frames import (
    BACKWARDS,
    INCOMPLETE,
    FrameReader,
    in_order,
    load_library,
)
from conegraph.types import Event, SensorModel, Trajectory, TruthMap

PLAYBACK_WAIT_MS = 200


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
            for frame in in_order(_framesets(rs, pipe, profile), reader, self.left_out):
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
