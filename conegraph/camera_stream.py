"""A stream of pictures, seen through the front end: what the back ends get."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from conegraph.camera import Camera, CameraMount, RgbdFrame, Stream
from conegraph.config import Config
from conegraph.frontend.base import Detections, FrontEnd
from conegraph.frontend.factory import make_front_end
from conegraph.types import (
    ConeObservations,
    Event,
    Recording,
    SensorModel,
    Source,
    Trajectory,
    TruthMap,
)

TYPICAL = (Camera(640, 480, 460.0, 460.0, 320.0, 240.0), CameraMount())
"""A lens of 70 degrees, a metre above the ground."""
Watcher = Callable[[RgbdFrame, Detections], None]


@dataclass(slots=True)
class CameraStream:
    """A `Source` of cones, made from a `Stream` of pictures by a front end.

    Where the stream has an end, what was detected is kept (not the pictures), so
    that another back end gets the very same cones without looking again.

    Attributes:
        stream: where the pictures come from.
        config: what the front end is made from, when the first picture comes.
        watcher: who is shown every picture with its cones, once.
        detect_ms: how long the front end took for the last frame that was yielded.
    """

    stream: Stream
    config: Config
    watcher: Watcher | None = None
    detect_ms: float | None = None
    _kept: list[tuple[Event, float | None]] | None = None
    _sensor: SensorModel | None = None
    _left_out: Mapping[str, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The stream's name."""
        return self.stream.name

    @property
    def n_frames(self) -> int | None:
        """How many frames will come at most, None when nobody knows."""
        return self.stream.n_frames

    @property
    def sensor(self) -> SensorModel | None:
        """What the stream knows of the cone sensor, or else what the front end does.

        That depends on lens and mount, for which a stream that can be read again is
        asked for its first picture; a live camera is taken for a `TYPICAL` one.
        """
        if self.stream.sensor is not None:
            return self.stream.sensor
        if self._sensor is None:
            lens, mount = TYPICAL
            if self.n_frames is not None:
                events = self.stream.events()
                pictures = (e for e in events if isinstance(e, RgbdFrame))
                first = next(pictures, None)
                if first is not None:
                    lens, mount = first.camera, first.mount
            front_end = make_front_end(self.config)
            self._sensor = front_end.sensor(lens, self._configured(mount))
        return self._sensor

    @property
    def yaw_rate_bias_radps(self) -> float | None:
        """What the stream knows of its odometry."""
        return self.stream.yaw_rate_bias_radps

    @property
    def ids_are_given(self) -> bool:
        """Whether the stream comes with associations."""
        return self.stream.ids_are_given

    @property
    def truth_trajectory(self) -> Trajectory | None:
        """The stream's true poses."""
        return self.stream.truth_trajectory

    @property
    def truth_map(self) -> TruthMap | None:
        """The stream's true cones."""
        return self.stream.truth_map

    @property
    def rejected(self) -> Mapping[str, int]:
        """What the stream and the front end left out, counted by reason."""
        return dict(Counter(self.stream.rejected) + Counter(self._left_out))

    def events(self) -> Iterator[Event]:
        """Yield odometry and the cones of every picture, in the stream's order."""
        if self._kept is not None:
            for cones, took_ms in self._kept:
                self.detect_ms = took_ms
                yield cones
            return
        kept: list[tuple[Event, float | None]] = []
        keeps = self.stream.n_frames is not None
        front_end: FrontEnd | None = None
        for event in self.stream.events():
            self.detect_ms = None
            if isinstance(event, RgbdFrame):
                front_end = front_end or make_front_end(self.config)
                seen: Event = self._seen(event, front_end)
            else:
                seen = event
            if keeps:
                kept.append((seen, self.detect_ms))
            yield seen
        self._kept = kept if keeps else None

    def _configured(self, mount: CameraMount) -> CameraMount:
        """Return the mount with what the configuration says of it."""
        return replace(mount, **self.config.mount.model_dump(exclude_none=True))

    def _seen(self, frame: RgbdFrame, front_end: FrontEnd) -> ConeObservations:
        frame = replace(frame, mount=self._configured(frame.mount))
        began = time.perf_counter()
        seen = front_end.examine(frame)
        self.detect_ms = 1e3 * (time.perf_counter() - began)
        self._left_out = front_end.rejected
        if self.watcher is not None:
            self.watcher(frame, seen)
        return seen.observations


def with_front_end(stream: Stream | Source, config: Config) -> Source:
    """Return the stream as a source of cones; one that is stays as it is."""
    if isinstance(stream, Recording | CameraStream):
        return stream
    return CameraStream(stream, config)
