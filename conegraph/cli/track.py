"""``conegraph track``: boundaries, road and centre line of a cone map."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import ConfigOption, JsonOption, OutOption, SetOption

if TYPE_CHECKING:
    from conegraph.types import Array, ConeMap

_POSE = 3


class Picture(StrEnum):
    """Formats of the plot."""

    PNG = "png"
    SVG = "svg"
    NONE = "none"


def track(
    map_: Annotated[
        Path,
        typer.Argument(
            metavar="MAP.csv",
            help="A map (x,y,class), such as a run's map.csv, a track file, or the "
            "event skidpad or acceleration, whose map and path the rules give.",
        ),
    ],
    out: OutOption,
    pose: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,YAW",
            help="The car, in m and rad: where the lane begins and which way it runs.",
        ),
    ] = None,
    config: ConfigOption = None,
    set_: SetOption = None,
    plot: Annotated[Picture, typer.Option(help="Format of the picture.")] = Picture.PNG,
    json_: JsonOption = False,
) -> None:
    """Find the track in a cone map; write and draw it."""
    from conegraph.config import load_config
    from conegraph.track import detect_track
    from conegraph.track.files import SUMMARY, write_track
    from conegraph.track.plot import plot_track

    settings = load_config(config, set_ or [])
    if str(map_) in ("skidpad", "acceleration") and not map_.exists():
        _write_event(str(map_), _pose(pose), out, json_=json_)
        return
    cone_map = _read(map_)
    found = detect_track(
        cone_map, _pose(pose), config=settings.track, roles=settings.roles
    )
    write_track(out, found)
    if plot is not Picture.NONE:
        plot_track(out / f"track.{plot.value}", found, cone_map)
    if json_:
        typer.echo((out / SUMMARY).read_text(encoding="utf-8"), nl=False)
        return
    if found.length_m == 0.0:
        typer.echo(f"{out}: no track is known: {found.reason}")
        return
    shape = "closed" if found.closed else "open"
    doubt = f" ({found.reason})" if found.reason else ""
    typer.echo(
        f"{out}: {shape} track of {found.length_m:.1f} m, {len(found.left)} left and "
        f"{len(found.right)} right cones, {len(found.unused)} on no boundary, "
        f"confidence {found.confidence:.2f}{doubt}"
    )


def _write_event(name: str, pose: Array | None, out: Path, *, json_: bool) -> None:
    from conegraph.io.run_writer import MAP
    from conegraph.track.events import Event, plan_event
    from conegraph.track.files import EVENT, write_event

    plan = plan_event(Event(name), pose)
    write_event(out, plan)
    if json_:
        typer.echo((out / EVENT).read_text(encoding="utf-8"), nl=False)
        return
    typer.echo(
        f"{out}: {name}, {len(plan.cone_map)} cones, {plan.s_m[-1]:.1f} m to drive; "
        f"localise with: conegraph run SOURCE --map {out / MAP} --mode localize"
    )


def _read(path: Path) -> ConeMap:
    """Return the map in a file of ours, or the cones of a track file."""
    import numpy as np

    from conegraph.io.cone_names import hard_class_prob
    from conegraph.io.tracks import read_track
    from conegraph.io.tracks.cone_map_csv import DEFAULT_SIGMA_M, read_cone_map
    from conegraph.types import ConeMap

    if path.name.endswith((".csv", ".csv.gz")) and _has_our_columns(path):
        return read_cone_map(path)
    layout = read_track(path)
    n = len(layout)
    cov = np.broadcast_to(DEFAULT_SIGMA_M**2 * np.eye(2), (n, 2, 2))
    prob = hard_class_prob(layout.cone_class)
    return ConeMap(np.arange(n), layout.xy_m, cov, prob, np.ones(n, dtype=np.int64))


def _has_our_columns(path: Path) -> bool:
    from conegraph.io.csv_table import header_columns, read_text, text_lines
    from conegraph.io.tracks.cone_map_csv import COLUMNS

    lines = [line for line in text_lines(read_text(path)) if line.strip()]
    return bool(lines) and set(header_columns(lines[0])).issuperset(COLUMNS)


def _pose(text: str | None) -> Array | None:
    """Return the pose that a text stands for.

    Raises:
        typer.BadParameter: it is not three finite numbers.
    """
    import numpy as np

    if text is None:
        return None
    try:
        pose = np.array([float(part) for part in text.split(",")])
    except ValueError:
        pose = np.zeros(0)
    if len(pose) != _POSE or not np.isfinite(pose).all():
        raise typer.BadParameter(f"--pose {text!r}: expected X,Y,YAW, as in 0,0,1.57")
    return pose
