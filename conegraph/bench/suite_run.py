"""One run of a suite: through the pipeline, judged, and thinned to what is kept."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

from conegraph.bench.code_version import code_version
from conegraph.bench.memory import PeakMemory, give_back
from conegraph.bench.suite import SuiteJob
from conegraph.config import load_config
from conegraph.eval.series import placed_map, run_series
from conegraph.eval.suite_metrics import METRICS, why_failed
from conegraph.eval.suite_rows import SuiteRow
from conegraph.eval.suite_series import write_series
from conegraph.pipeline import Pipeline, RunResult
from conegraph.sources import open_source
from conegraph.types import Source

SERIES = "series.npz"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run leaves: its row, and the bytes of its series file, if it has one."""

    row: SuiteRow
    series: bytes = b""


def run_job(job: SuiteJob) -> Outcome:
    """Do a job; what goes wrong becomes the row's reason."""
    try:
        return _measured(job)
    except Exception as error:
        said = " ".join(str(error).split())
        return Outcome(failed_row(job, f"{type(error).__name__}: {said}"))


def failed_row(job: SuiteJob, reason: str) -> SuiteRow:
    """Return the row of a run that broke off."""
    nothing = {metric.name: math.nan for metric in METRICS}
    return _row(job, nothing).model_copy(update={"status": "failed", "reason": reason})


@lru_cache(maxsize=1)
def _stream(text: str) -> Source:
    """Make a stream once for all back ends, which follow one another."""
    return open_source(text)


def _measured(job: SuiteJob) -> Outcome:
    """Run as ``conegraph compare`` does, with its files in a folder that is dropped."""
    source, memory = _stream(job.source), PeakMemory()
    pipeline = Pipeline(load_config(None, job.settings, backend=job.backend), source)
    with TemporaryDirectory(prefix="conegraph-bench-") as name:
        folder = Path(name)
        give_back()
        memory.take_mb()
        before_mb = memory.take_mb()
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        result = pipeline.run(folder)
        cost = {
            "wall_s": time.perf_counter() - began_s,
            "cpu_s": time.process_time() - began_cpu_s,
            "peak_mb": memory.take_mb() - before_mb,
        }
        series = _series(result, folder / SERIES)
    if result.metrics is None:
        raise ValueError(f"{job.source}: was not judged")
    plain = {**result.summary, **result.metrics.to_dict(), **cost}
    return Outcome(_row(job, {m.name: m.of(plain) for m in METRICS}), series)


def _series(result: RunResult, path: Path) -> bytes:
    if result.folder is None or result.metrics is None:
        return b""
    along = run_series(result.folder, result.truth)
    write_series(path, along, placed_map(result.folder, result.truth, result.metrics))
    return path.read_bytes()


def _row(job: SuiteJob, metrics: Mapping[str, float]) -> SuiteRow:
    kind, _, profile = job.backend.partition("/")
    return SuiteRow(
        suite=job.suite,
        track=job.stream.track,
        sensor=job.stream.sensor,
        odometry=job.stream.odometry,
        faults=job.faults,
        seed=job.stream.seed,
        laps=job.stream.laps,
        backend=kind,
        profile=profile or "default",
        settings=" ".join(job.settings),
        stream=job.source,
        command=job.command,
        config_hash=job.config_hash,
        code_version=code_version(),
        status="ok",
        reason=why_failed(metrics),
        metrics=dict(metrics),
    )
