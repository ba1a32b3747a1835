"""The loop: a source through a back end, written down, shown and judged."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from conegraph.backends import Backend, make_backend
from conegraph.camera import Stream
from conegraph.camera_stream import CameraStream, with_front_end
from conegraph.config import Config, config_to_toml
from conegraph.eval import RunMetrics, Truth, evaluate
from conegraph.eval.pose_pairs import pair_with_truth
from conegraph.io.run_folder import RunFolder, RunWriter, read_run
from conegraph.io.run_writer import TRUTH, replace_text
from conegraph.io.tum_trajectory import format_tum
from conegraph.sources import open_stream
from conegraph.track import detect_track
from conegraph.track.files import TRACK, write_track
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    FrameRecord,
    IntArray,
    Lap,
    LoopClosure,
    Source,
    Trajectory,
    VelocityObservation,
)
from conegraph.viewer import NullViewer, Viewer

CHECKPOINT_S = 5.0
"""Stream time between maps written while running, so that a kill leaves one."""


@dataclass(slots=True)
class ConsistencyLog:
    """What the innovations of a run said about its noise.

    Attributes:
        nis: sum over all frames.
        dof: its degrees of freedom.
        overconfident_frames: frames that ended an overconfident window.
        warnings: how often the run became overconfident.
        worst: the greatest NIS / dof of such a window, NaN without any.
    """

    nis: float = 0.0
    dof: int = 0
    overconfident_frames: int = 0
    warnings: int = 0
    worst: float = float("nan")
    _warned: bool = False

    def add(self, record: FrameRecord) -> None:
        """Count one frame."""
        made, now = record.associations, record.consistency
        if made.nis_dof > 0:
            self.nis += made.nis
            self.dof += made.nis_dof
        self.warnings += now.overconfident and not self._warned
        self._warned = now.overconfident
        if now.overconfident:
            self.overconfident_frames += 1
            self.worst = float(np.fmax(self.worst, now.nis_per_dof))

    def summary(self) -> dict[str, Any]:
        """Return what ``summary.json`` says of it."""
        return {
            "nis_per_dof": self.nis / self.dof if self.dof else float("nan"),
            "dof": self.dof,
            "overconfident_warnings": self.warnings,
            "overconfident_frames": self.overconfident_frames,
            "overconfident_worst": self.worst,
        }


@dataclass(slots=True)
class RunLog:
    """What a run adds up on its way.

    Attributes:
        frames: accepted frames.
        laps: completed laps.
        closures: loop closures tried.
        stage_ms: time by stage, one entry a frame that had it.
        consistency: what the innovations said.
        truth_ids: true ids of all accepted observations, None once one is missing.
    """

    frames: int = 0
    laps: list[Lap] = field(default_factory=list)
    closures: list[LoopClosure] = field(default_factory=list)
    stage_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    consistency: ConsistencyLog = field(default_factory=ConsistencyLog)
    truth_ids: list[IntArray] | None = field(default_factory=list)

    def add(self, record: FrameRecord) -> None:
        """Count one frame."""
        self.frames += 1
        self.laps += record.laps
        self.closures += record.closures
        self.consistency.add(record)
        for stage, ms in record.stage_ms.items():
            self.stage_ms[stage].append(ms)
        ids = record.observations.truth_id
        if ids is None:
            self.truth_ids = None
        elif self.truth_ids is not None:
            self.truth_ids.append(ids)


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run ends with.

    Attributes:
        cone_map: the confirmed cones.
        smoothed: the smoothed path, None from a filter.
        summary: what ``summary.json`` holds.
        folder: what was written, None if nothing was.
        truth: what the source knows of the truth.
        metrics: the judge's figures, None if nothing was written.
    """

    cone_map: ConeMap
    smoothed: Trajectory | None
    summary: dict[str, Any]
    folder: RunFolder | None
    truth: Truth
    metrics: RunMetrics | None


