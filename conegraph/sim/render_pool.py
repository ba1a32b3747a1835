"""Frames rendered by several processes, in their order."""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor

from conegraph.camera import RgbdFrame

Render = Callable[[int], RgbdFrame]

_PER_WORKER = 3
_render: Render | None = None


def free_cores() -> int:
    """Return how many processes this one may keep busy."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def rendered(render: Render, count: int, workers: int) -> Iterator[RgbdFrame]:
    """Yield ``render(0)`` to ``render(count - 1)``; the same whatever the workers.

    A few frames are rendered ahead. The processes are started anew and not forked,
    because OpenCV's threads would not survive that: the program that calls this
    must be importable without doing its work, as commands are.

    Args:
        render: makes a frame from its number; goes to every worker once.
        count: how many frames.
        workers: processes; with one or none, this process renders by itself.
    """
    if workers <= 1 or count <= workers:
        yield from map(render, range(count))
        return
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_adopt,
        initargs=(render,),
    )
    waiting: deque[Future[RgbdFrame]] = deque()
    try:
        for index in range(count):
            waiting.append(pool.submit(_work, index))
            if len(waiting) > _PER_WORKER * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _adopt(render: Render) -> None:
    global _render
    import cv2

    cv2.setNumThreads(1)
    _render = render


def _work(index: int) -> RgbdFrame:
    if _render is None:
        raise RuntimeError("the worker was not started by rendered()")
    return _render(index)
