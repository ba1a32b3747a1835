"""``conegraph run``: one back end over one source."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import (
    ConfigOption,
    DetectorOption,
    JsonOption,
    OutOption,
    SaveRrdOption,
    SetOption,
    SourceArgument,
    ViewOption,
    say_what_is_replaced,
    settle_source,
    with_detector,
)
from conegraph.errors import ConegraphError

if TYPE_CHECKING:
    from conegraph.types import ConeMap


class Mode(StrEnum):
    """What to do with a map that is given."""

    LOCALIZE = "localize"
    UPDATE = "update"


def run(
    out: OutOption,
    source: SourceArgument = "",
    backend: Annotated[
        str | None,
        typer.Option(metavar="ekf|isam2[/PROFILE]", help="Which back end."),
    ] = None,
    detector: DetectorOption = None,
    config: ConfigOption = None,
    set_: SetOption = None,
    map_: Annotated[
        Path | None,
        typer.Option("--map", metavar="MAP.csv", help="Cones that are known already."),
    ] = None,
    mode: Annotated[
        Mode | None,
        typer.Option(
            help="With --map: leave the map as it is (the default), or go on mapping."
        ),
    ] = None,
    view: ViewOption = False,
    save_rrd: SaveRrdOption = False,
    json_: JsonOption = False,
) -> None:
    """Run one back end over one source."""
    from conegraph.cli.session import Job, print_comparison, run_jobs
    from conegraph.config import load_config
    from conegraph.eval import compare
    from conegraph.io.run_writer import SUMMARY

    if mode is not None and map_ is None:
        raise typer.BadParameter("--mode says what to do with a map: give --map too")
    settled = settle_source(
        source, load_config(config, with_detector(set_, detector), backend=backend)
    )
    _keep_apart(settled.source, out)
    say_what_is_replaced([out / SUMMARY])
    job = Job(
        settled,
        out,
        known_map=None if map_ is None else _read_known_map(map_),
        add_cones=map_ is None or mode is Mode.UPDATE,
    )
    name = settled.backend.kind
    result = run_jobs(
        {name: job}, out, view=view, save_rrd=save_rrd, detector=detector
    )[name]
    if json_:
        typer.echo((out / SUMMARY).read_text(encoding="utf-8"), nl=False)
    elif result.metrics is not None:
        print_comparison(compare({name: result.metrics}))


def _read_known_map(path: Path) -> ConeMap:
    """Return the map in a file.

    Raises:
        FileFormatError: it cannot be read, or there is no cone on it.
    """
    from conegraph.errors import FileFormatError
    from conegraph.io.tracks.cone_map_csv import read_cone_map

    known = read_cone_map(path)
    if len(known) == 0:
        raise FileFormatError(path, "has no cone, so no car can be found on it")
    return known


def _keep_apart(source: str, out: Path) -> None:
    """Refuse to write a run over the cone log that it reads: both have a map.csv.

    Raises:
        ConegraphError: they are one folder.
    """
    log = Path(source)
    if log.is_dir() and out.is_dir() and log.samefile(out):
        raise ConegraphError(f"--out {out}: is the source itself; name another folder")
