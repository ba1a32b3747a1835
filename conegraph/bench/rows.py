"""What one run leaves behind: one line of JSON, read back and validated."""

from __future__ import annotations

import numpy as np

from conegraph.bench.streams import Stream
from conegraph.eval.row import Number, Row
from conegraph.eval.suite_metrics import DIVERGED_M, LEAST_PRECISION
from conegraph.types import Array, IntArray


class Job(Row):
    """One thing to measure in a process of its own.

    Attributes:
        group: which figures it is for.
        stream: what comes in.
        backend: kind, or ``kind/profile``; ``reference`` is the batch optimum, and
            ``cost`` the time that the EKF takes on a given map.
        settings: ``KEY=VALUE`` overrides of the configuration.
        live: whether frames come when they were seen, and not as fast as they can be
            taken: a mapper beside the frame path needs the time between frames.
    """

    group: str
    stream: Stream
    backend: str
    settings: tuple[str, ...] = ()
    live: bool = False

    @property
    def key(self) -> str:
        """What tells it from all others."""
        return " ".join((self.group, self.stream.source, self.backend, *self.settings))


class ReferenceMap(Row):
    """The batch optimum's cones at a stamp."""

    end_s: Number
    cone_id: tuple[int, ...]
    xy_m: tuple[tuple[float, float], ...]

    def chosen_m(self, ids: IntArray) -> Array:
        """Return (k, 2) positions of the given cones, which it must hold."""
        own = np.array(self.cone_id, dtype=np.int64)
        xy = np.array(self.xy_m, dtype=np.float64).reshape(-1, 2)
        found: Array = xy[np.searchsorted(own, ids)]
        return found


class ReferenceRow(Row):
    """The batch optimum of a stream, at each lap's end and at the end.

    Attributes:
        key: of its job.
        laps: its maps at the true ends of the laps.
        final: its map at the end.
        map_rmse_m: aligned RMSE of all cones seen.
        map_bound_m: the Cramér-Rao bound on it.
        map_bound_sigma: standard deviation of the squared ratio of the two in one
            drive.
        pose_rmse_m: RMSE of the path in the start frame.
        pose_bound_m: the Cramér-Rao bound on it.
        causal_s: stamps of some frames.
        causal_bound_m: the Cramér-Rao bound on the position at each, without the
            frames after it.
        wall_s: how long it took.
        reason: why there is none, empty if there is.
    """

    key: str
    laps: tuple[ReferenceMap, ...] = ()
    final: ReferenceMap | None = None
    map_rmse_m: Number = np.nan
    map_bound_m: Number = np.nan
    map_bound_sigma: Number = np.nan
    pose_rmse_m: Number = np.nan
    pose_bound_m: Number = np.nan
    causal_s: tuple[float, ...] = ()
    causal_bound_m: tuple[float, ...] = ()
    wall_s: Number = np.nan
    reason: str = ""

    @property
    def causal_ratio(self) -> float:
        """How many times the bound on a causal path is that on the whole drive's."""
        causal = float(np.sqrt(np.mean(np.square(self.causal_bound_m))))
        return causal / self.pose_bound_m

    @property
    def broke_off(self) -> bool:
        """Whether there is none."""
        return bool(self.reason)


class LapRow(Row):
    """A run from one true lap's end to the next.

    Attributes:
        number: from 1.
        map_rmse_m: aligned RMSE of the map when the lap ends.
        batch_rmse_m: that of the batch optimum of the data until then, over the same
            cones.
        p50_ms: median time of a frame in the lap.
        p99_ms: its 99th percentile.
        max_ms: its greatest.
        peak_mb: greatest resident memory of the process and its children in the lap.
    """

    number: int
    map_rmse_m: Number = np.nan
    batch_rmse_m: Number = np.nan
    p50_ms: Number = np.nan
    p99_ms: Number = np.nan
    max_ms: Number = np.nan
    peak_mb: Number = np.nan


class JobRow(Row):
    """What became of a job.

    Attributes:
        job: what was done.
        reason: why there is nothing else, empty for a job that came to its end.
    """

    job: Job
    reason: str = ""

    @property
    def key(self) -> str:
        """That of its job."""
        return self.job.key

    @property
    def broke_off(self) -> bool:
        """Whether there is nothing else."""
        return bool(self.reason)


class RunRow(JobRow):
    """One run of one back end over one stream.

    Attributes:
        frames: accepted frames.
        laps: by true lap.
        map_rmse_m: aligned RMSE of the final map.
        batch_rmse_m: that of the batch optimum over the same cones.
        pose_rmse_m: RMSE of the causal path in the start frame.
        pose_max_m: its greatest error.
        batch_pose_rmse_m: RMSE of the batch optimum's path in the start frame.
        ate_m: causal ATE after the best rigid fit.
        ate_2_laps_m: the same over the first two laps.
        precision: matched cones / estimated ones, of the final map.
        recall: matched cones / observable ones.
        duplicates: cones that stand where another does already.
        false_closures: accepted closures most of whose matches were wrong.
        closures_due: true crossings of the start line that end a lap.
        closures_in_time: of those, with an accepted closure by 1 s after.
        laps_counted: laps that the back end counted.
        laps_true: laps that were driven.
        pose_nees: mean NEES per degree of freedom of the causal pose, start frame.
        sigma_over_bound: rms sigma of the causal position over the rms of its
            Cramér-Rao bound, at the frames where that is known.
        map_nees: that of the final map, start frame.
        map_nees_aligned: that of the final map after the best rigid fit.
        nis: mean NIS per degree of freedom.
        start_mb: resident memory before the first frame.
        wall_s: time of the whole run.
    """

    frames: int = 0
    laps: tuple[LapRow, ...] = ()
    map_rmse_m: Number = np.nan
    batch_rmse_m: Number = np.nan
    pose_rmse_m: Number = np.nan
    pose_max_m: Number = np.nan
    batch_pose_rmse_m: Number = np.nan
    ate_m: Number = np.nan
    ate_2_laps_m: Number = np.nan
    precision: Number = np.nan
    recall: Number = np.nan
    duplicates: int = 0
    false_closures: int = 0
    closures_due: int = 0
    closures_in_time: int = 0
    laps_counted: int = 0
    laps_true: int = 0
    pose_nees: Number = np.nan
    sigma_over_bound: Number = np.nan
    map_nees: Number = np.nan
    map_nees_aligned: Number = np.nan
    nis: Number = np.nan
    start_mb: Number = np.nan
    wall_s: Number = np.nan

    @property
    def map_ratio(self) -> float:
        """Error of the final map over the batch optimum's."""
        return self.map_rmse_m / self.batch_rmse_m

    @property
    def pose_ratio(self) -> float:
        """Error of the causal path over the batch optimum's."""
        return self.pose_rmse_m / self.batch_pose_rmse_m

    @property
    def diverged(self) -> bool:
        """Whether the pose was ever off by 2 m, or a tenth of the map false."""
        fine = self.pose_max_m <= DIVERGED_M and self.precision >= LEAST_PRECISION
        return bool(self.reason) or not fine


class CostRow(JobRow):
    """Median time of an EKF frame on a map with so many cones."""

    cones: int = 0
    frame_ms: Number = np.nan


AnyRow = ReferenceRow | CostRow | RunRow
