"""``conegraph view``: open a run's recording in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conegraph.errors import SourceError


def view(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run's folder, or an .rrd file.")
    ],
) -> None:
    """Open the recording of a run in the Rerun viewer."""
    import subprocess
    import sys

    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise SourceError(
            f"{recording}: no such recording; run again with --save-rrd to get one"
        )
    # The viewer is a program of its own; by itself it would listen to everybody.
    viewer = subprocess.run(
        [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", str(recording)]
    )
    raise typer.Exit(viewer.returncode)
