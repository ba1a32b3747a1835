"""Drives cut into windows, and maps with the errors that maps have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from conegraph.backends.local_window import LocalWindow, window_config
from conegraph.backends.sightings import Sightings
from conegraph.backends.tracker import Tracker
from conegraph.config import Config
from conegraph.errors import SourceError
from conegraph.io.tracks import read_track
from conegraph.sim.cone_sensor import CAMERA, LIDAR, ConeSensor
from conegraph.sim.drive import simulate
from conegraph.sim.driving_line import closes, driving_line
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    IntArray,
    Recording,
    TrackLayout,
    TruthMap,
)

MAP_ERROR = 0.1
"""Share of the track's cones that a map lacks, and of cones that it has too many."""

MAP_SIGMA_M = 0.05
WRONG_COLOURS = 0.05
"""Of the map's cones, and of those that a sensor reports from near by."""

FALSE_PER_FRAME = 0.25

START_M = 3.0
"""A drive that comes as near as this to its beginning has come back."""


def with_errors(sensor: ConeSensor) -> ConeSensor:
    """Return a sensor with wrong colours and false cones."""
    named = replace(sensor.classification, near=1.0 - WRONG_COLOURS)
    return replace(
        sensor,
        classification=named,
        unknown_share=0.25,
        false_per_frame=FALSE_PER_FRAME,
    )


SENSORS = {"lidar": with_errors(LIDAR), "camera": with_errors(CAMERA)}


def spoiled_map(truth: TruthMap, rng: np.random.Generator) -> ConeMap:
    """Return a map with cones missing, too many, displaced and misnamed."""
    kept = rng.random(len(truth)) >= MAP_ERROR
    n_extra = rng.binomial(len(truth), MAP_ERROR)
    beside = truth.xy_m[rng.integers(0, len(truth), n_extra)]
    extra = beside + rng.uniform(-6.0, 6.0, (n_extra, 2))
    named = truth.cone_class.copy()
    wrong = rng.random(len(named)) < WRONG_COLOURS
    named[wrong] = (named[wrong] + rng.integers(1, 4, int(wrong.sum()))) % 4
    xy = truth.xy_m[kept] + MAP_SIGMA_M * rng.standard_normal((int(kept.sum()), 2))
    classes = np.concatenate([named[kept], rng.integers(0, 4, n_extra)])
    return cone_map(np.vstack([xy, extra]), classes)


def cone_map(xy_m: Array, cone_class: IntArray) -> ConeMap:
    """Return a map of cones known to 5 cm and sure of their classes."""
    n = len(xy_m)
    prob = np.full((n, 5), 0.025)
    prob[np.arange(n), cone_class] = 0.9
    cov = np.broadcast_to(MAP_SIGMA_M**2 * np.eye(2), (n, 2, 2))
    return ConeMap(np.arange(n), xy_m, cov, prob, np.full(n, 20))


@dataclass(frozen=True, slots=True)
class Window:
    """What a car that has forgotten everything knows after a while.

    Attributes:
        seconds: how long it has looked.
        seen: the cones around it.
        pose: (3,) where it truly is, in the track's frame.
    """

    seconds: float
    seen: Sightings
    pose: Array


def windows(
    recording: Recording,
    config: Config,
    lengths_s: Sequence[float],
    count: int,
    rng: np.random.Generator,
) -> Iterator[Window]:
    """Yield windows of the given lengths (ascending, 0 a single frame) from a drive."""
    frames = [e for e in recording.stream if isinstance(e, ConeObservations)]
    last = frames[-1].stamp_s - lengths_s[-1] - 0.2
    for start in rng.uniform(1.5, last, count):
        first = int(np.searchsorted([f.stamp_s for f in frames], start))
        window = LocalWindow(Tracker(window_config(config), recording.sensor))
        wanted = list(lengths_s)
        for frame in frames[first:]:
            window.add(frame)
            if window.seconds >= wanted[0] - 1e-6:
                seen = window.sightings()
                yield Window(wanted.pop(0), seen, true_pose(recording, frame.stamp_s))
            if not wanted:
                break


def start_windows(recording: Recording, config: Config) -> Iterator[Window]:
    """Yield what the car sees, four times in the second after it is at the start again.

    The windows begin a second before.
    """
    path = recording.truth_trajectory
    if path is None:
        return
    steps = np.hypot(*np.diff(path.pose[:, :2], axis=0).T)
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    gap = np.hypot(*(path.pose[:, :2] - path.pose[0, :2]).T)
    back = np.flatnonzero((gone > 0.5 * gone[-1]) & (gap < START_M))
    if len(back) == 0:
        return
    start_s = float(path.stamp_s[back[gap[back].argmin()]])
    window = LocalWindow(Tracker(window_config(config), recording.sensor))
    wanted = [start_s + 0.25 * n for n in range(1, 5)]
    for frame in recording.stream:
        if not isinstance(frame, ConeObservations) or frame.stamp_s < start_s - 1.0:
            continue
        window.add(frame)
        if wanted and frame.stamp_s >= wanted[0] - 1e-6:
            wanted.pop(0)
            pose = true_pose(recording, frame.stamp_s)
            yield Window(window.seconds, window.sightings(), pose)


def true_pose(recording: Recording, stamp_s: float) -> Array:
    """Return the true pose (3,) at a frame's stamp."""
    path = recording.truth_trajectory
    assert path is not None
    row = int(np.argmin(np.abs(path.stamp_s - stamp_s)))
    pose: Array = path.pose[row]
    return pose


def circuits(names: Sequence[str]) -> list[TrackLayout]:
    """Return the layouts of files, built-in names or ``random:SEED`` that are loops.

    Raises:
        ConegraphError: one cannot be read, or none is a loop.
    """
    layouts = []
    for name in names:
        kind, _, seed = name.partition(":")
        if Path(name).is_file():
            layouts.append(read_track(Path(name)))
        else:
            layouts.append(built_in_track(kind, int(seed or 0)))
    loops = [t for t in layouts if closes(driving_line(t))]
    if not loops:
        raise SourceError("none of the tracks is a loop")
    return loops


def drive(layout: TrackLayout, sensor: ConeSensor, seed: int) -> Recording:
    """Return one lap in the track's frame."""
    return simulate(layout, laps=1, seed=seed, sensor=sensor)
