"""What ``bench relocalisation`` measures: finding a car on a map, and losing it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from conegraph.backends.relocalize import Relocaliser, same_place
from conegraph.backends.start_line import verify_closure
from conegraph.bench.figure import Figure, not_measured
from conegraph.bench.lost_car import LostCount, count_lost
from conegraph.bench.relocalisation_trials import (
    SENSORS,
    Window,
    cone_map,
    drive,
    spoiled_map,
    start_windows,
    windows,
)
from conegraph.bench.symmetric import circle, straight
from conegraph.config import Config, resolve_config
from conegraph.eval.statistics import rate
from conegraph.geometry import between
from conegraph.types import Array, ConeMap, Recording, SensorModel, TrackLayout

LENGTHS_S = {"lidar": (0.0, 1.0), "camera": (1.0, 3.0)}
"""Windows by sensor; 0 is a single frame."""

FOUND = (("lidar", 0.0, 0.97), ("camera", 1.0, 0.74), ("camera", 3.0, 0.93))
DRIFT_M, DRIFT_RAD = 8.0, 0.35
"""A closure is tried at poses no farther than this from the predicted one."""

NEVER_ON_OWN, NEVER_ON_OTHERS = 0.001, 0.005


@dataclass(frozen=True, slots=True)
class Plan:
    """How much to measure.

    Attributes:
        layouts: closed tracks, no two of them of one course.
        count: windows a track and sensor.
        others: foreign maps that each window is held against.
    """

    layouts: Sequence[TrackLayout]
    count: int = 40
    others: int = 3

    @property
    def steps(self) -> int:
        """How many drives that makes."""
        return len(SENSORS) * len(self.layouts)


@dataclass(frozen=True, slots=True)
class Query:
    """One search and what came of it."""

    sensor: str
    seconds: float
    accepted: bool
    right: bool


@dataclass(frozen=True, slots=True)
class Course:
    """A drive on a track and a map of it with errors."""

    recording: Recording
    cone_map: ConeMap
    sensor: SensorModel


def measure(plan: Plan, advance: Callable[[int], None] | None = None) -> list[Figure]:
    """Return every figure beside its target."""
    config = resolve_config({})
    own: list[Query] = []
    foreign: list[Query] = []
    alike: list[Query] = []
    verified: list[Query] = []
    lost: list[LostCount] = []
    for n, kind in enumerate(SENSORS):
        courses = [_course(t, kind, k) for k, t in enumerate(plan.layouts)]
        found, wrong, seen = _search(courses, kind, plan, config)
        own, foreign, verified = own + found, foreign + wrong, verified + seen
        alike += _search_alike(kind, plan, config)
        for k, course in enumerate(courses):
            rng = np.random.default_rng([k, n])
            count = count_lost(course.recording, course.cone_map, config, rng)
            lost.append(count)
            if advance is not None:
                advance(n * len(courses) + k + 1)
    return [
        *found_figures(own),
        never_accepted("false accepts, right map", own, NEVER_ON_OWN),
        never_accepted("false accepts, another track's map", foreign, NEVER_ON_OTHERS),
        never_accepted("accepts, equal-spacing circle and straight", alike, 0.0),
        *_lost_figures(lost),
        *_closure_figures(verified),
    ]


def _course(layout: TrackLayout, kind: str, seed: int) -> Course:
    recording = drive(layout, SENSORS[kind], seed)
    truth, sensor = recording.truth_map, recording.sensor
    if truth is None or sensor is None:
        raise ValueError(f"{layout.name}: a drive without its truth")
    return Course(recording, spoiled_map(truth, np.random.default_rng(seed)), sensor)


def _search(
    courses: Sequence[Course], kind: str, plan: Plan, config: Config
) -> tuple[list[Query], list[Query], list[Query]]:
    """Search each track's windows on its own map and on others; verify closures."""
    searchers = [Relocaliser(c.cone_map, c.sensor) for c in courses]
    own, foreign, verified = [], [], []
    for k, course in enumerate(courses):
        rng = np.random.default_rng(1000 + k)
        every = windows(course.recording, config, LENGTHS_S[kind], plan.count, rng)
        others = [n for n in range(len(courses)) if not _one_course(course, courses[n])]
        for i, window in enumerate(every):
            own.append(_query(searchers[k], kind, window))
            verified.append(_false_closure(searchers[k], kind, window))
            for step in range(min(plan.others, len(others))):
                found = searchers[others[(i + step) % len(others)]].locate(window.seen)
                foreign.append(Query(kind, window.seconds, found.accepted, False))
        at_start = [
            verify_closure(searchers[k], w.seen, w.pose) > searchers[k].config.margin
            for w in start_windows(course.recording, config)
        ]
        if at_start:
            verified.append(Query(kind, 1.0, any(at_start), True))
    return own, foreign, verified


def _one_course(a: Course, b: Course) -> bool:
    """Whether two tracks are the same course, as some files are."""
    if a is b:
        return True
    size = [len(c.recording.truth_map or ()) for c in (a, b)]
    span = [
        np.ptp(c.recording.truth_map.xy_m, axis=0)
        for c in (a, b)
        if c.recording.truth_map is not None
    ]
    alike = np.allclose(np.sort(span[0]), np.sort(span[1]), rtol=0.03)
    return alike and abs(size[0] - size[1]) < 0.05 * size[0]


