"""What a frame of the EKF costs as the map grows."""

from __future__ import annotations

import time

import numpy as np

from conegraph.bench.rows import CostRow, Job
from conegraph.config import load_config
from conegraph.pipeline import Pipeline
from conegraph.types import ConeMap, Recording, TruthMap

FRAMES = 300
SKIPPED = 30
"""First frames, in which caches and the landmarks' correlations are still cold."""

MAP_SIGMA_M = 0.05


def frame_cost(job: Job, recording: Recording) -> CostRow:
    """Measure the EKF's median frame on a stream's own map, known from the start.

    All cones are in the state from the first frame on, so that a few seconds of
    driving tell what a frame costs with so many. Processor time is counted: a machine
    that is busy otherwise must not bend the exponent.
    """
    cones = recording.truth_map
    if cones is None:
        raise ValueError(f"{recording.name}: no true cones")
    config = load_config(None, job.settings, backend="ekf")
    pipeline = Pipeline(config, recording, known_map=_as_map(cones))
    ticks = [time.process_time()]
    for _ in zip(range(FRAMES), pipeline.records(), strict=False):
        ticks.append(time.process_time())
    ms = 1e3 * np.diff(ticks)[SKIPPED:]
    return CostRow(job=job, cones=len(cones), frame_ms=float(np.median(ms)))


def _as_map(cones: TruthMap) -> ConeMap:
    n = len(cones)
    prob = np.full((n, 5), 0.025)
    prob[np.arange(n), cones.cone_class] = 0.9
    cov = np.tile(MAP_SIGMA_M**2 * np.eye(2), (n, 1, 1))
    seen = np.full(n, 10, dtype=np.int64)
    return ConeMap(np.arange(n, dtype=np.int64), cones.xy_m, cov, prob, seen)
