"""One stream through one or more back ends, and what the judge says to it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from rich.text import Text

from conegraph.camera_stream import CameraStream, with_front_end
from conegraph.cli.progress import progress_bar
from conegraph.cli.tables import console
from conegraph.config import Config
from conegraph.eval import Comparison, render_table
from conegraph.pipeline import Pipeline, RunResult
from conegraph.sim.camera_drive import CameraDrive
from conegraph.sim.render_pool import free_cores
from conegraph.sources import open_stream
from conegraph.types import ConeMap, ConeObservations, Source
from conegraph.viewer import Viewer, open_viewer, watch_camera

RECORDING = "run.rrd"


@dataclass(frozen=True, slots=True)
class Job:
    """One run to make: its configuration, its folder, and what it may use of a map."""

    config: Config
    folder: Path
    known_map: ConeMap | None = None
    add_cones: bool = True


def run_jobs(
    jobs: Mapping[str, Job],
    out: Path,
    *,
    view: bool,
    save_rrd: bool,
    detector: str | None = None,
) -> dict[str, RunResult]:
    """Send one stream through every job in turn; the source is read once.

    Args:
        jobs: by name; the first one's config names the source.
        out: the folder of the whole, for the recording.
        view: whether to show the runs live.
        save_rrd: whether to write the recording.
        detector: the one that was asked for, if any: a source may have no pictures.

    Raises:
        ConegraphError: the source cannot be read, or a folder not be written.
    """
    config = next(iter(jobs.values())).config
    with progress_bar(f"reading {config.source}"):
        stream = open_stream(config.source, seed=config.seed)
    if isinstance(stream, CameraDrive):
        stream = replace(stream, workers=free_cores())
    source = with_front_end(stream, config)
    if detector is not None and not isinstance(source, CameraStream):
        print(
            f"conegraph: --detector {detector} is not used: {config.source} has cones, "
            "and no pictures",
            file=sys.stderr,
        )
    out.mkdir(parents=True, exist_ok=True)
    recording = out / RECORDING
    # One of an earlier run would not be of this one.
    recording.unlink(missing_ok=True)
    with ExitStack() as closing:
        viewers = open_viewer(
            tuple(jobs),
            live=view,
            path=recording if save_rrd else None,
            map_period_s=config.viewer.map_period_s,
            camera=isinstance(source, CameraStream),
            track=config.track,
            roles=config.roles,
        )
        if isinstance(source, CameraStream):
            period_s = config.viewer.picture_period_s
            source.watcher = watch_camera(viewers, period_s=period_s)
        for viewer in viewers.values():
            closing.callback(viewer.close)
        if len(jobs) > 1 and isinstance(source, CameraStream):
            _look_first(source)
        return {
            name: _run_job(name, job, source, viewers[name])
            for name, job in jobs.items()
        }


def _look_first(source: CameraStream) -> None:
    """Find the cones in all pictures before any back end is timed.

    Pictures are rendered or read beside the program that takes them: the frames of
    the back end that came first would be charged with it. A live camera has no end.
    """
    if source.n_frames is None:
        return
    with progress_bar("looking for cones", source.n_frames) as advance:
        cones = (e for e in source.events() if isinstance(e, ConeObservations))
        for done, _ in enumerate(cones, 1):
            advance(done)


def _run_job(name: str, job: Job, source: Source, viewer: Viewer) -> RunResult:
    pipeline = Pipeline(
        job.config,
        source,
        viewer=viewer,
        known_map=job.known_map,
        add_cones=job.add_cones,
    )
    with progress_bar(name, source.n_frames) as advance:
        result = pipeline.run(job.folder, advance)
    for reason, count in result.summary["rejected"].items():
        print(f"conegraph: {name}: {count} x {reason}: left out", file=sys.stderr)
    doubt = result.summary["consistency"]
    if doubt["overconfident_frames"]:
        print(
            f"conegraph: {name}: overconfident in {doubt['overconfident_frames']} of "
            f"{result.summary['frames']} frames, NIS/dof up to "
            f"{doubt['overconfident_worst']:.1f}: the noise is assumed too small; "
            "conegraph tune estimates it",
            file=sys.stderr,
        )
    return result


def print_comparison(comparison: Comparison) -> None:
    """Print what spoils all figures, their table, what is odd, and the verdict."""
    out = console()
    for alarm in comparison.alarms:
        out.print(Text(f"Beware: {alarm}", style="bold"))
    out.print(render_table(comparison))
    for warning in comparison.warnings:
        out.print(Text(f"Note: {warning}"))
    out.print(Text(comparison.verdict))
