"""The learned detector on real photographs whose cones are boxed by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conegraph.bench.figure import Figure
from conegraph.bench.frontend_photos import Photo, plain_class, read_photos
from conegraph.bench.frontend_score import MIN_OVERLAP, match_boxes
from conegraph.frontend.base import Candidates, Detector
from conegraph.training.average_precision import overlaps
from conegraph.types import Array, IntArray, Mask

MIN_HEIGHT_PX = 16.0
STRICT_OVERLAP = 0.5
MIN_PRECISION, MIN_RECALL, MIN_COLOUR = 0.80, 0.75, 0.95


def photo_figures(folder: Path, detector: Detector) -> list[Figure]:
    """Return precision, recall and colours right on the photographs of a folder.

    Asked for are cones that are `MIN_HEIGHT_PX` high; what is found of lower ones, or
    is lower itself, is neither right nor wrong.
    """
    rows = [
        _judged(photo, detector.find(photo.picture)) for photo in read_photos(folder)
    ]
    asked = sum(int(tall.sum()) for tall, *_ in rows)
    found = sum(int(counted.sum()) for _, counted, *_ in rows)
    overlap = np.concatenate([row[2] for row in rows])
    colour = np.concatenate([row[3] for row in rows])
    name = f"{len(rows)} photographs, {asked} cones ≥ {MIN_HEIGHT_PX:g} px high"
    told = float(colour.mean()) if len(colour) else float("nan")
    figures = [
        _shares(f"{name}: precision, recall (overlap ≥ {least:g})", hits, found, asked)
        for least in (MIN_OVERLAP, STRICT_OVERLAP)
        for hits in [int((overlap >= least).sum())]
    ]
    right = Figure(
        "colour right of those found",
        f"≥ {MIN_COLOUR}",
        f"{told:.3f}",
        told >= MIN_COLOUR,
        {"value": told},
    )
    return [*figures, right]


def _shares(name: str, hits: int, found: int, asked: int) -> Figure:
    precision, recall = hits / max(found, 1), hits / max(asked, 1)
    return Figure(
        name,
        f"≥ {MIN_PRECISION}, ≥ {MIN_RECALL}",
        f"{precision:.3f}, {recall:.3f}",
        precision >= MIN_PRECISION and recall >= MIN_RECALL,
        {"precision": precision, "recall": recall},
    )


def _judged(photo: Photo, seen: Candidates) -> tuple[Mask, Mask, Array, Mask]:
    """Compare what was found with the labels.

    Returns:
        Which labels (T,) are asked for, which detections (N,) count, and of the
        labels that were found the overlap (K,) and whether the colour is right (K,).
    """
    tall = _height(photo.box_px) >= MIN_HEIGHT_PX
    pairs = match_boxes(seen.box_px, photo.box_px)
    counted = _height(seen.box_px) >= MIN_HEIGHT_PX
    counted[pairs[:, 0]] = tall[pairs[:, 1]]
    wanted = pairs[tall[pairs[:, 1]]]
    share = overlaps(seen.box_px, photo.box_px)[wanted[:, 0], wanted[:, 1]]
    kind: IntArray = plain_class(seen.class_prob[wanted[:, 0]])
    return tall, counted, share, kind == photo.cone_class[wanted[:, 1]]


def _height(box_px: Array) -> Array:
    height: Array = box_px[:, 3] - box_px[:, 1]
    return height
