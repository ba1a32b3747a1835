"""The learned detector against its targets: unseen renders, dusk, speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from conegraph.bench.figure import Figure
from conegraph.bench.frontend_score import pooled, score_frame
from conegraph.camera import RgbdFrame
from conegraph.config import Config, YoloConfig, resolve_config
from conegraph.frontend import FrontEnd, make_front_end
from conegraph.frontend.ground import GroundTracker
from conegraph.frontend.scale import GroundScale
from conegraph.frontend.yolo import YoloDetector
from conegraph.sim.camera_drive import CameraDrive, drive_with_camera
from conegraph.sim.render import LIGHT_NAMES, FrameTruth
from conegraph.sim.track_shapes import built_in_track
from conegraph.training.collage import CLASSES
from conegraph.training.rendered import as_sample
from conegraph.training.report import (
    LEAST_SCORE,
    SIZES_PX,
    Precisions,
    as_boxes,
    judged,
    mean_known,
    precisions,
    true_boxes,
)

TRACKS = ("random", "skidpad", "random", "acceleration")
"""The second and the last have small orange cones."""
MIN_MEAN, MIN_CLASS = 0.93, 0.88
MIN_FPS = 50.0
DUSK_SHARE = 1 / 3
"""Of the renderer's dusk's light that the camera gets."""
DUSK_RANGE_M = 12.0
MIN_DUSK_RECALL, MAX_COLOUR_RECALL = 0.90, 0.40
WARM_UPS = 3

Shot = tuple[RgbdFrame, FrameTruth]
Done = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Shots:
    """Which drives are rendered, and how much of each.

    Attributes:
        seeds: one drive for each, over `TRACKS` and in the lights by turns.
        frames: pictures a drive, evenly spread over its lap.
    """

    seeds: tuple[int, ...]
    frames: int

    def __len__(self) -> int:
        return len(self.seeds) * self.frames

    def all_lights(self) -> list[Shot]:
        """Return the pictures of drives in the lights by turns."""
        return [
            shot
            for turn, seed in enumerate(self.seeds)
            for shot in self._of(_drive(seed, turn, turn + turn // len(TRACKS)))
        ]

    def dusk(self) -> list[Shot]:
        """Return the pictures of drives at dusk, with a third of its light."""
        dusk = LIGHT_NAMES.index("dusk")
        shots = [
            shot for seed in self.seeds for shot in self._of(_drive(seed, 0, dusk))
        ]
        return [(_darkened(frame), truth) for frame, truth in shots]

    def _of(self, drive: CameraDrive) -> Iterator[Shot]:
        for index in np.linspace(0, drive.n_frames - 1, self.frames).astype(int):
            yield drive.render(int(index))


def _drive(seed: int, track: int, light: int) -> CameraDrive:
    layout = built_in_track(TRACKS[track % len(TRACKS)], seed)
    name = LIGHT_NAMES[light % len(LIGHT_NAMES)]
    return drive_with_camera(layout, laps=1, seed=seed, light=name)


def _darkened(frame: RgbdFrame) -> RgbdFrame:
    dark = np.round(frame.color * DUSK_SHARE).astype(np.uint8)
    return replace(frame, color=dark)


def precision_figures(
    shots: list[Shot], config: Config, detector: YoloConfig, done: Done
) -> list[Figure]:
    """Return average precisions over renders: as the detector is used, and bare.

    In use the ground is known: what has not a cone's size is none, and orange cones
    are told apart by theirs. Alone, the network sees nothing but the picture.
    """
    found, real = [], []
    weak = detector.model_copy(update={"min_score": LEAST_SCORE})
    config = config.model_copy(update={"detector": weak})
    for count, (frame, truth) in enumerate(shots, 1):
        seen = make_front_end(config).examine(frame)
        prob = seen.observations.class_prob
        found.append(as_boxes(seen.box_px, prob, seen.score))
        asked = as_sample(frame.color, truth, detector.max_range_m - 1.0)
        real.append(true_boxes(asked))
        done(count)
    used = judged(found, real)
    samples = [as_sample(frame.color, truth) for frame, truth in shots]
    bare = precisions(detector, samples, lambda count: None)
    return [
        *_precisions(f"{len(shots)} unseen renders, with the ground", used),
        *_precisions("the same, the network alone", bare),
        *_by_size(bare),
    ]


def _precisions(name: str, found: Precisions) -> list[Figure]:
    worst = float(np.nanmin(found.by_class))
    names = [cone.label for cone in CLASSES]
    by_class = dict(zip(names, found.by_class, strict=True))
    text = ", ".join(f"{cone} {share:.3f}" for cone, share in by_class.items())
    return [
        Figure(
            f"{name}: mAP50",
            f"≥ {MIN_MEAN}",
            f"{found.mean:.3f}",
            found.mean >= MIN_MEAN,
            {"value": found.mean},
        ),
        Figure(
            f"{name}: each class's AP50",
            f"≥ {MIN_CLASS}",
            text,
            worst >= MIN_CLASS,
            by_class,
        ),
    ]


def _by_size(found: Precisions) -> Iterator[Figure]:
    for (low, high), shares in zip(SIZES_PX, found.by_size, strict=True):
        mean = mean_known(shares)
        name = f"the network alone, mAP50 of cones {low:g} to {high:g} px high"
        yield Figure(name, "", f"{mean:.3f}", None, {"value": mean})


def dusk_figures(shots: list[Shot], config: Config, done: Done) -> list[Figure]:
    """Return the recall at dusk of the learned detector and of the colour detector."""
    colour = resolve_config({"detector": {"kind": "hsv"}})
    recall = _recall(make_front_end(config), shots, done)
    plain = _recall(make_front_end(colour), shots, done)
    reach = f"recall to {DUSK_RANGE_M:g} m at dusk"
    return [
        Figure(
            reach,
            f"≥ {MIN_DUSK_RECALL}",
            f"{recall:.3f}",
            recall >= MIN_DUSK_RECALL,
            {"value": recall},
        ),
        Figure(
            f"{reach}, by colour alone",
            f"below {MAX_COLOUR_RECALL}",
            f"{plain:.3f}",
            plain < MAX_COLOUR_RECALL,
            {"value": plain},
        ),
    ]


def _recall(front_end: FrontEnd, shots: list[Shot], done: Done) -> float:
    scores = []
    for count, (frame, truth) in enumerate(shots, 1):
        scores.append(score_frame(frame, truth, front_end.examine(frame)))
        done(count)
    return pooled(scores).recall(0.0, DUSK_RANGE_M)


def speed_figure(shots: list[Shot], config: Config, detector: YoloConfig) -> Figure:
    """Return how many pictures one core turns into boxes in a second.

    Rows in which no cone can stand are cut away, as in a run. The processor's time
    counts, in which other programs on the machine do not.
    """
    finder = YoloDetector(detector)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    spent = []
    try:
        for frame, _ in shots:
            plane = GroundTracker(config.ground).update(frame).plane
            scale = GroundScale(frame.camera, plane)
            began = time.process_time()
            finder.find(frame.color, scale)
            spent.append(time.process_time() - began)
    finally:
        cv2.setNumThreads(threads)
    median = float(np.median(spent[WARM_UPS:]))
    shape = shots[0][0].color.shape
    return Figure(
        f"one core, {shape[1]} x {shape[0]} px to boxes, in pictures a second",
        f"≥ {MIN_FPS:g}",
        f"{1 / median:.0f} ({1e3 * median:.1f} ms)",
        1 / median >= MIN_FPS,
        {"value": 1 / median},
    )
