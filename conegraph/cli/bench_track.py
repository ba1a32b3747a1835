"""``conegraph bench track``: how often, how exactly and how fast tracks are found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conegraph.cli.options import FiguresOption, SetOption


def track(
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder whose closed track files are used too."
        ),
    ] = None,
    courses: Annotated[
        int, typer.Option(min=0, help="Random courses, by seeds from 0.")
    ] = 8,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of what is spoilt.")] = 5,
    set_: SetOption = None,
    failures: Annotated[
        bool, typer.Option("--failures", help="List what was wrong.")
    ] = False,
    json_: FiguresOption = None,
) -> None:
    """Find known tracks in clean and in spoilt maps, and print each figure."""
    from conegraph.bench.track import STEPS, bench_track
    from conegraph.bench.track_truth import closed_tracks, random_tracks
    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import show_figures
    from conegraph.config import load_config

    tracks = [] if data is None else closed_tracks(data)
    tracks += random_tracks(range(courses))
    if not tracks:
        raise typer.BadParameter("--courses 0 needs --data with closed tracks")
    config = load_config(None, set_ or []).track
    with progress_bar("bench track", STEPS) as advance:
        shares = bench_track(tracks, range(seeds), config, advance)
    figures = [share.figure() for share in shares]
    title = f"Track detection, {len(tracks)} tracks, {seeds} seeds, {config.profile}"
    show_figures(figures, title, json_)
    if failures:
        for share in shares:
            for text in share.failures:
                typer.echo(f"{share.name}: {text}")
