"""The back ends' benchmark: a plan, its rows, and the verdict on each figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from conegraph.bench.accuracy_figures import accuracy_figures
from conegraph.bench.figure import Figure
from conegraph.bench.journal import Journal
from conegraph.bench.latency_figures import latency_figures
from conegraph.bench.plan import Plan
from conegraph.bench.pose_figures import pose_figures
from conegraph.bench.rows import AnyRow, CostRow, Job, ReferenceRow, RunRow
from conegraph.bench.runner import grouped, run_chains
from conegraph.bench.worker import Task, failed, reference_of, work
from conegraph.bench.workers import Processes, WorkerError, Workers

ROWS = "rows.jsonl"


@dataclass(frozen=True, slots=True)
class Rows:
    """All that a benchmark measured, by kind."""

    runs: tuple[RunRow, ...]
    references: tuple[ReferenceRow, ...]
    costs: tuple[CostRow, ...]


PRODUCERS: tuple[Callable[[Rows], list[Figure]], ...] = (
    lambda rows: accuracy_figures(rows.runs, rows.references),
    lambda rows: pose_figures(rows.runs, rows.references),
    lambda rows: latency_figures(rows.runs, rows.costs),
)
"""What makes figures of rows: another group of figures is one more entry."""


def measure_all(
    plan: Plan, out: Path, at_once: int, done: Callable[[int], None]
) -> Rows:
    """Run whatever of the plan has no row in ``out`` yet; return the plan's rows.

    Args:
        plan: what to measure.
        out: folder of the rows, made if missing.
        at_once: processes, except where times count.
        done: is told how many jobs are done.
    """
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal[AnyRow](out / ROWS, (ReferenceRow, CostRow, RunRow))
    together, alone = plan.side_by_side(), plan.one_by_one()
    with Processes(at_once) as workers:
        _do(together, journal, workers, done)
    with Processes(1, fresh=True) as workers:
        _do(alone, journal, workers, lambda n: done(len(together) + n))
    wanted = [journal.rows[job.key] for job in (*together, *alone)]
    return Rows(
        tuple(row for row in wanted if isinstance(row, RunRow)),
        tuple(row for row in wanted if isinstance(row, ReferenceRow)),
        tuple(row for row in wanted if isinstance(row, CostRow)),
    )


def _do(
    jobs: Sequence[Job],
    journal: Journal[AnyRow],
    workers: Workers,
    done: Callable[[int], None],
) -> None:
    """Do the jobs of one stream one after another, its batch optimum first."""

    def do(job: Job) -> AnyRow:
        reference = journal.rows.get(reference_of(job).key)
        known = reference if isinstance(reference, ReferenceRow) else None
        try:
            return workers.call(work, Task(job=job, reference=known))
        except WorkerError as error:
            return failed(job, str(error))

    chains = grouped(jobs, lambda job: reference_of(job).key)
    run_chains(chains, journal, do, workers.at_once, done)


def figures_of(rows: Rows) -> list[Figure]:
    """Return every figure, in the order of the producers."""
    return [figure for produce in PRODUCERS for figure in produce(rows)]


def failures_of(rows: Rows) -> list[str]:
    """Return a sentence for every run that ended in an error."""
    named = [
        *((row.key, row.reason) for row in rows.references),
        *((row.job.key, row.reason) for row in rows.runs),
        *((row.job.key, row.reason) for row in rows.costs),
    ]
    return [f"{key}: {reason}" for key, reason in named if reason]
