"""``conegraph compare``: the same stream through several back ends."""

from __future__ import annotations

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

if TYPE_CHECKING:
    from conegraph.pipeline import RunResult

DEFAULT_BACKENDS = "ekf,isam2"


def compare(
    out: OutOption,
    source: SourceArgument = "",
    backends: Annotated[
        str,
        typer.Option(
            metavar="A,B,…",
            help="Back ends, each with its profile if wanted: ekf/thesis.",
        ),
    ] = DEFAULT_BACKENDS,
    detector: DetectorOption = None,
    config: ConfigOption = None,
    set_: SetOption = None,
    view: ViewOption = False,
    save_rrd: SaveRrdOption = False,
    json_: JsonOption = False,
) -> None:
    """Run several back ends over one stream and judge them."""
    from conegraph.cli.session import Job, run_jobs
    from conegraph.config import load_config
    from conegraph.io.run_writer import SUMMARY

    settings = with_detector(set_, detector)
    configs = {
        name: settle_source(source, load_config(config, settings, backend=backend))
        for name, backend in _named(backends).items()
    }
    say_what_is_replaced(out / name / SUMMARY for name in configs)
    jobs = {name: Job(config, out / name) for name, config in configs.items()}
    results = run_jobs(jobs, out, view=view, save_rrd=save_rrd, detector=detector)
    _report(results, out, json_=json_)
    if save_rrd and not json_:
        typer.echo(f"Recording: conegraph view {out}")


def _report(results: dict[str, RunResult], out: Path, *, json_: bool) -> None:
    """Write the report into a folder, and print it as a table or as JSON."""
    from conegraph.cli.session import print_comparison
    from conegraph.eval import write_report
    from conegraph.eval.report import REPORT_JSON

    judged = {
        name: (result.folder, result.metrics)
        for name, result in results.items()
        if result.folder is not None and result.metrics is not None
    }
    first = next(iter(results.values()))
    comparison = write_report(
        out,
        {name: folder for name, (folder, _) in judged.items()},
        {name: metrics for name, (_, metrics) in judged.items()},
        first.truth,
        title=f"{first.summary['source']}: {', '.join(results)}",
    )
    if json_:
        typer.echo((out / REPORT_JSON).read_text(encoding="utf-8"), nl=False)
        return
    print_comparison(comparison)
    typer.echo(f"Report: {out / 'report.html'}")


def _named(backends: str) -> dict[str, str]:
    """Return the back ends by the names of their folders: ``ekf/thesis`` by ekf-thesis.

    Raises:
        typer.BadParameter: none is given, or one twice.
    """
    given = [part.strip() for part in backends.split(",") if part.strip()]
    named = {backend.replace("/", "-"): backend for backend in given}
    if not given or len(named) < len(given):
        raise typer.BadParameter(f"--backends {backends!r}: name each of them once")
    return named
