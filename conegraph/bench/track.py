"""How often track detection is right, how exactly, and how fast.

On tracks from files, on random ones from seeds, whole and as windows in front of a
car, clean and spoilt.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.bench.figure import Figure, not_measured
from conegraph.bench.track_hard import hard_cases
from conegraph.bench.track_judge import (
    ahead_right,
    all_edges,
    edges_right,
    off_line_m,
    road_iou,
    without_gate,
    wrong_map,
)
from conegraph.bench.track_truth import (
    KnownTrack,
    Spoil,
    course_of,
    spoiled,
    window,
)
from conegraph.config import TrackConfig
from conegraph.geometry import compose
from conegraph.track import detect_track
from conegraph.types import Array, ConeMap

WINDOW_M = 20.0
STEPS = 5
"""How often `bench_track` reports progress."""
_POSES = 10
_REPEATS = 5
_SPOILS = {
    "10 % missing": (Spoil(missing=0.10), 0.94),
    "5 % false": (Spoil(false=0.05), 0.94),
    "3 % flipped": (Spoil(flipped=0.03), 0.94),
    "mixed 5/3/3": (Spoil(0.05, 0.03, 0.03), 0.82),
}
_WINDOWS = {
    "window, clean": (Spoil(), 0.99),
    "window, 20 % missing": (Spoil(missing=0.2), 0.93),
    "window, mixed 10/5/5": (Spoil(0.10, 0.05, 0.05), 0.92),
    "window without colour": (Spoil(colour=False), 0.96),
}
_PRECISION = {"window, clean": 0.99, "window, mixed 10/5/5": 0.95}


@dataclass(frozen=True, slots=True)
class Score:
    """One line of the table: what, its value, its target, and over how many."""

    name: str
    value: float
    target: float
    at_least: bool
    count: int
    failures: tuple[str, ...] = ()

    @property
    def met(self) -> bool:
        """Whether the target is met."""
        return self.value >= self.target if self.at_least else self.value <= self.target

    def figure(self) -> Figure:
        """Return it as a row of a table."""
        target = f"{'≥' if self.at_least else '≤'} {self.target:g}"
        if self.count == 0:
            return not_measured(self.name, target)
        return Figure(
            self.name,
            target,
            f"{self.value:.3f} (n {self.count})",
            self.met,
            {"value": self.value, "n": float(self.count)},
        )


def bench_track(
    tracks: Sequence[KnownTrack],
    seeds: Sequence[int],
    config: TrackConfig,
    progress: Callable[[int], None] | None = None,
) -> list[Score]:
    """Return all figures over tracks and seeds."""
    figures: list[Score] = []
    for done, step in enumerate((_full, _windows, _lines, _times, _hard), 1):
        figures += step(tracks, seeds, config)
        if progress is not None:
            progress(done)
    return figures


def _full(
    tracks: Sequence[KnownTrack], seeds: Sequence[int], config: TrackConfig
) -> Iterator[Score]:
    bad = []
    for truth in tracks:
        track = detect_track(truth.cone_map(), config=config)
        right, of = edges_right(track, truth)
        iou = road_iou(track, without_gate(truth, track))
        if not (right == of and all_edges(track, truth) and iou >= 0.995):
            bad.append(f"{truth.name}: {right}/{of} edges, IoU {iou:.3f}")
    yield _share("clean maps, all edges right, IoU >= .995", bad, len(tracks), 1.0)
    for name, (spoil, target) in _SPOILS.items():
        bad = []
        for truth in tracks:
            for seed in seeds:
                seen = spoiled(truth, spoil, np.random.default_rng([seed, 5]))
                why = wrong_map(detect_track(seen.cone_map(), config=config), truth)
                if why:
                    bad.append(f"{truth.name}, seed {seed}: {why}")
        yield _share(f"maps, {name}", bad, len(tracks) * len(seeds), target)


def _windows(
    tracks: Sequence[KnownTrack], seeds: Sequence[int], config: TrackConfig
) -> Iterator[Score]:
    precision = {}
    for name, (spoil, target) in _WINDOWS.items():
        bad, count, right, edges = [], 0, 0, 0
        for number, truth in enumerate(tracks):
            rng = np.random.default_rng([number, *seeds])
            for at in rng.integers(len(truth.line_m), size=_POSES).tolist():
                true_pose = truth.pose_at(at)
                off = rng.normal(0.0, (0.0, 0.2, 0.05))
                pose = compose(true_pose, off)
                seen = window(spoiled(truth, spoil, rng), pose, WINDOW_M)
                track = detect_track(seen.cone_map(), pose, config=config)
                count += 1
                if not ahead_right(track, truth, pose):
                    bad.append(f"{truth.name} at {at}")
                good, of = edges_right(track, seen)
                right, edges = right + good, edges + of
        precision[name] = (right / max(edges, 1), edges)
        yield _share(name, bad, count, target)
    for name, target in _PRECISION.items():
        value, edges = precision[name]
        yield Score(f"edge precision, {name}", value, target, True, edges)


def _lines(
    tracks: Sequence[KnownTrack], seeds: Sequence[int], config: TrackConfig
) -> Iterator[Score]:
    """RMS of the centre line's distance to the true one, where that is given.

    A line that is not found is infinitely far off.
    """
    given = [t for t in tracks if t.given_line]
    for name, noise_m, target in (("clean", 0.0, 0.07), ("0.1 m noise", 0.1, 0.12)):
        square, bad = [], []
        for truth in given:
            for seed in seeds if noise_m else seeds[:1]:
                rng = np.random.default_rng([seed, 6])
                seen = spoiled(truth, Spoil(noise_m=noise_m), rng)
                line = detect_track(seen.cone_map(), config=config).centerline
                if len(line) == 0:
                    bad.append(f"{truth.name}, seed {seed}: no line")
                off = off_line_m(line.xy_m, truth) if len(line) else np.array([np.inf])
                square.append(off**2)
        value = float(np.sqrt(np.concatenate(square).mean())) if square else np.nan
        what = f"centre line RMS m, {name}"
        yield Score(what, value, target, False, len(square), tuple(bad))


def _times(
    tracks: Sequence[KnownTrack], seeds: Sequence[int], config: TrackConfig
) -> Iterator[Score]:
    times = []
    for truth in tracks:
        for at in np.linspace(0, len(truth.line_m) - 1, 5).astype(int).tolist():
            pose = truth.pose_at(at)
            seen = window(truth, pose, WINDOW_M).cone_map()
            times.append(_best_ms(seen, pose, config))
    yield Score("window ms, median", float(np.median(times)), 2.0, False, len(times))
    small, large = (course_of(n).cone_map() for n in (250, 500))
    half = _best_ms(small, None, config)
    whole = _best_ms(large, None, config)
    yield Score("full map of 250 cones, ms", half, 15.0, False, 1)
    yield Score("500 cones / 250, time", whole / half, 2.5, False, 1)


def _hard(
    tracks: Sequence[KnownTrack], seeds: Sequence[int], config: TrackConfig
) -> Iterator[Score]:
    cases = hard_cases(seeds[0])
    bad = [name for name, right in cases if not right(config)]
    yield _share("hard cases right or unsure", bad, len(cases), 1.0)


def _share(name: str, bad: list[str], count: int, target: float) -> Score:
    value = 1.0 - len(bad) / max(count, 1)
    return Score(name, value, target, True, count, tuple(bad))


def _best_ms(cone_map: ConeMap, pose: Array | None, config: TrackConfig) -> float:
    """Return the shortest time of this thread in some runs.

    What other processes take, or their caches, is not the method's cost.
    """
    best = np.inf
    for _ in range(_REPEATS):
        began = time.thread_time()
        detect_track(cone_map, pose, config=config)
        best = min(best, time.thread_time() - began)
    return 1e3 * float(best)
