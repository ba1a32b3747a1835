"""Runs a suite: rows as they come into a journal, and all of them into one table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conegraph.bench.journal import Journal
from conegraph.bench.runner import run_chains
from conegraph.bench.suite import Suite, SuiteJob
from conegraph.bench.suite_run import Outcome, failed_row, run_job
from conegraph.bench.workers import WorkerError, Workers
from conegraph.eval.suite_rows import RESULTS, SuiteRow, write_results

JOURNAL = "rows.jsonl"


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
        ConegraphError: a back end, setting or fault does not exist.
    """
    chains = suite.chains()
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal[SuiteRow](out / JOURNAL, (SuiteRow,))

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
