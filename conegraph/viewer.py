"""What a run shows while it runs: to the Rerun viewer, to a file, or to nobody.

This module is cheap to import; Rerun itself (some seconds) is imported when a
viewer is opened that needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from conegraph.types import ConeMap, FrameRecord, StreamInfo, Trajectory

if TYPE_CHECKING:
    from conegraph.camera import RgbdFrame
    from conegraph.config import Roles, TrackConfig
    from conegraph.frontend.base import Detections


class Viewer(Protocol):
    """What the pipeline tells about one back end's run, in this order."""

    def start(self, source: StreamInfo) -> None:
        """Take the name and the truth of the stream that is about to run."""
        ...

    def frame(self, record: FrameRecord, cone_map: Callable[[], ConeMap]) -> None:
        """Show one frame; ``cone_map`` is asked only when a map is due."""
        ...

    def finish(self, cone_map: ConeMap, smoothed: Trajectory | None) -> None:
        """Show the final map and, where there is one, the smoothed path."""
        ...

    def close(self) -> None:
        """Write out what is pending; nothing is shown afterwards."""
        ...


class NullViewer:
    """The viewer of a run that nobody watches: it does nothing."""

    def start(self, source: StreamInfo) -> None:
        """Ignore the stream."""

    def frame(self, record: FrameRecord, cone_map: Callable[[], ConeMap]) -> None:
        """Ignore the frame, without asking for the map."""

    def finish(self, cone_map: ConeMap, smoothed: Trajectory | None) -> None:
        """Ignore the result."""

    def close(self) -> None:
        """Have nothing to close."""


Watcher = Callable[["RgbdFrame", "Detections"], None]
"""Who is shown every picture with what was found in it."""


def open_viewer(
    backends: Sequence[str],
    *,
    live: bool,
    path: Path | None,
    map_period_s: float,
    camera: bool = False,
    track: TrackConfig | None = None,
    roles: Roles | None = None,
) -> dict[str, Viewer]:
    """Open one recording and give each back end its viewer into it.

    The back ends stand side by side in one layout. The recording is complete once
    every viewer is closed. Where it fails after opening it warns once, through
    `logging`, and is switched off: watching a run must not stop it.

    Args:
        backends: names of the back ends, unique; they become the entity prefixes.
        live: whether to show the run in the Rerun viewer while it runs. A viewer
            that already listens on this machine is used, else one is started.
        path: where to write the recording (``.rrd``), None for nowhere.
        map_period_s: time between full maps with their covariances.
        camera: whether to leave room for what `watch_camera` shows.
        track: how the track between the cones is found.
        roles: what each class of cones means on it.

    Returns:
        One viewer for each back end; null viewers when neither live nor path.

    Raises:
        FileFormatError: the recording cannot be written at ``path``.
        MissingDependencyError: the Rerun viewer cannot be started.
    """
    if not live and path is None:
        return {name: NullViewer() for name in backends}
    from conegraph.track.live import LiveTrack
    from conegraph.viewer_rerun import RerunViewer
    from conegraph.viewer_stream import SharedStream

    stream = SharedStream(backends, live=live, path=path, camera=camera)
    return {
        name: RerunViewer(
            stream, name, map_period_s=map_period_s, track=LiveTrack(track, roles)
        )
        for name in backends
    }


def watch_camera(viewers: Mapping[str, Viewer], *, period_s: float) -> Watcher | None:
    """Return who shows the camera's pictures beside the back ends, None for nobody.

    Args:
        viewers: what `open_viewer` returned with ``camera``.
        period_s: time between pictures.
    """
    if all(isinstance(viewer, NullViewer) for viewer in viewers.values()):
        return None
    from conegraph.viewer_camera import CameraViewer
    from conegraph.viewer_rerun import RerunViewer

    shown = [v for v in viewers.values() if isinstance(v, RerunViewer)]
    return CameraViewer(shown[0].stream, period_s=period_s) if shown else None
