"""``conegraph doctor``: why a run went wrong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import JsonOption

if TYPE_CHECKING:
    from conegraph.eval.doctor import Diagnosis
    from conegraph.types import Trajectory


def doctor(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="The folder that a run wrote.",
            exists=True,
            file_okay=False,
        ),
    ],
    truth: Annotated[
        bool,
        typer.Option(
            help="Use the truth where the run has kept it: it tells wheels with a "
            "wrong radius from a sensor with wrong ranges."
        ),
    ] = True,
    json_: JsonOption = False,
) -> None:
    """Say what is wrong with a run, the likeliest cause first."""
    import json

    from conegraph.eval.doctor import diagnose
    from conegraph.io.run_folder import read_run

    _check(run)
    diagnosis = diagnose(read_run(run), _truth_in(run) if truth else None)
    if json_:
        plain = {"cause": diagnosis.cause, **diagnosis.to_dict()}
        typer.echo(json.dumps(plain, indent=2))
        return
    _show(diagnosis)


def _check(run: Path) -> None:
    """Refuse a folder without a run, naming the runs in it.

    Raises:
        FileFormatError: there is no run.
    """
    from conegraph.errors import FileFormatError
    from conegraph.io.run_writer import TRAJECTORY

    if (run / TRAJECTORY).exists():
        return
    runs = sorted(str(path.parent) for path in run.glob(f"*/{TRAJECTORY}"))
    if runs:
        raise FileFormatError(
            run, f"holds {len(runs)} runs: choose {' or '.join(runs)}"
        )
    raise FileFormatError(
        run, f"holds no run (no {TRAJECTORY}): give the folder that a run wrote"
    )


def _truth_in(run: Path) -> Trajectory | None:
    """Return the true path in a run's folder, None where there is none.

    Raises:
        FileFormatError: it is no such file.
    """
    from conegraph.io.run_writer import TRUTH
    from conegraph.io.tum_trajectory import read_tum

    path = run / TRUTH
    return read_tum(path) if path.exists() else None


def _show(diagnosis: Diagnosis) -> None:
    """Print the diagnosis, then what else was found."""
    from rich.text import Text

    from conegraph.cli.tables import console

    out = console()
    for number, found in enumerate(diagnosis.findings, 1):
        when = f", look at {found.at_s:.1f} s" if found.at_s == found.at_s else ""
        out.print(Text(f"{number}. {found.title} ({found.cause}{when})"))
        healthy = f"healthy is up to {found.limit:.3g}, this is {found.measured:.3g}"
        out.print(Text(f"   evidence: {found.evidence}; {healthy}"))
        out.print(Text(f"   to do: {found.advice}"))
    if not diagnosis.findings:
        out.print(Text("healthy: nothing that is looked for is wrong"))
    for note in diagnosis.notes:
        out.print(Text(f"Note: {note}"))
