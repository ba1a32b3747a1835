"""One measurement in a process of its own: a job on stdin, its row on stdout.

A process for each keeps memory figures apart, and a solver that takes its process
down takes one row with it and not the benchmark.
"""

from __future__ import annotations

import sys

from pydantic import BaseModel

from conegraph.bench.cost import frame_cost
from conegraph.bench.reference_run import refer
from conegraph.bench.rows import CostRow, Job, ReferenceRow, Row, RunRow
from conegraph.bench.run import measure

REFERENCE, COST = "reference", "cost"


class Task(Row):
    """A job, and for a run the batch optimum of its stream."""

    job: Job
    reference: ReferenceRow | None = None


def work(task: Task) -> BaseModel:
    """Do a job; what goes wrong becomes the row's reason."""
    job = task.job
    try:
        recording = job.stream.recording()
        if job.backend == REFERENCE:
            return refer(job, recording)
        if job.backend == COST:
            return frame_cost(job, recording)
        return measure(job, recording, task.reference or ReferenceRow(key=""))
    except Exception as error:
        return failed(job, f"{type(error).__name__}: {' '.join(str(error).split())}")


def failed(job: Job, reason: str) -> ReferenceRow | CostRow | RunRow:
    """Return the row of a job that gave none."""
    if job.backend == REFERENCE:
        return ReferenceRow(key=job.key, reason=reason)
    if job.backend == COST:
        return CostRow(job=job, reason=reason)
    return RunRow(job=job, reason=reason)


if __name__ == "__main__":
    given = Task.model_validate_json(sys.stdin.read())
    sys.stdout.write("\n" + work(given).model_dump_json() + "\n")
