"""``conegraph bench --suite``: back ends over many drives, and what they show."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import JsonOption, SetOption, listed, unknown

if TYPE_CHECKING:
    from conegraph.bench.suite import Suite
    from conegraph.bench.workers import Workers
    from conegraph.eval.paired import Duel
    from conegraph.eval.suite_comparison import Contender, SuiteComparison


def suite(
    context: typer.Context,
    suite: Annotated[
        str, typer.Option(metavar="quick|full", help="What to run.")
    ] = "quick",
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            file_okay=False,
            help="Folder of the results, out/bench-SUITE by default. Runs that it has "
            "already are not run again: take a new one for another version or "
            "configuration.",
        ),
    ] = None,
    tracks: Annotated[
        str,
        typer.Option(
            metavar="A,B,…",
            help="Track files, folders of them (their closed tracks), built-in names, "
            "random:SEED, in place of the suite's; likewise all that follow.",
        ),
    ] = "",
    sensors: Annotated[str, typer.Option(metavar="A,B", help="camera, lidar.")] = "",
    odometry: Annotated[str, typer.Option(metavar="A,B", help="on, off.")] = "",
    faults: Annotated[
        str,
        typer.Option(
            metavar="A,B,…",
            help="What goes wrong: none, or as in missed=0.1&wrong_colour=0.02.",
        ),
    ] = "",
    backends: Annotated[
        str, typer.Option(metavar="A,B,…", help="Back ends, as ekf or ekf/thesis.")
    ] = "",
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Drives in each way.")
    ] = None,
    laps: Annotated[int | None, typer.Option(min=1, help="Laps a drive.")] = None,
    set_: SetOption = None,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 takes all cores.")] = 0,
    scheduler: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Run on a Dask cluster: tcp://HOST:8786."),
    ] = "",
    json_: JsonOption = False,
) -> None:
    """Measure, and print each figure beside what it should be.

    Without a command, run a suite: every combination of tracks, sensors, faults, back
    ends and seeds, over the same streams, and compare the back ends.
    """
    if context.invoked_subcommand is not None:
        return
    from conegraph.bench.streams import track_names
    from conegraph.bench.suite import SUITES

    if suite not in SUITES:
        raise typer.BadParameter(unknown("--suite", suite, SUITES))
    chosen = SUITES[suite]
    if tracks:
        chosen = replace(chosen, tracks=track_names(tracks))
    if sensors:
        chosen = replace(
            chosen, sensors=listed("--sensors", sensors, ("camera", "lidar"))
        )
    if odometry:
        words = listed("--odometry", odometry, ("on", "off"))
        chosen = replace(chosen, odometry=tuple(word == "on" for word in words))
    if faults:
        chosen = replace(chosen, faults=_parts("--faults", faults))
    if backends:
        names = backends.replace("/default", "")
        chosen = replace(chosen, backends=_parts("--backends", names))
    chosen = replace(
        chosen,
        seeds=seeds or chosen.seeds,
        laps=laps or chosen.laps,
        settings=tuple(set_ or ()),
    )
    _bench(chosen, out or Path("out") / f"bench-{suite}", jobs, scheduler, json_)


def diff(
    old: Annotated[Path, typer.Argument(metavar="A", help="Folder or Parquet file.")],
    new: Annotated[Path, typer.Argument(metavar="B", help="What to compare with it.")],
    json_: JsonOption = False,
) -> None:
    """Compare two results of a suite, run by run.

    They may be of two versions of the code, or of two configurations.
    """
    from conegraph.eval.suite_comparison import compare_versions
    from conegraph.eval.suite_rows import read_results
    from conegraph.io.plain import to_plain

    found = compare_versions(read_results(old), read_results(new))
    if json_:
        typer.echo(json.dumps(to_plain(found), indent=1))
        return
    for duel in found.duels:
        _show_duel(duel)
    pairs = sum(duel.streams for duel in found.duels)
    typer.echo(
        f"{found.same} of {pairs} pairs agree in all that is not time or memory."
    )
    for name, only in (("A", found.only_old), ("B", found.only_new)):
        if only:
            typer.echo(f"Only in {name}: {len(only)}, as {only[0]}")
    for note in found.notes:
        typer.echo(f"Note: {note}")


def _bench(suite: Suite, out: Path, jobs: int, scheduler: str, json_: bool) -> None:
    from conegraph.bench.suite_bench import kept_runs, run_suite
    from conegraph.cli.progress import progress_bar
    from conegraph.eval.suite_comparison import compare_suite
    from conegraph.eval.suite_report import write_suite_report
    from conegraph.io.plain import to_plain

    total = sum(len(chain) for chain in suite.chains())
    found = len(kept_runs(suite, out).rows)
    typer.echo(
        f"bench {suite.name}: {found} of {total} runs found in {out}, "
        f"{total - found} to do",
        err=True,
    )
    with (
        _workers(jobs, scheduler) as workers,
        progress_bar(f"bench {suite.name}", total) as advance,
    ):
        rows = run_suite(suite, out, workers, advance)
    comparison = compare_suite(rows)
    report = write_suite_report(out)
    if json_:
        typer.echo(json.dumps(to_plain(comparison), indent=1))
    else:
        _show(comparison)
    typer.echo(f"Report: {report}", err=json_)


def _workers(jobs: int, scheduler: str) -> Workers:
    from conegraph.bench.workers import DaskCluster, Processes
    from conegraph.sim.render_pool import free_cores

    return DaskCluster(scheduler) if scheduler else Processes(jobs or free_cores())


def _show(comparison: SuiteComparison) -> None:
    """Print the medians with their intervals, then what every two contenders show."""
    from rich.table import Table

    from conegraph.cli.tables import WIDTH_OF_FIGURES, console

    table = Table(title="Median [95 % interval]", title_justify="left")
    table.add_column("")
    for contender in comparison.contenders:
        table.add_column(contender.name, justify="right")
    table.add_row("failed runs", *(_failed(one) for one in comparison.contenders))
    for k, metric in enumerate(comparison.metrics):
        cells = [_median(one, k, metric.digits) for one in comparison.contenders]
        unit = f" \\[{metric.unit}]" if metric.unit else ""
        table.add_row(f"{metric.label}{unit}", *cells)
    console(WIDTH_OF_FIGURES).print(table)
    for duel in comparison.duels:
        _show_duel(duel)
    for note in comparison.notes:
        typer.echo(f"Note: {note}")
    if comparison.verdict:
        typer.echo(comparison.verdict)


def _show_duel(duel: Duel) -> None:
    typer.echo(f"{duel.scope}:")
    for sentence in (duel.failures.sentence, *(e.sentence for e in duel.effects)):
        typer.echo(f"  {sentence}")


def _failed(one: Contender) -> str:
    from conegraph.eval.paired import rate_text

    return rate_text(one.failures)


def _median(one: Contender, k: int, digits: int) -> str:
    found = one.medians[k]
    if found is None:
        return "-"
    low, high = found.interval.low, found.interval.high
    return f"{found.value:.{digits}f} \\[{low:.{digits}f}, {high:.{digits}f}]"


def _parts(option: str, given: str) -> tuple[str, ...]:
    """Return the parts of a list A,B,…, each once.

    Raises:
        typer.BadParameter: there are none.
    """
    parts = tuple(dict.fromkeys(filter(None, (p.strip() for p in given.split(",")))))
    if not parts:
        raise typer.BadParameter(f"{option} {given!r}: names nothing")
    return parts
