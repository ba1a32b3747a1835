"""Does jobs side by side, and remembers those that are done."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Protocol, TypeVar

from conegraph.bench.journal import Journal, Line


class Keyed(Protocol):
    """A job, known by the key of its row."""

    @property
    def key(self) -> str:
        """What tells it from all others."""


J = TypeVar("J", bound=Keyed)
R = TypeVar("R", bound=Line)
T = TypeVar("T")


def run_chains(
    chains: Sequence[Sequence[J]],
    journal: Journal[R],
    do: Callable[[J], R],
    at_once: int,
    done: Callable[[int], None],
) -> None:
    """Do what the journal does not have yet.

    Args:
        chains: jobs that are done one after another by one thread: those of one
            stream, which is then made once.
        journal: the rows that there are, and where new ones go.
        do: does a job, and returns also of one that broke off a row.
        at_once: chains that are worked on at once.
        done: is told how many jobs are done.
    """
    finished = sum(job.key in journal.rows for chain in chains for job in chain)
    done(finished)
    lock, stop = threading.Lock(), threading.Event()

    def follow(chain: Iterable[J]) -> None:
        nonlocal finished
        for job in chain:
            if job.key in journal.rows:
                continue
            row = do(job)
            if stop.is_set():
                return
            with lock:
                journal.add(row)
                finished += 1
                done(finished)

    pool = ThreadPoolExecutor(at_once)
    try:
        for future in as_completed([pool.submit(follow, chain) for chain in chains]):
            future.result()
    except BaseException:
        # What is in progress is given up: the workers end with their owner.
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def grouped(items: Iterable[T], key: Callable[[T], str]) -> list[list[T]]:
    """Return the items with one key together, in the order of first appearance."""
    groups: dict[str, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
