"""``conegraph bench relocalisation``: finding the car on a map, and losing it."""

from __future__ import annotations

from typing import Annotated

import typer

from conegraph.cli.options import FiguresOption

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
    json_: FiguresOption = None,
) -> None:
    """Look for cars on maps with errors, carry them away, and print each figure."""
    from conegraph.bench.relocalisation import Plan, measure
    from conegraph.bench.relocalisation_trials import circuits
    from conegraph.bench.streams import track_names
    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import show_figures

    usual = quick and tracks == DEFAULT_TRACKS
    layouts = circuits(track_names(QUICK_TRACKS if usual else tracks))
    plan = Plan(layouts, min(count, 10) if quick else count)
    with progress_bar("bench relocalisation", plan.steps) as advance:
        figures = measure(plan, advance)
    show_figures(figures, "Relocalisation", json_)
