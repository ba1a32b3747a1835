"""A live RealSense camera."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.errors import SourceError
from conegraph.frontend.realsense_frames import FrameReader, in_order, load_library
from conegraph.types import Event, SensorModel, Trajectory, TruthMap

FRAME_WAIT_MS = 1500
RECONNECT_S = 30.0


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
                yield from in_order(_live_framesets(pipe), reader, self.left_out)
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
