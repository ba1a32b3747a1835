"""``conegraph doctor``: why a run went wrong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import JsonOption

if TYPE_CHECKING:
    from conegraph.eval.doctor import Diagnosis, Finding
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
    """Print the likely causes, what may follow from them, and what to do."""
    from rich.text import Text

    from conegraph.cli.tables import console

    out = console()
    causes = [found for found in diagnosis.findings if not found.follows]
    consequences = [found for found in diagnosis.findings if found.follows]
    for number, found in enumerate(causes, 1):
        when = f", look at {found.at_s:.1f} s" if found.at_s == found.at_s else ""
        out.print(Text(f"{number}. {found.title} ({found.cause}{when})"))
        out.print(Text(f"   evidence: {found.evidence}"))
        out.print(Text(f"   {_figure(found)}"))
        out.print(Text(f"   to do: {found.advice}"))
    if consequences:
        out.print(Text("Found besides, and may follow from that:"))
    for found in consequences:
        out.print(Text(f"- {found.title} ({found.cause}): {_figure(found)}"))
    if diagnosis.unclear:
        start = "cannot tell" if not causes else "Besides"
        out.print(Text(f"{start}: {diagnosis.unclear}"))
    elif not causes and diagnosis.harm:
        out.print(Text(f"unexplained: {diagnosis.harm}; nothing looked for is wrong"))
    elif not causes:
        out.print(Text("healthy: nothing that is looked for is wrong"))
    for note in diagnosis.notes:
        out.print(Text(f"Note: {note}"))


def _figure(found: Finding) -> str:
    """Return the figure behind a finding beside that of a healthy run."""
    scale = 100.0 if found.unit == "%" else 1.0
    unit = f" {found.unit}" if found.unit else ""
    return (
        f"{found.name}: {scale * found.measured:.3g}{unit}, in a healthy run at most "
        f"{scale * found.limit:.3g}{unit}"
    )
