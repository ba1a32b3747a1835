"""The front end's benchmark: rendered drives, timed and held against their truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from conegraph.bench.figure import Figure, not_measured
from conegraph.bench.frontend_score import Score, pooled, score_frame
from conegraph.camera import RgbdFrame
from conegraph.config import Config, resolve_config
from conegraph.frontend import FrontEnd, make_front_end
from conegraph.sim.camera_drive import CameraDrive, Suspension, drive_with_camera
from conegraph.sim.render import LIGHT_NAMES, FrameTruth, LightName
from conegraph.sim.track_shapes import built_in_track

NORMAL_LIGHT: tuple[LightName, ...] = ("bright", "overcast", "low_sun")
HARD_PITCH = Suspension(shake_rad=float(np.radians(1.0)))
RANGES_M = ((0.0, 8.0), (8.0, 12.0), (12.0, 20.0))
RECALL_TARGETS = (0.98, 0.95, 0.80)
RMSE_AT = ((5.0, 0.05), (10.0, 0.20), (15.0, 0.50))
RMSE_HALF_BIN_M = 1.5
THESIS_FRAMES = 6
WARM_UPS = 2
"""Looks of each front end before any is timed: the first ones load what they need."""


@dataclass(frozen=True, slots=True)
class Scenes:
    """Which drives are rendered, and how many pictures of each.

    Attributes:
        seeds: one drive of a random course for each seed and light.
        lights: the lights.
        frames: pictures a drive, evenly spread over its lap.
    """

    seeds: tuple[int, ...]
    lights: tuple[LightName, ...] = LIGHT_NAMES
    frames: int = 12

    def __len__(self) -> int:
        """Return how many pictures there are, hard pitch included."""
        return len(self.seeds) * (len(self.lights) + 1) * self.frames


@dataclass(frozen=True, slots=True)
class Measured:
    """What a benchmark of the front end measured.

    Attributes:
        by_light: the score of each light.
        hard_pitch: the score where the body pitches by a degree.
        default_ms: the processor's times of the default front end, in which other
            programs on the machine do not count.
        thesis_ms: times of the thesis profile, on some of the same pictures.
        thesis: its score on those.
    """

    by_light: dict[str, Score]
    hard_pitch: Score
    default_ms: tuple[float, ...]
    thesis_ms: tuple[float, ...]
    thesis: Score


def measure_front_end(
    config: Config, scenes: Scenes, done: Callable[[int], None]
) -> Measured:
    """Render the drives and run the configured front end over their pictures.

    Args:
        config: what the front end is made from.
        scenes: what to render.
        done: is told how many pictures are done.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return _measured(config, scenes, done)
    finally:
        cv2.setNumThreads(threads)


def _measured(config: Config, scenes: Scenes, done: Callable[[int], None]) -> Measured:
    thesis_config = resolve_config({"detector": {"profile": "thesis"}})
    thesis = make_front_end(thesis_config)
    first, _ = next(_pictures(_drive(scenes.seeds[0], scenes.lights[0]), 1))
    for _ in range(WARM_UPS):
        make_front_end(config).examine(first)
        make_front_end(thesis_config).examine(first)
    by_light: dict[str, list[Score]] = {light: [] for light in scenes.lights}
    hard: list[Score] = []
    default_ms: list[float] = []
    thesis_ms: list[float] = []
    thesis_scores: list[Score] = []
    count = 0
    for seed in scenes.seeds:
        for light in scenes.lights:
            front_end = make_front_end(config)
            for frame, truth in _pictures(_drive(seed, light), scenes.frames):
                score, ms = _timed(front_end, frame, truth)
                by_light[light].append(score)
                default_ms.append(ms)
                if light in NORMAL_LIGHT and len(thesis_ms) < THESIS_FRAMES:
                    score, ms = _timed(thesis, frame, truth)
                    thesis_scores.append(score)
                    thesis_ms.append(ms)
                done(count := count + 1)
        front_end = make_front_end(config)
        drive = _drive(seed, NORMAL_LIGHT[seed % len(NORMAL_LIGHT)], HARD_PITCH)
        for frame, truth in _pictures(drive, scenes.frames):
            hard.append(_timed(front_end, frame, truth)[0])
            done(count := count + 1)
    return Measured(
        {light: pooled(scores) for light, scores in by_light.items()},
        pooled(hard),
        tuple(default_ms),
        tuple(thesis_ms),
        pooled(thesis_scores),
    )


