"""Options that several verbs share, each described once."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from conegraph.config import Config

SourceArgument = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="What to read: a folder with a cone log or an RGB-D sequence, a RealSense "
        "recording (.db3, .bag), realsense[:SERIAL], mrclam:FOLDER/RobotN, "
        "victoria-park[:FILE], or sim:TRACK[?laps=N&seed=N&sensor=camera|lidar|rgbd"
        "&odometry=on|off]. May be left out when the config names it.",
        show_default=False,
    ),
]
OutOption = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder to write into.", file_okay=False),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option("-c", "--config", metavar="FILE", help="Configuration in TOML."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override one key, as in association.gate_d2=9. Repeatable.",
    ),
]
DetectorOption = Annotated[
    str | None,
    typer.Option(
        metavar="hsv|yolo[/PROFILE]",
        help="Which detector finds cones in pictures, by colour or learned.",
    ),
]
ViewOption = Annotated[
    bool, typer.Option("--view", help="Show the run live in the Rerun viewer.")
]
SaveRrdOption = Annotated[
    bool, typer.Option("--save-rrd", help="Write the Rerun recording DIR/run.rrd.")
]
FiguresOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the figures as JSON."),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print JSON in place of the table.")
]


def listed(option: str, given: str, allowed: Sequence[str]) -> tuple[str, ...]:
    """Return the words of a list A,B,…, each once.

    Raises:
        typer.BadParameter: one of them is not allowed.
    """
    words = tuple(dict.fromkeys(word.strip() for word in given.split(",")))
    for word in words:
        if word not in allowed:
            raise typer.BadParameter(unknown(option, word, allowed))
    return words


def say_what_is_replaced(results: Iterable[Path]) -> None:
    """Say which folders hold finished results that a run will replace.

    Args:
        results: files that only what has finished holds.
    """
    for file in results:
        if file.is_file():
            said = f"conegraph: {file.parent}: replacing the results of an earlier run"
            print(said, file=sys.stderr)


def unknown(option: str, given: str, allowed: Iterable[str]) -> str:
    """Return what is wrong with a word that is none of those allowed."""
    near = get_close_matches(given, list(allowed), 1)
    meant = f"; did you mean {near[0]}?" if near else ""
    return f"{option} {given!r}: choose of {', '.join(allowed)}{meant}"


def with_detector(settings: Sequence[str] | None, detector: str | None) -> list[str]:
    """Return the ``KEY=VALUE`` settings with the detector that was chosen, if any."""
    chosen = list(settings or [])
    if detector is not None:
        kind, _, profile = detector.partition("/")
        chosen += [f"detector.kind={kind}", f"detector.profile={profile or 'default'}"]
    return chosen


def settle_source(source: str, config: Config) -> Config:
    """Return the config with the SOURCE that counts: the argument, else its own.

    Raises:
        typer.BadParameter: neither names a source.
    """
    if not (source or config.source):
        raise typer.BadParameter("give a SOURCE, or a config that names one")
    return config.model_copy(update={"source": source}) if source else config
