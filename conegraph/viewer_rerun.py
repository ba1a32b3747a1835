"""One back end's part of the Rerun recording.

Positions are logged as they are, in the world frame with y up; `viewer_blueprint`
says what is drawn where. What grows (the path, the events) is logged piece by
piece and gathered by the view, so that a frame costs the same at the end of a
long drive as at its beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import rerun as rr
from rerun.components import TextLogLevel
from scipy.special import chdtri

from conegraph import geometry
from conegraph import viewer_blueprint as look
from conegraph.track.live import LiveTrack
from conegraph.types import (
    Array,
    ConeMap,
    Estimate,
    FrameRecord,
    IntArray,
    Status,
    StreamInfo,
    Trajectory,
)
from conegraph.viewer_stream import SharedStream
from conegraph.viewer_track import TrackLayer

ELLIPSE_SIGMAS = 3.0
MIN_STEP_M = 0.2

_STATUS_LEVEL = {
    Status.INIT: TextLogLevel.INFO,
    Status.OK: TextLogLevel.INFO,
    Status.DEGRADED: TextLogLevel.WARN,
    Status.LOST: TextLogLevel.ERROR,
}


def covariance_ellipses(xy_m: Array, cov_m2: Array, n_points: int = 16) -> Array:
    """Return the outlines (N, n_points + 1, 2) where the Mahalanobis distance is 3.

    With the eigenvalues l and eigenvectors V of each covariance, the points are
    ``xy + 3 V sqrt(l) (cos a, sin a)``. Covariances must be finite.
    """
    value, vector = np.linalg.eigh(cov_m2)
    half_axes = ELLIPSE_SIGMAS * vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]
    angle = np.linspace(0.0, 2.0 * np.pi, n_points + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    outlines: Array = xy_m[:, None, :] + circle @ np.swapaxes(half_axes, 1, 2)
    return outlines


def align_truth(truth: Trajectory, stamp_s: float, pose: Array) -> Array:
    """Return the pose (3,) of the truth's frame in the run's world.

    The true pose at ``stamp_s``, interpolated, is laid on the estimated ``pose``.
    """
    columns = [truth.pose[:, 0], truth.pose[:, 1], np.unwrap(truth.pose[:, 2])]
    true_pose = np.array([np.interp(stamp_s, truth.stamp_s, c) for c in columns])
    return geometry.compose(pose, geometry.inverse(true_pose))


def _strips(
    xy_m: Array, class_ids: IntArray | Sequence[int] | None = None
) -> rr.LineStrips2D:
    """Return N lines (N, K, 2); Rerun is 40 times faster with one float32 array."""
    return rr.LineStrips2D(xy_m.astype(np.float32), class_ids=class_ids)


class RerunViewer:
    """Logs one back end under its own prefix into the shared recording."""

    def __init__(
        self,
        stream: SharedStream,
        name: str,
        *,
        map_period_s: float,
        track: LiveTrack | None = None,
    ) -> None:
        """Take part in ``stream`` as ``name``; full maps every ``map_period_s``."""
        self.stream = stream
        self._name = name
        self._map_period_s = map_period_s
        self._track = TrackLayer(self._log, track or LiveTrack())
        self._source: StreamInfo | None = None
        self._frame = 0
        self._pose: Array = np.zeros(3)
        self._stamp_s = 0.0
        self._map_due_s = -np.inf
        self._landmark_xy_m: dict[int, Array] = {}
        self._path_end_m: Array | None = None
        self._status: Status | None = None
        self._overconfident = False
        self._stages: list[str] = []

    def start(self, source: StreamInfo) -> None:
        """Name the recording, and keep the truth until the first frame places it."""
        self._source = source
        if not self.stream.is_on():
            return
        with self.stream.guarded():
            self.stream.recording.send_recording_name(source.name)

    def frame(self, record: FrameRecord, cone_map: Callable[[], ConeMap]) -> None:
        """Log one frame, and the map when it is due."""
        if not self.stream.is_on():
            return
        self._stamp_s = record.estimate.stamp_s
        due = self._stamp_s >= self._map_due_s
        fresh = cone_map() if due else None
        with self.stream.guarded():
            self.stream.set_time(self._stamp_s, self._frame)
            if self._frame == 0:
                self._log_truth(record)
            if fresh is not None:
                self._map_due_s = self._stamp_s + self._map_period_s
                self._log_map(fresh)
                self._track.show_map(fresh, record.estimate.pose)
            self._log_car(record.estimate.pose)
            self._track.show_pose(record.estimate.pose)
            self._pose = record.estimate.pose
            self._log_observations(record)
            self._log_events(record)
            self._log_plots(record)
        self._frame += 1

    def finish(self, cone_map: ConeMap, smoothed: Trajectory | None) -> None:
        """Log the final map and the smoothed path at the last frame's time."""
        if not self.stream.is_on():
            return
        with self.stream.guarded():
            self.stream.set_time(self._stamp_s, max(self._frame - 1, 0))
            self._log_map(cone_map)
            self._track.show_map(cone_map, self._pose)
            if smoothed is not None:
                self._log("smoothed", _strips(smoothed.pose[None, :, :2]))

    def close(self) -> None:
        """Leave the recording; the last to leave completes it."""
        self.stream.leave(self._name)

    def _log(self, path: str, *parts: rr.AsComponents, static: bool = False) -> None:
        self.stream.recording.log(f"{self._name}/{path}", *parts, static=static)

    def _log_truth(self, record: FrameRecord) -> None:
        source = self._source
        if source is None or source.truth_trajectory is None:
            return
        truth = source.truth_trajectory
        if not len(truth):
            return
        placed = align_truth(truth, self._stamp_s, record.estimate.pose)
        path_m = geometry.to_parent(placed, truth.pose[:, :2])
        self._log("truth/trajectory", _strips(path_m[None]), static=True)
        if source.truth_map is not None:
            xy_m = geometry.to_parent(placed, source.truth_map.xy_m)
            self._log("truth/cones", rr.Points2D(xy_m), static=True)

    def _log_map(self, cone_map: ConeMap) -> None:
        ids: IntArray = cone_map.id
        self._landmark_xy_m = dict(zip(ids.tolist(), cone_map.xy_m, strict=True))
        cones = rr.Points2D(
            cone_map.xy_m, class_ids=cone_map.cone_class, labels=ids.astype(str)
        )
        self._log("map/cones", cones)
        known = np.isfinite(cone_map.cov_m2).all(axis=(1, 2))
        outlines = covariance_ellipses(cone_map.xy_m[known], cone_map.cov_m2[known])
        classes = cone_map.cone_class[known]
        self._log("map/ellipses", _strips(outlines, classes))

    def _log_car(self, pose: Array) -> None:
        turn = rr.RotationAxisAngle(axis=(0, 0, 1), radians=pose[2])
        at = (pose[0], pose[1], 0.0)
        self._log("car", rr.Transform3D(translation=at, rotation=turn))
        xy_m = np.array(pose[:2])
        if self._path_end_m is None:
            self._path_end_m = xy_m
        elif np.hypot(*(xy_m - self._path_end_m)) >= MIN_STEP_M:
            self._log("trajectory", _strips(np.stack([[self._path_end_m, xy_m]])))
            self._path_end_m = xy_m

    def _log_observations(self, record: FrameRecord) -> None:
        pose, made = record.estimate.pose, record.associations
        seen_m = geometry.to_parent(pose, record.observations.xy_m)
        codes = [look.MATCH_CODE[status] for status in made.status]
        self._log("observations/cones", rr.Points2D(seen_m, class_ids=codes))
        known = self._landmark_xy_m
        landmark_m = [
            known.get(landmark, xy_m)
            for landmark, xy_m in zip(made.landmark_id.tolist(), seen_m, strict=True)
        ]
        here_m = np.broadcast_to(pose[:2], seen_m.shape)
        rays = np.stack([here_m, seen_m, np.reshape(landmark_m, (-1, 2))], axis=1)
        self._log("observations/rays", _strips(rays, codes))

    def _log_events(self, record: FrameRecord) -> None:
        estimate = record.estimate
        if self._status != estimate.status:
            self._status = estimate.status
            because = f": {record.reason}" if record.reason else ""
            self._log("status", rr.StateChange(state=estimate.status.value))
            self._say(f"{estimate.status}{because}", _STATUS_LEVEL[estimate.status])
        if self._overconfident != record.consistency.overconfident:
            self._overconfident = record.consistency.overconfident
            text = record.reason if self._overconfident else "no longer overconfident"
            self._say(text, TextLogLevel.WARN)
        for closure in record.closures:
            verdict = "accepted" if closure.accepted else "refused"
            text = (
                f"loop closure {verdict} after {closure.distance_m:.1f} m: "
                f"{closure.reason}"
            )
            level = TextLogLevel.INFO if closure.accepted else TextLogLevel.DEBUG
            self._say(text, level)
            self._mark(f"closures/{verdict}", text, estimate)
        for lap in record.laps:
            text = f"lap {lap.number}: {lap.duration_s:.2f} s"
            self._say(text, TextLogLevel.INFO)
            self._mark("lap", text, estimate)

    def _say(self, text: str, level: TextLogLevel) -> None:
        self._log("events", rr.TextLog(f"{self._name}: {text}", level=level))

    def _mark(self, path: str, text: str, where: Estimate) -> None:
        self._log(path, rr.Points2D([where.pose[:2]], labels=[text]))

    def _log_plots(self, record: FrameRecord) -> None:
        made = record.associations
        if made.nis_dof > 0 and np.isfinite(made.nis):
            low, high = chdtri(made.nis_dof, [0.975, 0.025])
            values = np.array([made.nis, low, high]) / made.nis_dof
            lately = record.consistency
            mean = [lately.nis_per_dof, lately.limit]
            self._log("nis", rr.Scalars(np.concatenate([values, mean])))
        new = [stage for stage in record.stage_ms if stage not in self._stages]
        if new:
            self._stages += new
            self._log("latency", look.latency_lines(self._stages), static=True)
        times = [record.stage_ms.get(s, np.nan) for s in self._stages]
        if times:
            self._log("latency", rr.Scalars(times))
