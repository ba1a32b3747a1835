"""Where the graph is solved: between two frames, or in a process of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from conegraph.backends.mapper import Mapper
from conegraph.backends.snapshot import Snapshot, take_snapshot
from conegraph.backends.solver import UNSOLVABLE
from conegraph.backends.tracked_frame import TrackedFrame
from conegraph.types import Array, IntArray, Revision, Trajectory


@dataclass(frozen=True, slots=True)
class Mapped:
    """What became of some frames.

    Attributes:
        snapshot: what the graph then believes, None if it cannot be solved.
        revisions: what was taken back.
    """

    snapshot: Snapshot | None
    revisions: tuple[Revision, ...]


@dataclass(frozen=True, slots=True)
class Settled:
    """The final solution.

    Attributes:
        path: every pose.
        revisions: what was taken back and not yet told.
        ids: (n,) the cones.
        xy_m: (n, 2) where they are.
        cov_m2: (n, 2, 2) their covariances.
    """

    path: Trajectory
    revisions: tuple[Revision, ...]
    ids: IntArray
    xy_m: Array
    cov_m2: Array


class Mapping(Protocol):
    """Takes frames, gives back what the graph makes of them, sooner or later."""

    @property
    def busy(self) -> bool:
        """Whether frames are still being worked on."""
        ...

    def submit(self, frames: Sequence[TrackedFrame]) -> None:
        """Hand over frames, in order."""
        ...

    def poll(self) -> Mapped | None:
        """Take out the newest result, None if there is none yet."""
        ...

    def finish(self, *, polish: bool) -> Settled | None:
        """Wait for everything, settle it and stop; None if the graph is gone.

        With the revisions of results that were not taken out.
        """
        ...


class InlineMapping:
    """Solves at once: the same frames give the same bytes."""

    def __init__(self, mapper: Mapper, radius_m: float) -> None:
        """Take a mapper and how far around the car its snapshots reach."""
        self.mapper = mapper
        self._radius_m = radius_m
        self._result: Mapped | None = None

    @property
    def busy(self) -> bool:
        """Never: what was handed over is solved."""
        return False

    def submit(self, frames: Sequence[TrackedFrame]) -> None:
        """Solve."""
        self._result = map_frames(self.mapper, frames, self._radius_m)

    def poll(self) -> Mapped | None:
        """Take out the result."""
        result, self._result = self._result, None
        return result

    def finish(self, *, polish: bool) -> Settled | None:
        """Solve to convergence."""
        return with_earlier([self.poll()], settle(self.mapper, polish=polish))


def map_frames(
    mapper: Mapper, frames: Sequence[TrackedFrame], radius_m: float
) -> Mapped:
    """Let the graph take frames in; gtsam's errors end here.

    A solver that cannot be read is rebuilt; once the graph has no solution at all
    nothing more comes from it.
    """
    if mapper.failed:
        return Mapped(None, ())
    revisions: list[Revision] = []
    try:
        revisions = mapper.update(frames)
        shot = None if mapper.failed else take_snapshot(mapper, radius_m)
    except UNSOLVABLE:
        mapper.mend()
        shot = None
    return Mapped(shot, tuple(revisions))


def with_earlier(
    answers: Iterable[Mapped | None], settled: Settled | None
) -> Settled | None:
    """Add what results took back that nobody has taken out."""
    if settled is None:
        return None
    late = (r for mapped in answers if mapped is not None for r in mapped.revisions)
    return replace(settled, revisions=(*late, *settled.revisions))


def settle(mapper: Mapper, *, polish: bool) -> Settled | None:
    """Solve the whole graph; None if there is nothing to solve, or no solution."""
    if len(mapper.journal) == 0:
        return None
    try:
        path, revisions = mapper.settle(polish=polish)
        if path is None:
            return None
        ids = list(mapper.cones)
        xy = np.array([mapper.cone_m(c) for c in ids]).reshape(-1, 2)
        cov = np.array([mapper.cone_cov_m2(c) for c in ids]).reshape(-1, 2, 2)
    except UNSOLVABLE:
        return None
    return Settled(path, tuple(revisions), np.array(ids, dtype=np.int64), xy, cov)
