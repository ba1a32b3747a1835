"""``conegraph bench frontend``: pictures to cones, against the renderer's truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import FiguresOption, SetOption, listed

if TYPE_CHECKING:
    from conegraph.bench.figure import Figure
    from conegraph.config import Config

LIGHTS = "bright,overcast,low_sun,dusk"
FIRST_SEED = 9800
"""Seeds from here on were never looked at while the detector was tuned."""


def frontend(
    seeds: Annotated[int, typer.Option(min=1, help="Courses to render.")] = 6,
    first_seed: Annotated[
        int, typer.Option(min=0, help="Seed of the first; tuning used those below 200.")
    ] = FIRST_SEED,
    frames: Annotated[
        int, typer.Option(min=2, help="Pictures of each course in each light.")
    ] = 12,
    lights: Annotated[
        str, typer.Option(metavar="A,B,…", help="In which light.")
    ] = LIGHTS,
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
    ] = "ekf,isam2",
    set_: SetOption = None,
    json_: FiguresOption = None,
) -> None:
    """Render drives, look for their cones and print each figure beside its target."""
    from conegraph.bench.frontend import Scenes, front_end_figures, measure_front_end
    from conegraph.bench.frontend_maps import map_figures
    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import show_figures
    from conegraph.config import load_config
    from conegraph.sim.render import LIGHT_NAMES

    settings = ["detector.kind=hsv", *(set_ or [])]
    config = load_config(None, settings)
    figures = [] if photos is None else _photos(photos, config)
    words = listed("--lights", lights, LIGHT_NAMES)
    chosen = tuple(name for name in LIGHT_NAMES if name in words)
    scenes = Scenes(tuple(range(first_seed, first_seed + seeds)), chosen, frames)
    with progress_bar("rendering and looking", len(scenes)) as advance:
        figures += front_end_figures(measure_front_end(config, scenes, advance))
    if maps:
        names = [name.strip() for name in backends.split(",")]
        with progress_bar("camera to map") as advance:
            figures += map_figures(first_seed, names, settings, advance)
    show_figures(figures, "Front end", json_)


def _photos(folder: Path, config: Config) -> list[Figure]:
    from conegraph.bench.frontend_photos import photo_figures
    from conegraph.config import HsvConfig

    detector = config.detector
    if not isinstance(detector, HsvConfig):
        raise typer.BadParameter("--photos asks for the detector hsv")
    return photo_figures(folder, detector)