def _query(searcher: Relocaliser, kind: str, window: Window) -> Query:
    found = searcher.locate(window.seen)
    best = found.best
    right = best is not None and bool(same_place(best.pose, window.pose)[0])
    return Query(kind, window.seconds, found.accepted, right)


def _false_closure(searcher: Relocaliser, kind: str, window: Window) -> Query:
    """Try to verify the likeliest wrong pose that a drift could make plausible."""
    wrong = [
        h.pose
        for h in searcher.locate(window.seen).hypotheses
        if not same_place(h.pose, window.pose)[0] and _within_drift(h.pose, window.pose)
    ]
    leads = [verify_closure(searcher, window.seen, pose) for pose in wrong[:1]]
    accepted = any(lead > searcher.config.margin for lead in leads)
    return Query(kind, window.seconds, accepted, False)


def _within_drift(pose: Array, truth: Array) -> bool:
    gap = between(truth, pose)
    return bool(np.hypot(gap[0], gap[1]) < DRIFT_M and abs(gap[2]) < DRIFT_RAD)


def _search_alike(kind: str, plan: Plan, config: Config) -> list[Query]:
    """Search where a track looks the same in many places, on perfect maps."""
    queries = []
    for k, layout in enumerate((circle(), straight())):
        recording = drive(layout, SENSORS[kind], k)
        if recording.sensor is None:
            continue
        exact = cone_map(layout.xy_m, layout.cone_class)
        searcher = Relocaliser(exact, recording.sensor)
        rng = np.random.default_rng(2000 + k)
        for window in windows(recording, config, LENGTHS_S[kind], plan.count, rng):
            queries.append(_query(searcher, kind, window))
    return queries


def found_figures(queries: Sequence[Query]) -> list[Figure]:
    """Return the shares of windows that were accepted and right."""
    figures = []
    for kind, seconds, target in FOUND:
        hits = [
            q.accepted and q.right
            for q in queries
            if q.sensor == kind and q.seconds == seconds
        ]
        span = "1 frame" if seconds == 0.0 else f"{seconds:g} s"
        name = f"relocalised, accepted and right: {kind}, {span}"
        figures.append(_share(name, hits, target))
    return figures


def _share(name: str, hits: Sequence[bool], least: float) -> Figure:
    target = f"≥ {least:g}"
    if not hits:
        return not_measured(name, target)
    share = float(np.mean(hits))
    measured = f"{share:.3f} (n {len(hits)})"
    return Figure(
        name, target, measured, share >= least, {"share": share, "n": len(hits)}
    )


def never_accepted(name: str, queries: Sequence[Query], most: float) -> Figure:
    """Return a figure of accepts that are wrong, with the end of its interval."""
    wrong = sum(q.accepted and not q.right for q in queries)
    target = f"≤ {100 * most:g} %" if most else "0"
    if not queries:
        return not_measured(name, target)
    share = wrong / len(queries)
    by = [
        f"{kind} {seconds:g} s: {sum(q.accepted and not q.right for q in some)}"
        for kind, seconds in product(SENSORS, (0.0, 1.0, 3.0))
        if (some := [q for q in queries if (q.sensor, q.seconds) == (kind, seconds)])
    ]
    high = rate(wrong, len(queries)).interval.high
    measured = (
        f"{100 * share:.2f} % ({wrong} of {len(queries)}, at most {100 * high:.2f} %; "
        f"{', '.join(by)})"
    )
    values = {"share": share, "at_most": high}
    return Figure(name, target, measured, share <= most, values)


def _lost_figures(counts: Sequence[LostCount]) -> list[Figure]:
    delays = np.array([d for c in counts for d in c.noticed_s])
    back = np.array([d for c in counts for d in c.found_s])
    alarms = sum(c.false_alarms for c in counts)
    hours = sum(c.hours for c in counts)
    if len(delays) == 0 or hours == 0.0:
        return [not_measured("lost car noticed", "≤ 0.5 s")]
    median, soon = float(np.median(delays)), float(np.mean(delays <= 3.0))
    found = float(np.mean(back <= 10.0))
    again = float(np.median(back[np.isfinite(back)]))
    rate = alarms / hours
    n = f"n {len(delays)}"
    return [
        Figure(
            "lost car noticed after, median",
            "≤ 0.5 s",
            f"{median:.2f} s ({n})",
            median <= 0.5,
            {"median_s": median},
        ),
        Figure(
            "lost car noticed within 3 s",
            "≥ 0.95",
            f"{soon:.3f} ({n})",
            soon >= 0.95,
            {"share": soon},
        ),
        Figure(
            "lost car on the map again within 10 s",
            "≥ 0.95",
            f"{found:.3f} (median {again:.2f} s)",
            found >= 0.95,
            {"share": found, "median_s": again},
        ),
        Figure(
            "false alarms an hour",
            "≤ 1",
            f"{rate:.2f} ({alarms} in {hours:.2f} h)",
            rate <= 1.0,
            {"per_hour": rate, "hours": hours},
        ),
    ]


def _closure_figures(queries: Sequence[Query]) -> list[Figure]:
    at_start = [q.accepted for q in queries if q.right]
    elsewhere = [q for q in queries if not q.right]
    return [
        _share("closures verified within 1 s of the start line", at_start, 0.95),
        never_accepted("wrong closures verified", elsewhere, 0.0),
    ]
