"""``conegraph tune``: noise parameters that fit a log."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import (
    ConfigOption,
    JsonOption,
    SetOption,
    SourceArgument,
    settle_source,
)

if TYPE_CHECKING:
    from conegraph.backends.tuning import Tuning


class SensorNoise(StrEnum):
    """What of the cone sensor is estimated."""

    MODEL = "model"
    SCALE = "scale"


def tune(
    out: Annotated[
        Path,
        typer.Option("--out", metavar="CONFIG.toml", help="Where to write the result."),
    ],
    source: SourceArgument = "",
    config: ConfigOption = None,
    set_: SetOption = None,
    frames: Annotated[
        int, typer.Option(min=20, help="Frames to tune on; as many again to check.")
    ] = 600,
    sensor: Annotated[
        SensorNoise,
        typer.Option(
            help="Estimate range and bearing sigmas, or one factor on what is reported."
        ),
    ] = SensorNoise.MODEL,
    json_: JsonOption = False,
) -> None:
    """Estimate the noise from a log; write a config."""
    import json

    from conegraph.backends.tuning import tune as estimate
    from conegraph.camera_stream import with_front_end
    from conegraph.cli.progress import progress_bar
    from conegraph.config import given_to_toml, load_config
    from conegraph.io.plain import to_plain
    from conegraph.io.run_writer import replace_text
    from conegraph.pipeline import for_source
    from conegraph.sources import open_stream

    settled = settle_source(source, load_config(config, set_ or []))
    with progress_bar(f"reading {settled.source}"):
        stream = open_stream(settled.source, seed=settled.seed)
        log = with_front_end(stream, settled)
        events = list(log.events())
    with progress_bar("tuning") as advance:
        tuning = estimate(
            events,
            for_source(settled, log),
            log.sensor,
            frames=frames,
            kind=sensor.value,
            progress=advance,
        )
    replace_text(out, given_to_toml(tuning.config))
    if json_:
        found = to_plain(tuning.figures())
        typer.echo(json.dumps(found, indent=2))
    else:
        _print(tuning)
        typer.echo(f"Configuration: {out}")


def _print(tuning: Tuning) -> None:
    from rich.table import Table
    from rich.text import Text

    from conegraph.cli.tables import console

    changes = Table(title="Noise")
    fits = Table(title="Innovations")
    for table, names in (
        (changes, ("", "before", "after", "factor", "± one sigma")),
        (fits, ("", "before", "after")),
    ):
        for name in names:
            table.add_column(Text(name), justify="right" if name else "left")
    for c in tuning.changes:
        numbers = (f"{c.before:.4g}", f"{c.after:.4g}", f"{c.after / c.before:.2f}")
        changes.add_row(Text(c.name), *numbers, f"{100 * c.error:.0f} %")
    stretches = [("tuned on", tuning.before, tuning.after)]
    if tuning.check_before is not None and tuning.check_after is not None:
        stretches.append(("the rest", tuning.check_before, tuning.check_after))
    for where, *both in stretches:
        cells = [f"{fit.nis_per_dof:.2f}" for fit in both]
        fits.add_row(f"NIS / dof, {where}: 1 is right", *cells)
        cells = [f"{fit.correlation:.3f}" for fit in both]
        fits.add_row(f"correlation, {where}: 0 is white", *cells)
        cells = [f"{fit.overconfident_frames} of {fit.frames}" for fit in both]
        fits.add_row(f"overconfident frames, {where}", *cells)
    out = console()
    out.print(changes)
    out.print(fits)
    if not tuning.converged:
        out.print(Text("Note: not settled; tune again, starting from the result (-c)"))
    if not tuning.holds:
        text = (
            "Note: on the rest of the log the result is more often overconfident than "
            "what you had: the noise is not the same everywhere. Tune on more "
            "--frames, or keep what you had."
        )
        out.print(Text(text))
