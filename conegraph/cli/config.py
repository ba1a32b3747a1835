"""``conegraph config``: what can be configured, and whether a file is right."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from conegraph.cli.options import SetOption

app = typer.Typer(
    help="Show what can be configured, or check a file.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command()
def schema() -> None:
    """Print the JSON schema of the configuration, for editors."""
    from conegraph.config import Config

    typer.echo(json.dumps(Config.model_json_schema(), indent=2))


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="TOML file to check.")],
    set_: SetOption = None,
    resolved: Annotated[
        bool, typer.Option("--resolved", help="Print every key with its value.")
    ] = False,
) -> None:
    """Check a configuration file: keys, values, ranges."""
    from conegraph.config import config_to_toml, load_config

    config = load_config(file, set_ or [])
    if resolved:
        typer.echo(config_to_toml(config), nl=False)
    else:
        backend = config.backend
        typer.echo(f"{file}: ok ({backend.kind}, profile {backend.profile})")
