"""From rendered camera frames to a map, with every back end."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from conegraph.bench.figure import Figure
from conegraph.camera_stream import with_front_end
from conegraph.config import load_config
from conegraph.eval.map_metrics import MapMetrics
from conegraph.pipeline import Pipeline
from conegraph.sources import SimOptions, render_track

MAX_RMSE_M = 0.15
MIN_SHARE = 0.97


def map_figures(
    seed: int,
    backends: Sequence[str],
    settings: Sequence[str],
    done: Callable[[int], None],
    *,
    laps: int = 2,
) -> list[Figure]:
    """Drive a random course with a camera and map it from the pictures.

    Args:
        seed: makes the course, its look and the drive.
        backends: as ``kind`` or ``kind/profile``.
        settings: ``KEY=VALUE`` of the configuration.
        done: is told how many frames are done, over all back ends.
        laps: how many laps.
    """
    stream = render_track(f"random:{seed}", SimOptions(laps, seed, "rgbd"))
    configs = {name: load_config(None, settings, backend=name) for name in backends}
    source = with_front_end(stream, next(iter(configs.values())))
    figures = []
    for turn, (name, config) in enumerate(configs.items()):
        advance = partial(_advance, done, turn * stream.n_frames)
        with tempfile.TemporaryDirectory(prefix="conegraph-bench-") as folder:
            result = Pipeline(config, source).run(Path(folder), advance)
        if result.metrics is not None and result.metrics.map is not None:
            figures += _figures(f"camera to map, {name}", result.metrics.map)
    return figures


def _advance(done: Callable[[int], None], before: int, frames: int) -> None:
    done(before + frames)


def _figures(name: str, found: MapMetrics) -> list[Figure]:
    shares = f"{found.precision:.3f}, {found.recall:.3f}"
    rmse = found.rmse_aligned_m
    enough = min(found.precision, found.recall) >= MIN_SHARE
    values = {"precision": found.precision, "recall": found.recall}
    return [
        Figure(f"{name}: precision, recall", f"≥ {MIN_SHARE}", shares, enough, values),
        Figure(
            f"{name}: RMSE aligned, in m",
            f"≤ {MAX_RMSE_M}",
            f"{rmse:.3f}",
            rmse <= MAX_RMSE_M,
            {"value": rmse},
        ),
    ]
