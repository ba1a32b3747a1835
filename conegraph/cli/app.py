"""The ``conegraph`` command: its verbs, and how it ends when something is wrong.

Answering ``--help`` must not wait for numerical libraries: the verbs import what
they work with inside their functions.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from conegraph.cli import bench, config
from conegraph.cli.calibrate import calibrate
from conegraph.cli.compare import compare
from conegraph.cli.demo import demo
from conegraph.cli.detect import detect
from conegraph.cli.doctor import doctor
from conegraph.cli.record import record
from conegraph.cli.run import run
from conegraph.cli.simulate import simulate
from conegraph.cli.track import track
from conegraph.cli.train_detector import train_detector
from conegraph.cli.tune import tune
from conegraph.cli.view import view
from conegraph.errors import ConegraphError

app = typer.Typer(
    help="Cone SLAM for Formula Student Driverless: one front end, two back ends, "
    "one judge.",
    rich_markup_mode=None,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo)
app.command("run")(run)
app.command("compare")(compare)
app.command("detect")(detect)
app.command("calibrate")(calibrate)
app.command("record")(record)
app.command("simulate")(simulate)
app.command("track")(track)
app.command("train-detector")(train_detector)
app.command("tune")(tune)
app.command("doctor")(doctor)
app.command("view")(view)
app.add_typer(bench.app, name="bench")
app.add_typer(config.app, name="config")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, by default on the program's own arguments.

    Raises:
        SystemExit: always; 0 done, 1 a known error in one line on stderr, 2 usage.
    """
    # Matrices here are small: more threads made the filter ten times slower, and
    # results would depend in their last bits on the number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app(args=None if arguments is None else list(arguments), prog_name="conegraph")
    except ConegraphError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))


def _fail(reason: str) -> None:
    sys.stderr.write(f"conegraph: {' '.join(reason.split())}\n")
    raise SystemExit(1)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(version("conegraph"))
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            help="Print the version and exit.",
            callback=_print_version,
            is_eager=True,
        ),
    ] = False,
) -> None:
    pass
