"""``conegraph bench detector``: the learned detector beside what is asked of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import FiguresOption, SetOption

if TYPE_CHECKING:
    from conegraph.bench.figure import Figure

FIRST_SEED = 9900
"""Seeds from here on were never trained on."""


def detector(
    seeds: Annotated[int, typer.Option(min=1, help="Courses to render.")] = 8,
    first_seed: Annotated[int, typer.Option(min=0, help="Seed of the first.")] = (
        FIRST_SEED
    ),
    frames: Annotated[int, typer.Option(min=4, help="Pictures of each course.")] = 20,
    photos: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Photographs with YOLO labels (blue, yellow, orange)."
        ),
    ] = None,
    maps: Annotated[
        bool, typer.Option(help="Also two laps of a course from pictures to maps.")
    ] = True,
    backends: Annotated[
        str, typer.Option(metavar="A,B,…", help="Back ends of the maps.")
    ] = "ekf",
    set_: SetOption = None,
    json_: FiguresOption = None,
) -> None:
    """Measure the learned detector on unseen renders and real photographs."""
    from conegraph.bench.detector import (
        Shots,
        dusk_figures,
        precision_figures,
        speed_figure,
    )
    from conegraph.bench.detector_photos import photo_figures
    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import show_figures
    from conegraph.config import YoloConfig, load_config
    from conegraph.frontend.yolo import YoloDetector

    settings = ["detector.kind=yolo", *(set_ or [])]
    config = load_config(None, settings)
    learned = config.detector
    if not isinstance(learned, YoloConfig):
        raise typer.BadParameter("--set detector.kind: only yolo is measured here")
    figures = [] if photos is None else photo_figures(photos, YoloDetector(learned))
    plan = Shots(tuple(range(first_seed, first_seed + seeds)), frames)
    with progress_bar("rendering"):
        shots = plan.all_lights()
    with progress_bar("unseen renders", len(plan)) as advance:
        figures += precision_figures(shots, config, learned, advance)
    figures.append(speed_figure(shots, config, learned))
    with progress_bar("dusk", len(plan)) as advance:
        figures += dusk_figures(plan.dusk(), config, advance)
    if maps:
        figures += _map_figures(first_seed, backends, settings, set_ or [])
    show_figures(figures, "Learned detector", json_)


def _map_figures(
    seed: int, backends: str, learned: list[str], plain: list[str]
) -> list[Figure]:
    """Return the maps of one course by the learned and by the colour detector."""
    from dataclasses import replace

    from conegraph.bench.frontend_maps import map_figures
    from conegraph.cli.progress import progress_bar

    names = [name.strip() for name in backends.split(",")]
    figures = []
    rest = [word for word in plain if not word.startswith("detector.")]
    colour = [*rest, "detector.kind=hsv"]
    for kind, settings in (("yolo", learned), ("hsv", colour)):
        with progress_bar(f"camera to map, {kind}") as advance:
            for figure in map_figures(seed, names, settings, advance):
                figures.append(replace(figure, name=f"{kind}: {figure.name}"))
    return figures
