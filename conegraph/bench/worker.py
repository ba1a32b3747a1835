"""One measurement of the back ends' benchmark."""

from __future__ import annotations

from conegraph.bench.cost import frame_cost
from conegraph.bench.reference_run import refer
from conegraph.bench.rows import AnyRow, CostRow, Job, ReferenceRow, RunRow
from conegraph.bench.run import measure
from conegraph.eval.row import Row

REFERENCE, COST = "reference", "cost"


class Task(Row):
    """A job, and for a run the batch optimum of its stream."""

    job: Job
    reference: ReferenceRow | None = None


def work(task: Task) -> AnyRow:
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


def failed(job: Job, reason: str) -> AnyRow:
    """Return the row of a job that gave none."""
    if job.backend == REFERENCE:
        return ReferenceRow(key=job.key, reason=reason)
    if job.backend == COST:
        return CostRow(job=job, reason=reason)
    return RunRow(job=job, reason=reason)


def reference_of(job: Job) -> Job:
    """Return the job that makes the batch optimum of a job's stream."""
    return Job(group=REFERENCE, stream=job.stream.colours_right, backend=REFERENCE)
