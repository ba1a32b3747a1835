"""``conegraph bench doctor``: whether the doctor names what was done to a run."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from conegraph.cli.options import FiguresOption, listed

DEFAULT_TRACKS = "oval,random:5"
"""Short ones: every cause is driven on each, with every seed, sensor and back end."""


def doctor(
    tracks: Annotated[
        str,
        typer.Option(metavar="A,B,…", help="Track files, built-in names, random:SEED."),
    ] = DEFAULT_TRACKS,
    seeds: Annotated[
        str, typer.Option(metavar="A,B,…", help="Seeds of the drives.")
    ] = "10,11",
    sensors: Annotated[str, typer.Option(help="camera, lidar.")] = "camera,lidar",
    backends: Annotated[str, typer.Option(help="ekf, isam2.")] = "ekf,isam2",
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 takes all cores.")] = 0,
    json_: FiguresOption = None,
) -> None:
    """Put each cause into simulated drives and count the right first diagnoses."""
    from conegraph.bench.doctor import (
        confusion,
        doctor_figures,
        mistakes,
        trials,
        try_all,
    )
    from conegraph.bench.streams import track_names
    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import WIDTH_OF_FIGURES, console, show_figures

    try:
        numbers = [int(seed) for seed in seeds.split(",")]
    except ValueError:
        raise typer.BadParameter(f"--seeds {seeds!r}: expected whole numbers") from None
    planned = trials(
        track_names(tracks),
        numbers,
        listed("--sensors", sensors, ("camera", "lidar")),
        listed("--backends", backends, ("ekf", "isam2")),
    )
    with progress_bar("bench doctor", len(planned)) as advance:
        outcomes = try_all(planned, jobs or os.cpu_count() or 1, advance)
    console(WIDTH_OF_FIGURES).print(confusion(outcomes))
    for mistake in mistakes(outcomes):
        typer.echo(f"Wrong: {mistake}")
    show_figures(doctor_figures(outcomes), "Doctor", json_)
