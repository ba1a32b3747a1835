"""Where measurements are made: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any, Self, TypeVar

from conegraph.errors import ConegraphError, MissingDependencyError

LONGEST_S = 3600.0
"""A measurement that takes longer has hung."""

CONNECT_S = 10.0
A = TypeVar("A")
B = TypeVar("B")


class WorkerError(Exception):
    """A worker that ended, or hung, in place of an answer."""


class Workers(ABC):
    """A context that lends workers to as many threads as ask.

    Attributes:
        at_once: how many there are.
    """

    at_once: int

    @abstractmethod
    def call(self, function: Callable[[A], B], given: A) -> B:
        """Return what a worker answers; importable functions of what pickles only.

        Raises:
            WorkerError: it ended, or took longer than `LONGEST_S`.
        """

    @abstractmethod
    def close(self) -> None:
        """End what was started; what is in progress is given up."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Processes(Workers):
    """A process of its own for each thread that asks.

    It stays until the end, or is a fresh one for each call, which keeps memory
    figures apart. A solver that takes its process down takes one call with it.
    """

    def __init__(self, at_once: int, *, fresh: bool = False) -> None:
        self.at_once = at_once
        self._fresh = fresh
        self._own = threading.local()
        self._all: list[_Process] = []

    def call(self, function: Callable[[A], B], given: A) -> B:
        """Ask this thread's process; one that broke is followed by a new one."""
        process: _Process | None = getattr(self._own, "process", None)
        if process is None or self._fresh:
            process = self._own.process = _Process()
            self._all.append(process)
        try:
            answer: B = process.ask(function, given)
        except WorkerError:
            process.end()
            self._own.process = None
            raise
        if self._fresh:
            process.end()
        return answer

    def close(self) -> None:
        """Kill them all."""
        for process in self._all:
            process.end()


class _Process:
    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        # Matrices are small: threads cost more than they bring.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,))
        self._process.start()
        theirs.close()

    def ask(self, function: Callable[[Any], Any], given: object) -> Any:
        try:
            self._pipe.send((function, given))
            if self._pipe.poll(LONGEST_S):
                return self._pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            raise WorkerError(f"its process ended ({self._code()})") from None
        raise WorkerError(f"took longer than {LONGEST_S:.0f} s")

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self._pipe.close()

    def _code(self) -> str:
        code = self._process.exitcode or 0
        return signal.Signals(-code).name if code < 0 else f"exit {code}"


def _serve(pipe: Connection) -> None:
    """Answer until the other end is closed; whatever it does, end with its owner."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_owner, daemon=True).start()
    while True:
        try:
            function, given = pipe.recv()
            pipe.send(function(given))
        except (EOFError, OSError):
            return


def _end_with_owner() -> None:
    """Wait for the owner, be it that it is killed, and end what is in progress."""
    owner = multiprocessing.parent_process()
    if owner is not None:
        owner.join()
        os._exit(1)


class DaskCluster(Workers):
    """The workers of a running Dask cluster, which must have this program installed.

    Workers of one thread each measure as processes of this machine do.
    """

    def __init__(self, address: str) -> None:
        """Connect to the scheduler at an address, as in ``tcp://10.0.0.1:8786``.

        Raises:
            MissingDependencyError: Dask is not installed.
            ConegraphError: no scheduler answers there, or it has no workers.
        """
        try:
            distributed: Any = import_module("distributed")
        except ImportError:
            raise MissingDependencyError(
                "--scheduler needs Dask: pip install 'conegraph[dask]'"
            ) from None
        try:
            self._client = distributed.Client(address, timeout=CONNECT_S)
        except (OSError, ValueError, TypeError) as error:
            raise ConegraphError(
                f"--scheduler {address}: no Dask scheduler answers ({error})"
            ) from None
        self.at_once = sum(self._client.nthreads().values())
        if self.at_once == 0:
            self._client.close()
            raise ConegraphError(f"--scheduler {address}: has no workers")

    def call(self, function: Callable[[A], B], given: A) -> B:
        """Ask any worker of the cluster."""
        future = self._client.submit(function, given, pure=False)
        try:
            answer: B = future.result(timeout=LONGEST_S)
        except Exception as error:
            raise WorkerError(f"{type(error).__name__}: {error}") from None
        return answer

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._client.close()
