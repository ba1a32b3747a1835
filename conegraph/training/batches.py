"""Batches of crops: made up, rendered, or the user's own."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import count

import cv2
import numpy as np

from conegraph.training.collage import make_collages
from conegraph.training.palette import Sheets, make_sheets
from conegraph.training.photometric import photographed
from conegraph.training.sample import Sample, crop

STEPS_A_ROUND = 24
COLLAGES, CROPS = 3, 6
"""Collages of each place, and crops of each collage."""
KEPT_SHARE = 0.2
"""Share of the crops that are cut from pictures that are kept, if there are any."""


@dataclass(frozen=True, slots=True)
class Crops:
    """The crops of rounds of `STEPS_A_ROUND` batches.

    Attributes:
        seed: makes everything random; a round depends on its number and what is here.
        batch: crops of a batch.
        side_px: width and height of a crop.
        kept: pictures to cut some of the crops from.
        jobs: processes that make collages while the last round is learned; with none,
            this one makes them.
    """

    seed: int
    batch: int
    side_px: int
    kept: Sequence[Sample]
    jobs: int

    def rounds(self, first: int) -> Iterator[list[list[Sample]]]:
        """Yield the batches of round ``first`` and of all rounds after it, for ever."""
        if not self.jobs:
            for number in count(first):
                places = [
                    made_up(self.seed, place, self.side_px)
                    for place in self._places(number)
                ]
                yield self._round(number, places)
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(
            self.jobs, context, initializer=cv2.setNumThreads, initargs=(1,)
        )
        try:
            waiting = self._ordered(pool, first)
            for number in count(first):
                coming = self._ordered(pool, number + 1)
                yield self._round(number, [place.result() for place in waiting])
                waiting = coming
        finally:
            pool.shutdown(cancel_futures=True)

    def _ordered(
        self, pool: ProcessPoolExecutor, number: int
    ) -> list[Future[list[Sample]]]:
        return [
            pool.submit(made_up, self.seed, place, self.side_px)
            for place in self._places(number)
        ]

    def _places(self, number: int) -> range:
        wanted = self.batch * STEPS_A_ROUND / (COLLAGES * CROPS)
        places = round((1 - KEPT_SHARE) * wanted) if self.kept else math.ceil(wanted)
        return range(number * places, (number + 1) * places)

    def _round(self, number: int, places: list[list[Sample]]) -> list[list[Sample]]:
        rng = np.random.default_rng([self.seed, 1, number])
        crops = [sample for place in places for sample in place]
        wanted = self.batch * STEPS_A_ROUND
        while len(crops) < wanted:
            kept = self.kept[int(rng.integers(len(self.kept)))]
            crops.append(cut_out(kept, self.side_px, rng))
        order = rng.permutation(len(crops))[:wanted].tolist()
        return [
            [crops[k] for k in order[start : start + self.batch]]
            for start in range(0, wanted, self.batch)
        ]


def made_up(seed: int, number: int, side_px: int) -> list[Sample]:
    """Return the crops of all collages of one place."""
    rng = np.random.default_rng([seed, 0, number])
    collages = make_collages(COLLAGES, _sheets(), rng)
    return [
        cut_out(collage, side_px, rng) for collage in collages for _ in range(CROPS)
    ]


def cut_out(sample: Sample, side_px: int, rng: np.random.Generator) -> Sample:
    """Return a piece as another camera would show it."""
    piece = crop(sample, side_px, rng)
    return Sample(photographed(piece.picture, rng), piece.box_px, piece.kind)


@lru_cache(maxsize=1)
def _sheets() -> Sheets:
    return make_sheets(np.random.default_rng(0))
