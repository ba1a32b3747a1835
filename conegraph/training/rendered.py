"""Pictures of our renderer with their boxes, to train on and to test with."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import partial

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount
from conegraph.sim.render import (
    CarState,
    FrameTruth,
    Rig,
    StereoDepth,
    draw_light,
    make_scene,
    render_frame,
)
from conegraph.training.collage import CLASSES, LEAST_VISIBLE
from conegraph.training.sample import IGNORED, Sample, clipped
from conegraph.types import TruthMap

FRAMES_A_SCENE = 24
WIDTH_PX, HEIGHT_PX = 640, 480
SPACE_M = 28.0


def render_scenes(
    seed: int, scenes: int, jobs: int, done: Callable[[int], None]
) -> list[Sample]:
    """Return the pictures of several worlds; the same whatever the jobs.

    Args:
        seed: makes everything random.
        scenes: how many worlds.
        jobs: processes that render; with one or none, this one does.
        done: is told how many worlds are rendered.
    """
    found: list[Sample] = []
    render = partial(rendered_scene, seed)
    with ExitStack() as closing:
        every: Iterable[list[Sample]] = map(render, range(scenes))
        if jobs > 1:
            context = multiprocessing.get_context("spawn")
            pool = closing.enter_context(ProcessPoolExecutor(jobs, context))
            every = pool.map(render, range(scenes))
        for count, pictures in enumerate(every, 1):
            found += pictures
            done(count)
    return found


def rendered_scene(seed: int, index: int) -> list[Sample]:
    """Return the pictures of one world, from random places by random cameras."""
    rng = np.random.default_rng([seed, index])
    cones = _cones(rng)
    scene = make_scene(cones, rng, light=draw_light(rng))
    found: list[Sample] = []
    while len(found) < FRAMES_A_SCENE:
        pose = np.append(rng.uniform(-SPACE_M, SPACE_M, 2), rng.uniform(-np.pi, np.pi))
        if np.hypot(*(cones.xy_m - pose[:2]).T).min() < 1.0:
            continue
        car = CarState(
            0.0, rng.uniform(0, 14), rng.normal(0, 0.5), rng.normal(0, 0.01), 0.0
        )
        frame, truth = render_frame(scene, pose, rng, rig=_rig(rng), car=car)
        if len(truth):
            found.append(as_sample(frame.color, truth))
    return found


def as_sample(
    picture: NDArray[np.uint8], truth: FrameTruth, max_range_m: float = np.inf
) -> Sample:
    """Return a rendered picture with the boxes of its cones; far ones are ignored."""
    rows, columns = picture.shape[:2]
    number = np.full(len(CLASSES) + 1, IGNORED)
    number[[int(c) for c in CLASSES]] = np.arange(len(CLASSES))
    kind = number[truth.cone_class]
    near = np.hypot(*truth.xy_m.T) <= max_range_m
    asked = near & (truth.visible_fraction >= LEAST_VISIBLE)
    kind = np.where(asked, kind, IGNORED)
    seen = truth.visible_px > 0
    box, kind = clipped(truth.box_px[seen] + 0.5, kind[seen], columns, rows)
    return Sample(picture, box, kind)


def _cones(rng: np.random.Generator) -> TruthMap:
    """Return a crooked lane, and cones strewn around it."""
    step = rng.uniform(2.0, 5.0)
    count = int(2.0 * SPACE_M / step)
    heading = np.cumsum(rng.normal(0, 0.2, count)) + rng.uniform(-np.pi, np.pi)
    middle = np.cumsum(
        step * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0
    )
    middle -= middle.mean(axis=0)
    normal = np.column_stack([-np.sin(heading), np.cos(heading)])
    half = rng.uniform(1.5, 2.5)
    strewn = rng.uniform(-SPACE_M, SPACE_M, (40, 2))
    near_start = np.vstack(
        [middle[:2] + 1.2 * half * normal[:2], middle[:2] - 1.2 * half * normal[:2]]
    )
    xy = np.vstack([middle + half * normal, middle - half * normal, near_start, strewn])
    kinds = rng.integers(0, len(CLASSES), len(strewn))
    cone_class = np.concatenate(
        [np.full(count, 0), np.full(count, 1), np.full(len(near_start), 3), kinds]
    )
    gap = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    alone = ~np.triu(gap < 0.4, 1).any(axis=0)
    number = np.array([int(c) for c in CLASSES])[cone_class[alone]]
    return TruthMap(np.arange(int(alone.sum())), xy[alone], number)


def _rig(rng: np.random.Generator) -> Rig:
    fov = np.radians(rng.uniform(50.0, 95.0))
    focal = 0.5 * WIDTH_PX / np.tan(0.5 * fov)
    barrel = rng.uniform(-0.12, 0.02)
    camera = Camera(
        WIDTH_PX,
        HEIGHT_PX,
        focal,
        focal,
        0.5 * WIDTH_PX + rng.normal(0, 5),
        0.5 * HEIGHT_PX + rng.normal(0, 5),
        (barrel, 0.02, 0.0, 0.0, 0.0),
    )
    mount = CameraMount(
        height_m=rng.uniform(0.4, 1.4), pitch_rad=np.radians(rng.uniform(0.0, 14.0))
    )
    return Rig(camera, mount, StereoDepth())
