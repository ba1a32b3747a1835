"""Runs measurements side by side, and remembers those that are done."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from conegraph.bench.rows import CostRow, Job, ReferenceRow, RunRow
from conegraph.bench.worker import REFERENCE, Task, failed

LONGEST_S = 3600.0
"""A measurement that takes longer has hung."""

AnyRow = ReferenceRow | CostRow | RunRow
T = TypeVar("T")


class RowFile:
    """Rows as JSON lines: a benchmark that was killed goes on where it was."""

    def __init__(self, path: Path) -> None:
        """Read the rows that are there; a line that was cut off is done again."""
        self._path = path
        self._lock = threading.Lock()
        self.rows: dict[str, AnyRow] = {}
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                row = _parsed(line)
                if row is not None and not row.reason:
                    self.rows[_key(row)] = row

    def add(self, row: AnyRow) -> None:
        """Append a row."""
        with self._lock:
            self.rows[_key(row)] = row
            with self._path.open("a", encoding="utf-8") as file:
                file.write(row.model_dump_json() + "\n")


def run_all(
    jobs: Sequence[Job], file: RowFile, at_once: int, done: Callable[[int], None]
) -> None:
    """Do what has not been done yet, each job in a process of its own.

    The jobs of one stream are done one after another, its batch optimum first; that
    many streams are worked on at once.

    Args:
        jobs: what to measure.
        file: the rows that there are, and where new ones go.
        at_once: processes.
        done: is told how many jobs are done.
    """
    finished = sum(job.key in file.rows for job in jobs)
    done(finished)
    waiting = [job for job in jobs if job.key not in file.rows]
    lock = threading.Lock()

    def follow(stream_jobs: list[Job]) -> None:
        nonlocal finished
        for job in stream_jobs:
            reference = file.rows.get(reference_of(job).key)
            known = reference if isinstance(reference, ReferenceRow) else None
            file.add(run_one(Task(job=job, reference=known)))
            with lock:
                finished += 1
                done(finished)

    by_stream = _grouped(waiting, lambda job: reference_of(job).key)
    with ThreadPoolExecutor(at_once) as pool:
        for _ in pool.map(follow, by_stream):
            pass


def reference_of(job: Job) -> Job:
    """Return the job that makes the batch optimum of a job's stream."""
    return Job(group=REFERENCE, stream=job.stream.colours_right, backend=REFERENCE)


def run_one(task: Task) -> AnyRow:
    """Do one job in a fresh process."""
    job = task.job
    try:
        ended = subprocess.run(
            [sys.executable, "-m", "conegraph.bench.worker"],
            input=task.model_dump_json(),
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
            # Matrices are small: threads cost more than they bring.
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return failed(job, f"took longer than {LONGEST_S:.0f} s")
    lines = ended.stdout.strip().splitlines()
    row = _parsed(lines[-1]) if lines else None
    if ended.returncode == 0 and row is not None:
        return row
    said = ended.stderr.strip().splitlines()
    return failed(job, f"exit {ended.returncode}: {said[-1] if said else 'no word'}")


def _parsed(line: str) -> AnyRow | None:
    for kind in (ReferenceRow, CostRow, RunRow):
        try:
            return kind.model_validate_json(line)
        except ValidationError:
            continue
    return None


def _key(row: AnyRow) -> str:
    return row.key if isinstance(row, ReferenceRow) else row.job.key


def _grouped(items: Iterable[T], key: Callable[[T], str]) -> list[list[T]]:
    """Return the items with one key together, in the order of first appearance."""
    groups: dict[str, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
