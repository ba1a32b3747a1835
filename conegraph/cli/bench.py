"""``conegraph bench``: what the figures in the README come from."""

from __future__ import annotations

import typer

app = typer.Typer(
    help="Measure: each verb prints its figures beside what they should be.",
    no_args_is_help=True,
)
