"""What made-up pictures are painted with: noise, colours and words."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from conegraph.sim.render.paint import tile
from conegraph.training.view import Floats

SHEET_PX = 512
GREENS = np.array(
    [(92, 108, 58), (70, 92, 46), (126, 124, 76), (150, 138, 96), (60, 70, 44)],
    dtype=np.float32,
)
"""Grass in spring, summer, autumn; straw; trees."""
VIVID = np.array(
    [
        (235, 90, 30),
        (225, 50, 40),
        (250, 200, 40),
        (215, 235, 40),
        (35, 90, 190),
        (40, 150, 215),
        (30, 130, 70),
        (235, 235, 230),
        (40, 40, 44),
        (120, 40, 120),
    ],
    dtype=np.float32,
)
"""Colours of what people make: cones' own are among them on purpose."""


@dataclass(frozen=True, slots=True)
class Sheets:
    """Noise (S, S) that repeats, from fine to coarse, of mean 0."""

    fine: Floats
    rough: Floats
    soft: Floats


def make_sheets(rng: np.random.Generator) -> Sheets:
    """Return noise to cut pieces from."""
    fine, rough, soft = (tile(SHEET_PX, size, rng) for size in (2.0, 7.0, 40.0))
    return Sheets(fine, np.asarray(0.6 * rough + 0.4 * fine, np.float32), soft)


def vivid(rng: np.random.Generator) -> Floats:
    """Return a colour (3,) as people paint things."""
    color = VIVID[int(rng.integers(len(VIVID)))] * rng.uniform(0.6, 1.1)
    shown: Floats = np.clip(color + rng.normal(0, 12, 3), 0, 255)
    return shown


def write(part: Floats, ink: Floats, rng: np.random.Generator) -> None:
    """Write words over a part (h, w, 3) of a picture."""
    high, wide = part.shape[:2]
    word = "".join(rng.choice(list("ABCDEFGHIKLMNORSTUVX  0123456789"), 40))
    size = high / 30 * rng.uniform(0.3, 1.0)
    letters = np.zeros((high, wide), np.uint8)
    at = (int(rng.uniform(-0.2, 0.6) * wide), int(rng.uniform(0.6, 0.9) * high))
    cv2.putText(letters, word, at, 0, size, 255, max(int(3 * size), 1))
    part[letters > 127] = ink
