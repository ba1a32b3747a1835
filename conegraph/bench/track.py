"""How often track detection is right, how exactly, and how fast.

On tracks from files, on random ones from seeds, whole and as windows in front of a
car, clean and spoilt.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from shapely import LinearRing, Polygon
from shapely.geometry.base import BaseGeometry

from conegraph.bench.figure import Figure
from conegraph.bench.track_hard import hard_cases
from conegraph.bench.track_truth import (
    KnownTrack,
    Spoil,
    spoiled,
    window,
)
from conegraph.config import TrackConfig
from conegraph.geometry import compose
from conegraph.sim.polyline import nearest
from conegraph.track import Track, detect_track
from conegraph.track.shapes import road_polygon
from conegraph.types import Array, ConeClass, ConeMap, IntArray

WINDOW_M = 20.0
STEPS = 5
"""How often `bench_track` reports progress."""
_POSES = 10
_REPEATS = 5
_AHEAD_M = 10.0
_OFF_M = 1.0
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
        sign = "≥" if self.at_least else "≤"
        return Figure(
            self.name,
            f"{sign} {self.target:g}",
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
        iou = road_iou(track, _without_gate(truth, track))
        if not (right == of and _all_edges(track, truth) and iou >= 0.995):
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
    """RMS of the centre line's distance to the true one, where that is given."""
    given = [t for t in tracks if t.given_line]
    for name, noise_m, target in (("clean", 0.0, 0.07), ("0.1 m noise", 0.1, 0.12)):
        square = []
        for truth in given:
            for seed in seeds if noise_m else seeds[:1]:
                rng = np.random.default_rng([seed, 6])
                seen = spoiled(truth, Spoil(noise_m=noise_m), rng)
                track = detect_track(seen.cone_map(), config=config)
                if len(track.centerline):
                    square.append(_off_line(track.centerline.xy_m, truth) ** 2)
        value = float(np.sqrt(np.concatenate(square).mean())) if square else np.nan
        yield Score(f"centre line RMS m, {name}", value, target, False, len(square))


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


def course_of(cones: int) -> KnownTrack:
    """Return a round course with a wavy lane of 3.5 m and so many cones."""
    per_side = cones // 2
    angle = 2 * np.pi * np.arange(per_side) / per_side
    radius = 3.5 * per_side / (2 * np.pi)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    wave = radius + 0.05 * radius * np.sin(7 * angle)
    sides = [around * (wave + off)[:, None] for off in (-1.75, 1.75)]
    order = np.arange(2 * per_side)
    kind = np.repeat([ConeClass.BLUE, ConeClass.YELLOW], per_side).astype(np.int64)
    left, right = order[:per_side], order[per_side:]
    line = around * wave[:, None]
    return KnownTrack(
        f"{cones} cones", np.vstack(sides), kind, left, right, line, True, True
    )


def edges_right(track: Track, truth: KnownTrack) -> tuple[int, int]:
    """Return how many directed edges of the boundaries are true ones, and of how many.

    Gate cones stand beside the boundary as often as on it: one that is left out
    breaks no edge.
    """
    right = count = 0
    for chain, true in ((track.left, truth.left), (track.right, truth.right)):
        kept = _kept(truth, true, chain)
        following = dict(zip(kept.tolist(), np.roll(kept, -1).tolist(), strict=True))
        pairs = list(zip(chain.tolist(), np.roll(chain, -1).tolist(), strict=True))
        pairs = pairs if track.closed else pairs[:-1]
        count += len(pairs)
        right += sum(following.get(a) == b for a, b in pairs)
    return right, count


def _kept(truth: KnownTrack, true: IntArray, chain: IntArray) -> IntArray:
    """Return a true boundary without the gate cones that a found one leaves out."""
    gate = truth.cone_class[true] >= ConeClass.ORANGE
    return np.asarray(true[~gate | np.isin(true, chain)])


def _without_gate(truth: KnownTrack, track: Track) -> KnownTrack:
    """Return the truth without the gate cones that a track leaves out."""
    left = _kept(truth, truth.left, track.left)
    return replace(truth, left=left, right=_kept(truth, truth.right, track.right))


def _all_edges(track: Track, truth: KnownTrack) -> bool:
    """Return whether no cone of a true boundary is left out, gate cones excepted."""
    for chain, true in ((track.left, truth.left), (track.right, truth.right)):
        needed = true[truth.cone_class[true] <= ConeClass.YELLOW]
        if not np.isin(needed, chain).all():
            return False
    return track.closed == truth.closed


def road_iou(track: Track, truth: KnownTrack) -> float:
    """Return the overlap of the road with the true one: intersection over union."""
    true = _ring(truth.xy_m, truth.left, truth.right)
    road = road_polygon(track).buffer(0)
    return float(road.intersection(true).area / road.union(true).area)


def wrong_map(track: Track, truth: KnownTrack) -> str:
    """Return what is wrong with a map, "" if it is right.

    Right: closed, boundaries simple and not crossing, IoU with the unspoilt road
    above 0.9.
    """
    if not track.closed:
        return track.reason or "open"
    left, right = LinearRing(track.left_m), LinearRing(track.right_m)
    if not (left.is_simple and right.is_simple):
        return "boundary crosses itself"
    if left.intersects(right):
        return "boundaries cross"
    iou = road_iou(track, truth)
    return "" if iou > 0.9 else f"IoU {iou:.2f}"


def ahead_right(track: Track, truth: KnownTrack, pose: Array) -> bool:
    """Return whether the line runs 10 m ahead of a car, within 1 m of the true one."""
    line = track.centerline.xy_m
    if len(line) < 3:
        return False
    away = np.hypot(*(line - pose[:2]).T)
    if track.closed:
        line = np.roll(line, -int(np.argmin(away)), axis=0)
    else:
        line = line[int(np.argmin(away)) :]
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    s += float(np.hypot(*(line[0] - pose[:2])))
    first = line[s <= _AHEAD_M]
    if s[-1] < _AHEAD_M or len(first) < 3:
        return False
    way = first[-1] - pose[:2]
    forward = way @ (np.cos(pose[2]), np.sin(pose[2])) > -_AHEAD_M / 2
    return bool(forward and _off_line(first, truth).max() < _OFF_M)


def _off_line(xy: Array, truth: KnownTrack) -> Array:
    """Return how far points are off the true line, across it."""
    line = truth.line_m
    _, index = nearest(xy, line)
    forward = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    forward /= np.hypot(*forward.T)[:, None]
    off = xy - line[index]
    t = forward[index]
    return np.asarray(np.abs(t[:, 0] * off[:, 1] - t[:, 1] * off[:, 0]))


def _ring(xy: Array, left: IntArray, right: IntArray) -> BaseGeometry:
    a, b = (Polygon(xy[side]).buffer(0) for side in (left, right))
    return a.difference(b) if a.area > b.area else b.difference(a)


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
