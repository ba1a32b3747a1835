"""Which runs the figures need."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from conegraph.bench.rows import Job
from conegraph.bench.streams import SIZED, Stream
from conegraph.bench.worker import COST, reference_of

ACCURACY, KNOWN = "accuracy", "known"
STRESS, STRESS_KNOWN = "stress", "stress-known"
LONG, LARGE, SIZES, REAL = "long", "large", "cost", "real"

KNOWN_IDS = ("association.method=known",)
WRONG_COLOUR, UNKNOWN_COLOUR = 0.02, 0.2
LONG_LAPS = 10
USUAL_CONES, MANY_CONES = 225, 400
COST_CONES = (100, 200, 400, 800)
ROBOTS = (1, 2, 3)

LATENCY_SETTINGS = {"isam2": ("backend.mapping=process",)}
"""Overrides by back end in runs whose frame times count; those run as they came."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What to measure.

    Attributes:
        drives: (track, seed) pairs.
        laps: laps a drive.
        sensors: ``camera``, ``lidar``.
        odometry: with, without, or both.
        backends: kinds, each with its profile if wanted.
        settings: overrides of every run's configuration.
        known: whether to repeat every run with the true associations.
        stress: whether to repeat the drives with wrong and unknown colours.
        latency: whether to measure frame times, which wants a quiet machine.
        mrclam: folder of the MRCLAM robots, None without.
    """

    drives: tuple[tuple[str, int], ...]
    laps: int = 3
    sensors: tuple[str, ...] = ("camera", "lidar")
    odometry: tuple[bool, ...] = (False, True)
    backends: tuple[str, ...] = ("ekf", "isam2")
    settings: tuple[str, ...] = ()
    known: bool = True
    stress: bool = True
    latency: bool = True
    mrclam: str | None = None

    def side_by_side(self) -> list[Job]:
        """Return the jobs that may run together, each stream's optimum first."""
        return _with_references([*self._accuracy(), *self._real()])

    def one_by_one(self) -> list[Job]:
        """Return the jobs whose times count, so that nothing may run beside them."""
        if not self.latency:
            return []
        cost = [Job(group=SIZES, stream=_sized(n, 1), backend=COST) for n in COST_CONES]
        return [*_with_references(list(self._long())), *cost]

    def _accuracy(self) -> Iterator[Job]:
        for (track, seed), sensor, odometry in product(
            self.drives, self.sensors, self.odometry
        ):
            stream = Stream(
                track=track,
                seed=seed,
                laps=self.laps,
                sensor=sensor,
                odometry=odometry,
            )
            yield from self._both_ways(stream, ACCURACY, KNOWN)
            if self.stress:
                faults = {
                    "wrong_colour": WRONG_COLOUR,
                    "unknown_colour": UNKNOWN_COLOUR,
                }
                painted = stream.model_copy(update=faults)
                yield from self._both_ways(painted, STRESS, STRESS_KNOWN)

    def _both_ways(self, stream: Stream, unknown: str, known: str) -> Iterator[Job]:
        for backend in self.backends:
            yield self._job(unknown, stream, backend)
            if self.known:
                yield self._job(known, stream, backend, KNOWN_IDS)

    def _real(self) -> Iterator[Job]:
        if self.mrclam is not None:
            for robot in ROBOTS:
                stream = Stream(track=f"mrclam:{self.mrclam}/Robot{robot}")
                yield from self._both_ways(stream, REAL, REAL)

    def _long(self) -> Iterator[Job]:
        for backend in self.backends:
            settings = LATENCY_SETTINGS.get(backend, ())
            live = {"live": backend in LATENCY_SETTINGS}
            for group, stream in (
                (LONG, _sized(USUAL_CONES, LONG_LAPS)),
                (LARGE, _sized(MANY_CONES, 2)),
            ):
                job = self._job(group, stream, backend, settings)
                yield job.model_copy(update=live)

    def _job(
        self, group: str, stream: Stream, backend: str, extra: tuple[str, ...] = ()
    ) -> Job:
        settings = (*self.settings, *extra)
        return Job(group=group, stream=stream, backend=backend, settings=settings)


def _sized(cones: int, laps: int) -> Stream:
    """Return a vision-only camera drive on a course with so many cones."""
    return Stream(track=f"{SIZED}:{cones}", laps=laps, odometry=False)


def _with_references(jobs: list[Job]) -> list[Job]:
    simulated = [job for job in jobs if not job.stream.recorded]
    references = {reference_of(job).key: reference_of(job) for job in simulated}
    return [*references.values(), *jobs]
