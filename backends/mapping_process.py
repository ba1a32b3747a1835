"""The graph in a process of its own, so that no frame waits for its solution.

gtsam keeps Python's interpreter to itself while it solves: a thread beside the
frame path would stop it for as long. Frames and snapshots travel as numpy arrays
through a pipe that only a thread touches; a full pipe blocks nobody else.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Sequence
from multiprocessing.connection import Connection

from conegraph.backends.mapper import Mapper
from conegraph.backends.mapping import (
    Mapped,
    Settled,
    map_frames,
    settle,
    with_earlier,
)
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.config import Isam2Config, MotionConfig
from conegraph.types import ConeMap, SensorModel

log = logging.getLogger(__name__)

NICENESS = 5
"""The frame path goes first where cores are few."""

STALL_S = 1.5
"""How long a solution may take: snapshots reach so much farther ahead."""


class ProcessMapping:
    """A mapper in another process; results come when they are there."""

    def __init__(
        self,
        config: Isam2Config,
        motion: MotionConfig,
        known: ConeMap | None,
        sensor: SensorModel | None,
        radius_m: float,
    ) -> None:
        """Start the process; it is ready when it first answers."""
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_work,
            args=(theirs, config, motion, known, sensor, radius_m),
            name="conegraph-mapper",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        self._todo: queue.SimpleQueue[Sequence[TrackedFrame] | bool] = (
            queue.SimpleQueue()
        )
        self._done: queue.SimpleQueue[Mapped | Settled | None] = queue.SimpleQueue()
        self._waiting = 0
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid or 0

    @property
    def busy(self) -> bool:
        """Whether an answer is still to come."""
        return self._waiting > 0 and self._done.empty()

    def submit(self, frames: Sequence[TrackedFrame]) -> None:
        """Hand frames to the process."""
        self._waiting += 1
        self._todo.put(tuple(frames))

    def poll(self) -> Mapped | None:
        """Take out an answer if there is one."""
        if self._waiting == 0 or self._done.empty():
            return None
        return self._take()

    def finish(self, *, polish: bool) -> Settled | None:
        """Let the process settle and end."""
        late = [self._take() for _ in range(self._waiting)]
        self._todo.put(polish)
        settled = self._done.get()
        self._thread.join()
        self._ours.close()
        self._process.join()
        return with_earlier(late, settled if isinstance(settled, Settled) else None)

    def _take(self) -> Mapped | None:
        self._waiting -= 1
        answer = self._done.get()
        return answer if isinstance(answer, Mapped) else None

    def _carry(self) -> None:
        """Carry questions and answers; a process that died answers nothing."""
        item: Sequence[TrackedFrame] | bool = ()
        alive = True
        while not isinstance(item, bool):
            item, answer = self._todo.get(), None
            try:
                if alive:
                    self._ours.send(item)
                    answer = self._ours.recv()
            except (EOFError, OSError):
                alive = False
                log.warning("the mapping process has ended; going on without it")
            self._done.put(answer)


def _work(
    pipe: Connection,
    config: Isam2Config,
    motion: MotionConfig,
    known: ConeMap | None,
    sensor: SensorModel | None,
    radius_m: float,
) -> None:
    """Answer until the other end is closed or the work is settled."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    mapper = Mapper(config, motion, known, sensor)
    while True:
        try:
            item: Sequence[TrackedFrame] | bool = pipe.recv()
            if isinstance(item, bool):
                pipe.send(settle(mapper, polish=item))
                return
            speed_mps = abs(float(item[-1].state[3]))
            reach_m = radius_m + STALL_S * speed_mps
            pipe.send(map_frames(mapper, item, reach_m))
        except (EOFError, OSError):
            return
