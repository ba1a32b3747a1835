"""Recordings that were made with a RealSense camera (``.db3``, ``.bag``)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.errors import FileFormatError
from conegraph.frontend.realsense_file import frames_in, mount_beside
from conegraph.frontend.realsense_frames import load_library
from conegraph.frontend.realsense_pairs import PairReader, Pairs, half_period_s
from conegraph.frontend.realsense_playback import StreamPlayback, load_playback
from conegraph.types import Event, SensorModel, Trajectory, TruthMap


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
        color = StreamPlayback(self.path, rs.stream.color)
        depth = StreamPlayback(self.path, rs.stream.depth)
        try:
            reader = PairReader(color, depth, self.mount)
        except RuntimeError as error:
            raise FileFormatError(self.path, f"cannot be played: {error}") from error
        pairs = Pairs(half_period_s(color.profile, depth.profile), self.left_out)
        come = 0
        with closing(color.pictures()) as colors, closing(depth.pictures()) as depths:
            for pair in pairs.of(colors, depths):
                come += 1
                yield reader.frame(*pair)
        # What lies between pictures was counted by their numbers already.
        if self.n_frames is not None and self.n_frames > pairs.colors_seen:
            ended = self.n_frames - pairs.colors_seen
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
    mount = mount_beside(path)
    frames = frames_in(path)
    load_playback(path)
    return RealsenseRecording(path, mount, frames)