class Pipeline:
    """Runs any source through any back end."""

    def __init__(
        self,
        config: Config,
        source: Stream | Source | str | None = None,
        *,
        viewer: Viewer | None = None,
        known_map: ConeMap | None = None,
        add_cones: bool = True,
    ) -> None:
        """Open the source that is given, or named here or in the configuration.

        Args:
            config: the whole configuration.
            source: a source of cones or of pictures, or the text of one.
            viewer: who is shown every frame.
            known_map: cones that are known from the start.
            add_cones: False only localises on them.
        """
        text = config.source if source is None else source
        stream = open_stream(text, seed=config.seed) if isinstance(text, str) else text
        self.source = with_front_end(stream, config)
        self.config = config = for_source(config, self.source)
        self._viewer = viewer or NullViewer()
        self._known_map = known_map
        self.backend: Backend = make_backend(
            config.backend,
            config,
            sensor=self.source.sensor,
            known_map=known_map,
            add_cones=add_cones,
        )

    def run(
        self, out: Path | None = None, progress: Callable[[int], None] | None = None
    ) -> RunResult:
        """Run to the end of the source; write into ``out`` unless it is None.

        Raises:
            ConegraphError: the output cannot be written.
        """
        log, began = RunLog(), time.perf_counter()
        writer: AbstractContextManager[RunWriter | None] = nullcontext()
        if out is not None:
            writer = RunWriter(out, config_to_toml(self.config))
        self._viewer.start(self.source)
        with writer as files:
            checkpoint_s, first_pose = -np.inf, None
            for record in self.records():
                log.add(record)
                if first_pose is None:
                    first_pose = record.estimate.pose
                self._viewer.frame(record, self.backend.cone_map)
                if files is not None:
                    files.frame(record)
                    if record.estimate.stamp_s > checkpoint_s + CHECKPOINT_S:
                        checkpoint_s = record.estimate.stamp_s
                        files.checkpoint(self.backend.cone_map())
                if progress is not None:
                    progress(log.frames)
            smoothed, cone_map = self.backend.finish(), self.backend.cone_map()
            log.closures += self.backend.last_events.closures
            self._viewer.finish(cone_map, smoothed)
            summary = self._summary(log, time.perf_counter() - began)
            if files is not None:
                files.revise(self.backend.last_events.revisions)
                files.finish(cone_map, smoothed, summary)
                self._write_track(files.folder, cone_map, first_pose)
            return self._judged(files, out, log, cone_map, smoothed, summary)

    def _write_track(self, out: Path, cone_map: ConeMap, pose: Array | None) -> None:
        """Write the track between the cones of the final map, as ``track`` does."""
        config = self.config
        track = detect_track(cone_map, pose, config=config.track, roles=config.roles)
        write_track(out / TRACK, track)

    def records(self) -> Iterator[FrameRecord]:
        """Feed every event to the back end; yield what became of each frame."""
        for event in self.source.events():
            if isinstance(event, VelocityObservation):
                self.backend.observe_velocity(event)
                continue
            record = self._frame(event)
            if record is not None:
                yield record

    def _frame(self, frame: ConeObservations) -> FrameRecord | None:
        began = time.perf_counter()
        associations = self.backend.observe_cones(frame)
        accepted = self.backend.last_frame
        if associations is None or accepted is None:
            return None
        estimate, events = self.backend.estimate(), self.backend.last_events
        stages = dict(events.stage_ms or {})
        stages["frame"] = 1e3 * (time.perf_counter() - began)
        if isinstance(self.source, CameraStream) and self.source.detect_ms is not None:
            stages["detect"] = self.source.detect_ms
        return FrameRecord(
            accepted,
            associations,
            estimate,
            events.reason,
            events.closures,
            events.laps,
            stages,
            events.consistency,
            events.revisions,
            events.odometry,
        )

    def _summary(self, log: RunLog, wall_s: float) -> dict[str, Any]:
        rejected = Counter(self.source.rejected) + Counter(self.backend.rejected)
        return {
            "source": self.source.name,
            "backend": self.config.backend.kind,
            "profile": self.config.backend.profile,
            "mapping": getattr(self.config.backend, "mapping", ""),
            "frames": log.frames,
            "laps": [
                {"number": n.number, "end_s": n.end_s, "duration_s": n.duration_s}
                for n in log.laps
            ],
            "loop_closures": [
                {
                    "stamp_s": c.stamp_s,
                    "distance_m": c.distance_m,
                    "accepted": c.accepted,
                    "reason": c.reason,
                }
                for c in log.closures
            ],
            "rejected": dict(sorted(rejected.items())),
            "known_map": _described(self._known_map),
            "consistency": log.consistency.summary(),
            "latency_ms": {k: _percentiles(v) for k, v in log.stage_ms.items()},
            "wall_s": wall_s,
            "peak_memory_mb": _peak_memory_mb(),
        }

    def _judged(
        self,
        files: RunWriter | None,
        out: Path | None,
        log: RunLog,
        cone_map: ConeMap,
        smoothed: Trajectory | None,
        summary: dict[str, Any],
    ) -> RunResult:
        """Read the run back as anybody would and let the judge look at it."""
        ids = np.concatenate(log.truth_ids) if log.truth_ids else None
        truth = Truth(self.source.truth_trajectory, self.source.truth_map, ids)
        if files is None or out is None:
            return RunResult(cone_map, smoothed, summary, None, truth, None)
        folder = read_run(out)
        if truth.trajectory is not None:
            _write_truth(out, folder.trajectory, truth.trajectory)
        metrics = evaluate(folder, truth)
        if truth.trajectory is not None or truth.cones is not None:
            summary = {**summary, "metrics": metrics.to_dict()}
            files.finish(cone_map, smoothed, summary)
        return RunResult(cone_map, smoothed, summary, folder, truth, metrics)


def _write_truth(out: Path, path: Trajectory, truth: Trajectory) -> None:
    """Write the true poses at the path's stamps, for tools that compare two files."""
    pairs = pair_with_truth(path, truth)
    replace_text(out / TRUTH, format_tum(Trajectory(pairs.stamp_s, pairs.truth)))


def for_source(config: Config, source: Source) -> Config:
    """Fill in what neither file nor command line sets from what the source knows."""
    motion, association = config.motion, config.association
    bias = source.yaw_rate_bias_radps
    if motion.gyro_bias_sigma_radps is None and bias is not None:
        motion = motion.model_copy(update={"gyro_bias_sigma_radps": bias})
    if source.ids_are_given and "method" not in association.model_fields_set:
        association = association.model_copy(update={"method": "known"})
    return config.model_copy(update={"motion": motion, "association": association})


def _described(known: ConeMap | None) -> dict[str, int] | None:
    """Return what tells the cones of a given map from those that the run found."""
    if known is None:
        return None
    return {"cones": len(known), "greatest_id": int(known.id.max(initial=-1))}


def _percentiles(ms: list[float]) -> dict[str, float]:
    p50, p95, p99 = np.percentile(ms, [50, 95, 99])
    return {"p50": p50, "p95": p95, "p99": p99, "max": max(ms)}


def _peak_memory_mb() -> float:
    """Return the process's peak resident memory, NaN where nobody tells."""
    try:
        import resource
    except ImportError:
        return float("nan")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
