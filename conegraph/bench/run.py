"""One back end over one stream, measured while it runs."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Sequence

import numpy as np

from conegraph.bench.lap_truth import true_lap_ends
from conegraph.bench.map_judge import JudgedMap, MapJudge
from conegraph.bench.memory import PeakMemory
from conegraph.bench.rows import Job, LapRow, ReferenceRow, RunRow
from conegraph.bench.run_log import RunLog
from conegraph.config import load_config
from conegraph.eval.align import distance, rms
from conegraph.eval.closure_metrics import CLOSURE_AFTER_S, CLOSURE_BEFORE_S
from conegraph.eval.consistency import pose_consistency
from conegraph.eval.pose_pairs import pair_with_truth
from conegraph.eval.reference_graph import StartFrameTruth, truth_of
from conegraph.eval.trajectory_metrics import trajectory_metrics
from conegraph.pipeline import Pipeline
from conegraph.types import ConeMap, FrameRecord, Recording

ATE_LAPS = 2


def measure(job: Job, recording: Recording, reference: ReferenceRow) -> RunRow:
    """Run a back end to the end and judge it.

    Maps are read when the true car ends a lap, and after the run has been finished.

    Raises:
        ConegraphError: the configuration cannot be used.
        ValueError: the recording does not know the truth.
    """
    began = time.perf_counter()
    ends = () if job.stream.recorded else true_lap_ends(recording)
    pipeline = Pipeline(load_config(None, job.settings, backend=job.backend), recording)
    log, memory, peaks, maps = RunLog(), PeakMemory(), list[float](), list[ConeMap]()
    gc.collect()
    memory.take_mb()
    start_mb = memory.take_mb()
    records = pipeline.records()
    for record in as_they_came(records) if job.live else records:
        log.add(record, len(maps) + 1)
        if len(maps) < len(ends) and record.observations.stamp_s >= ends[len(maps)]:
            peaks.append(memory.take_mb())
            maps.append(pipeline.backend.cone_map())
    pipeline.backend.finish()
    wall_s = time.perf_counter() - began
    truth, judge = truth_of(recording), _judge_of(recording)
    known = (*reference.laps, *(None for _ in maps))
    at_ends = [
        judge.judge(cone_map, log, optimum, end_s)
        for cone_map, optimum, end_s in zip(maps, known, ends, strict=False)
    ]
    final = judge.judge(pipeline.backend.cone_map(), log, reference.final)
    figures = {
        **_map_figures(final),
        **_path_figures(log, truth, ends),
        "sigma_over_bound": _sigma_over_bound(log, reference),
        **_closure_figures(log, ends),
    }
    return RunRow(
        job=job,
        frames=len(log.stamp_s),
        laps=_lap_rows(at_ends, peaks, log),
        batch_pose_rmse_m=reference.pose_rmse_m,
        start_mb=start_mb,
        wall_s=wall_s,
    ).model_copy(update=figures)


def as_they_came(records: Iterator[FrameRecord]) -> Iterator[FrameRecord]:
    """Yield records, waiting after each until the next could have been seen."""
    before_s = offset_s = None
    for record in records:
        stamp_s = record.observations.stamp_s
        step_s = 0.0 if before_s is None else stamp_s - before_s
        if offset_s is None:
            offset_s = time.perf_counter() - stamp_s
        yield record
        # The next frame comes about as long after this one as this after the last.
        time.sleep(max(offset_s + stamp_s + step_s - time.perf_counter(), 0.0))
        before_s = stamp_s


def _judge_of(recording: Recording) -> MapJudge:
    cones = recording.truth_map
    if cones is None:
        raise ValueError(f"{recording.name}: no true cones")
    return MapJudge(truth_of(recording), cones.cone_class[np.argsort(cones.id)])


def _lap_rows(
    judged: Sequence[JudgedMap], peaks: Sequence[float], log: RunLog
) -> tuple[LapRow, ...]:
    lap, ms = np.array(log.lap), np.array(log.frame_ms)
    rows = []
    for number, (at_end, peak_mb) in enumerate(zip(judged, peaks, strict=True), 1):
        p50, p99, most = np.percentile(ms[lap == number], (50, 99, 100)).tolist()
        rows.append(
            LapRow(
                number=number,
                map_rmse_m=at_end.metrics.rmse_aligned_m,
                batch_rmse_m=at_end.batch_rmse_m,
                p50_ms=p50,
                p99_ms=p99,
                max_ms=most,
                peak_mb=peak_mb,
            )
        )
    return tuple(rows)


def _map_figures(judged: JudgedMap) -> dict[str, float | int]:
    metrics, start = judged.metrics, judged.metrics.start_frame
    return {
        "map_rmse_m": metrics.rmse_aligned_m,
        "batch_rmse_m": judged.batch_rmse_m,
        "precision": metrics.precision,
        "recall": metrics.recall,
        "duplicates": metrics.duplicates,
        "map_nees": np.nan if start is None else start.nees_per_dof,
        "map_nees_aligned": metrics.nees_per_dof,
    }


def _path_figures(
    log: RunLog, truth: StartFrameTruth, ends: Sequence[float]
) -> dict[str, float | int]:
    path = log.path()
    pairs = pair_with_truth(path, truth.trajectory)
    off = distance(pairs.estimate[:, :2], pairs.truth[:, :2])
    judged = np.isin(path.stamp_s, pairs.stamp_s)
    cov = np.array(log.cov).reshape(-1, 3, 3)[judged]
    whole = trajectory_metrics(path, truth.trajectory)
    two = None
    if len(ends) >= ATE_LAPS:
        two = trajectory_metrics(log.path(ends[ATE_LAPS - 1]), truth.trajectory)
    dof = np.array(log.nis_dof)
    some = dof > 0
    return {
        "pose_rmse_m": rms(off),
        "pose_max_m": float(off.max(initial=0.0)),
        "ate_m": np.nan if whole is None else whole.ate_se2.rmse_m,
        "ate_2_laps_m": np.nan if two is None else two.ate_se2.rmse_m,
        "pose_nees": pose_consistency(pairs.estimate, cov, pairs.truth).nees_per_dof,
        "nis": float(np.array(log.nis)[some].sum() / max(dof.sum(), 1)),
    }


def _sigma_over_bound(log: RunLog, reference: ReferenceRow) -> float:
    """Compare what the back end claims to know with what can be known."""
    _, at, known = np.intersect1d(log.stamp_s, reference.causal_s, return_indices=True)
    if not len(at):
        return float("nan")
    cov = np.array(log.cov)[at]
    bound = np.array(reference.causal_bound_m)[known]
    return float(np.sqrt(np.trace(cov[:, :2, :2], axis1=1, axis2=2).sum())) / float(
        np.sqrt(np.sum(bound**2))
    )


def _closure_figures(log: RunLog, ends: Sequence[float]) -> dict[str, float | int]:
    closed_s = np.array(log.stamp_s)[log.closed]
    in_time = [
        bool(
            np.any(
                (closed_s >= end_s - CLOSURE_BEFORE_S)
                & (closed_s <= end_s + CLOSURE_AFTER_S)
            )
        )
        for end_s in ends
    ]
    return {
        "false_closures": log.false_closures(),
        "closures_due": len(ends),
        "closures_in_time": sum(in_time),
        "laps_counted": log.laps,
        "laps_true": len(ends),
    }
