"""``conegraph bench relocalisation``: finding the car on a map, and losing it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

DEFAULT_TRACKS = ",".join(f"random:{seed}" for seed in range(8))
QUICK_TRACKS = "random:0,random:1,random:2"


def relocalisation(
    tracks: Annotated[
        str,
        typer.Option(
            metavar="A,B,…",
            help="Track files, folders of them (their closed tracks), built-in names, "
            "random:SEED.",
        ),
    ] = DEFAULT_TRACKS,
    count: Annotated[int, typer.Option(min=1, help="Windows a track and sensor.")] = 40,
    quick: Annotated[
        bool, typer.Option("--quick", help="Three tracks, ten windows each.")
    ] = False,
    json_: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the figures as JSON."),
    ] = None,
) -> None:
    """Look for cars on maps with errors, carry them away, and print each figure."""
    from rich.console import Console

    from conegraph.bench.figure import render_figures
    from conegraph.bench.relocalisation import Plan, measure
    from conegraph.bench.relocalisation_trials import circuits
    from conegraph.bench.streams import track_names
    from conegraph.cli.progress import progress_bar
    from conegraph.io.plain import to_plain

    usual = quick and tracks == DEFAULT_TRACKS
    layouts = circuits(track_names(QUICK_TRACKS if usual else tracks))
    plan = Plan(layouts, min(count, 10) if quick else count)
    with progress_bar("bench relocalisation", plan.steps) as advance:
        figures = measure(plan, advance)
    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    console.print(render_figures(figures, "Relocalisation"))
    if json_ is not None:
        text = json.dumps({"figures": to_plain(figures)}, indent=1)
        json_.write_text(text + "\n", encoding="utf-8")
