"""``conegraph bench backends``: the estimators against the batch optimum."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import FiguresOption, SetOption, listed

if TYPE_CHECKING:
    from conegraph.bench.plan import Plan

DEFAULT_TRACKS = ",".join(f"random:{seed}" for seed in range(10))
QUICK_TRACKS = "random:2"

TracksOption = Annotated[
    str,
    typer.Option(
        metavar="A,B,…",
        help="Track files, folders of them (their closed tracks), built-in names, "
        "random:SEED. Each seed drives one of them, in turn.",
    ),
]
SeedsOption = Annotated[
    str,
    typer.Option(
        metavar="N|A,B,…",
        help="How many drives, or a list of seeds. Default: one a track, at least 10.",
    ),
]


def backends(
    tracks: TracksOption = DEFAULT_TRACKS,
    seeds: SeedsOption = "",
    laps: Annotated[int, typer.Option(min=1, help="Laps a drive.")] = 3,
    sensors: Annotated[str, typer.Option(help="camera, lidar.")] = "camera,lidar",
    odometry: Annotated[str, typer.Option(help="off, on.")] = "off,on",
    backends: Annotated[
        str, typer.Option(metavar="A,B,…", help="Back ends, as ekf or ekf/thesis.")
    ] = "ekf,isam2",
    set_: SetOption = None,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 takes all cores.")] = 0,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="One drive of 2 laps in each way, only its accuracy."
        ),
    ] = False,
    stress: Annotated[
        bool, typer.Option(help="Also with wrong and unknown colours.")
    ] = True,
    latency: Annotated[
        bool, typer.Option(help="Also frame times; they want a quiet machine.")
    ] = True,
    mrclam: Annotated[
        str, typer.Option(metavar="FOLDER", help="Also the robots of MRCLAM there.")
    ] = "",
    json_: FiguresOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            file_okay=False,
            help="Folder of the rows; what is in it already is not run again, so "
            "take a new one for another version.",
        ),
    ] = None,
) -> None:
    """Run streams through back ends and print each figure beside its target."""
    from conegraph.bench.plan import Plan
    from conegraph.bench.streams import drives, track_names

    names = track_names(QUICK_TRACKS if quick and tracks == DEFAULT_TRACKS else tracks)
    usual = len(names) if quick else max(len(names), 10)
    chosen = _seeds(seeds or str(usual))
    plan = Plan(
        drives=tuple(drives(names, chosen)),
        laps=min(laps, 2) if quick else laps,
        sensors=listed("--sensors", sensors, ("camera", "lidar")),
        odometry=tuple(
            word == "on" for word in listed("--odometry", odometry, ("off", "on"))
        ),
        backends=tuple(name.strip() for name in backends.split(",")),
        settings=tuple(set_ or ()),
        known=not quick,
        stress=stress and not quick,
        latency=latency and not quick,
        mrclam=mrclam or None,
    )
    if out is not None:
        _bench(plan, out, jobs, json_)
        return
    with tempfile.TemporaryDirectory(prefix="conegraph-bench-") as folder:
        _bench(plan, Path(folder), jobs, json_)


def _bench(plan: Plan, out: Path, jobs: int, json_: Path | None) -> None:
    from conegraph.bench.backends import failures_of, figures_of, measure_all
    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import show_figures

    total = len(plan.side_by_side()) + len(plan.one_by_one())
    with progress_bar("bench backends", total) as advance:
        rows = measure_all(plan, out, jobs or os.cpu_count() or 1, advance)
    figures = figures_of(rows)
    show_figures(figures, "Back ends", json_)
    for failure in failures_of(rows):
        typer.echo(f"Failed: {failure}")


def _seeds(given: str) -> tuple[int, ...]:
    """Return a count's first seeds, or the seeds of a list.

    Raises:
        typer.BadParameter: neither.
    """
    parts = [part.strip() for part in given.split(",")]
    if not all(part.isascii() and part.isdigit() for part in parts):
        raise typer.BadParameter(f"--seeds {given!r}: expected a count or a list")
    numbers = tuple(int(part) for part in parts)
    if numbers == (0,):
        raise typer.BadParameter(f"--seeds {given!r}: no drive")
    return tuple(range(numbers[0])) if len(numbers) == 1 else numbers