def _drive(
    seed: int, light: LightName, suspension: Suspension | None = None
) -> CameraDrive:
    layout = built_in_track("random", seed)
    # Another course has another look too: the light's own draws follow the seed.
    return drive_with_camera(
        layout, laps=1, seed=seed, light=light, suspension=suspension
    )


def _pictures(
    drive: CameraDrive, frames: int
) -> Iterator[tuple[RgbdFrame, FrameTruth]]:
    for index in np.linspace(0, drive.n_frames - 1, frames).astype(int).tolist():
        yield drive.render(index)


def _timed(
    front_end: FrontEnd, frame: RgbdFrame, truth: FrameTruth
) -> tuple[Score, float]:
    began = time.process_time()
    seen = front_end.examine(frame)
    ms = 1e3 * (time.process_time() - began)
    return score_frame(frame, truth, seen), ms


def front_end_figures(measured: Measured) -> list[Figure]:
    """Return every figure beside its target.

    Of what the chosen lights do not show nothing is said.
    """
    normal = pooled([s for n, s in measured.by_light.items() if n in NORMAL_LIGHT])
    every = pooled([*measured.by_light.values(), measured.hard_pitch])
    figures = _speed(measured)
    for (near, far), target in zip(RANGES_M, RECALL_TARGETS, strict=True):
        name = f"recall at {near:g} to {far:g} m, normal light"
        figures.append(_at_least(name, normal.recall(near, far), target))
    figures.append(_at_least("precision, normal light", normal.precision, 0.95))
    for at, limit in RMSE_AT:
        rmse = normal.rmse_m(at - RMSE_HALF_BIN_M, at + RMSE_HALF_BIN_M)
        name = f"position RMSE at {at:g} m, in m"
        figures.append(_figure(name, f"≤ {limit:g}", rmse, rmse <= limit))
    distance = np.hypot(*every.error_m.T)
    worst = float(np.percentile(distance, 95)) if len(distance) else float("nan")
    figures.append(_figure("position, 95th percentile, no gate, in m", "", worst, None))
    figures.append(
        _at_least("precision, 1 degree of pitch", measured.hard_pitch.precision, 0.93)
    )
    for near, far in RANGES_M:
        nis = normal.nis_per_dof(near, far)
        name = f"NIS per degree of freedom, {near:g} to {far:g} m"
        figures.append(_figure(name, "0.7 to 1.4", nis, 0.7 <= nis <= 1.4))
    right = every.colour_right
    share = float(right.mean()) if len(right) else float("nan")
    figures.append(_figure("class right", "", share, None))
    for light, score in measured.by_light.items():
        figures.append(_by_light(light, score))
    figures.append(_by_light("thesis profile", measured.thesis))
    return figures


def _speed(measured: Measured) -> list[Figure]:
    default, thesis = (
        float(np.median(ms)) if ms else float("nan")
        for ms in (measured.default_ms, measured.thesis_ms)
    )
    rate, ratio = 1e3 / default, thesis / default
    return [
        _figure("frames/s on one core, 640x480", "≥ 100", rate, rate >= 100),
        _figure("times the thesis profile's speed", "≥ 20", ratio, ratio >= 20),
    ]


def _by_light(name: str, score: Score) -> Figure:
    recall = [score.recall(near, far) for near, far in RANGES_M]
    said = ", ".join(f"{value:.3f}" for value in recall)
    values = dict(zip(("near", "middle", "far"), recall, strict=True))
    return Figure(
        f"{name}: recall near, middle, far; precision",
        "",
        f"{said}; {score.precision:.3f}",
        None,
        {**values, "precision": score.precision},
    )


def _at_least(name: str, value: float, least: float) -> Figure:
    return _figure(name, f"≥ {least:g}", value, value >= least)


def _figure(name: str, target: str, value: float, met: bool | None) -> Figure:
    if np.isnan(value):
        return not_measured(name, target)
    return Figure(name, target, f"{value:.3f}", met, {"value": value})
