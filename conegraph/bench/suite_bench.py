"""Runs a suite: rows as they come into a journal, and all of them into one table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conegraph.bench.journal import Journal
from conegraph.bench.runner import run_chains
from conegraph.bench.suite import Suite, SuiteJob
from conegraph.bench.suite_run import Outcome, failed_row, run_job
from conegraph.bench.workers import WorkerError, Workers
from conegraph.errors import ConegraphError
from conegraph.eval.suite_rows import RESULTS, SuiteRow, write_results

JOURNAL = "rows.jsonl"


def kept_runs(suite: Suite, out: Path) -> Journal[SuiteRow]:
    """Return the runs that a folder has of a suite.

    Raises:
        ConegraphError: a back end, setting or fault does not exist; or the folder has
            runs that the suite does not ask for, which its report would leave out.
    """
    asked = {job.key for chain in suite.chains() for job in chain}
    journal = Journal[SuiteRow](out / JOURNAL, (SuiteRow,))
    others = [row for key, row in journal.rows.items() if key not in asked]
    if others:
        settings = f" with {others[0].settings}" if others[0].settings else ""
        raise ConegraphError(
            f"{out} has {len(others)} runs that these options do not ask for, as "
            f"{others[0].contender}{settings} over {others[0].stream}: the report "
            "would leave them out. Give another --out, or remove the folder; "
            "`conegraph bench diff` compares two folders"
        )
    return journal


def run_suite(
    suite: Suite, out: Path, workers: Workers, done: Callable[[int], None]
) -> tuple[SuiteRow, ...]:
    """Run what the folder has no row of yet; write its results.

    The rows go to ``rows.jsonl`` as they come, and in the end to ``results.parquet``;
    what happened along the way to ``series/``.

    Args:
        suite: what to run.
        out: the folder, made if missing.
        workers: who runs it.
        done: is told how many runs are done.

    Returns:
        The rows of the suite, in its order.

    Raises:
        ConegraphError: see `kept_runs`.
    """
    chains, journal = suite.chains(), kept_runs(suite, out)
    out.mkdir(parents=True, exist_ok=True)

    def do(job: SuiteJob) -> SuiteRow:
        try:
            outcome = workers.call(run_job, job)
        except WorkerError as error:
            outcome = Outcome(failed_row(job, str(error)))
        if outcome.series:
            keep_bytes(out / outcome.row.series, outcome.series)
        return outcome.row

    run_chains(chains, journal, do, workers.at_once, done)
    rows = tuple(journal.rows[job.key] for chain in chains for job in chain)
    write_results(out / RESULTS, rows)
    return rows


def keep_bytes(path: Path, content: bytes) -> None:
    """Write a file that appears under its name only when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    part.write_bytes(content)
    part.replace(path)
