"""Drawing a map and a path over the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from conegraph.eval.document import Picture
from conegraph.eval.drawing import LETTERS_PT, WIDTH_IN, Margins, new_axes, svg_text
from conegraph.eval.matching import Matching, match_cones
from conegraph.eval.series import PlacedMap
from conegraph.types import Array, ConeClass

CONE_COLOUR: dict[ConeClass, str] = {
    ConeClass.BLUE: "#1f5fbf",
    ConeClass.YELLOW: "#d9a800",
    ConeClass.ORANGE: "#f07818",
    ConeClass.BIG_ORANGE: "#b84800",
    ConeClass.UNKNOWN: "#808080",
}
TRUTH_COLOUR = "#9a9a9a"
PATH_COLOUR = "#2a2a2a"
ERROR_COLOUR = "#d0006f"
STRETCHES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
LABELS_IN = 0.5
HEIGHT_IN = 3.2
"""All maps are as tall, so that they can be compared beside each other."""

MARGIN_M = 4.0
LONGEST = 0.1
"""Of the picture's width; longer error lines are cut, or they hide the map."""

KEY = (
    "Each map is turned and shifted to fit the truth best. Rings are true cones, dots "
    "the map; the grey line is the true path, the black one the path while driving. "
    "Magenta lines are the errors of the map, enlarged as stated and cut at a tenth of "
    "the picture; crosses are missed cones, plus signs cones that are not there, "
    "squares duplicates. Axes in metres."
)


def draw_overlays(
    maps: Mapping[str, PlacedMap],
    titles: Mapping[str, str],
    *,
    about: Mapping[str, str] | None = None,
    prefix: str = "map",
) -> tuple[Picture, ...]:
    """Draw maps over the truth, with errors stretched alike so that they compare.

    The view follows the truth, so that a map that ran away does not shrink the
    track to a dot. The same maps give the same pictures.

    Args:
        maps: by name.
        titles: what to write under each.
        about: what else to say of some.
        prefix: of the pictures' names, unique in the page.
    """
    fits = sorted(_stretch(placed) for placed in maps.values())
    stretch = fits[(len(fits) - 1) // 2] if fits else 1
    said = about or {}
    return tuple(
        Picture(
            f"{prefix}-{i}", titles[name], f"{said.get(name, '')} {see}".strip(), svg
        )
        for i, (name, placed) in enumerate(maps.items(), 1)
        for svg, see in [_draw(placed, f"{prefix}-{i}", stretch)]
    )


def _draw(placed: PlacedMap, name: str, stretch: int) -> tuple[str, str]:
    """Return the drawing of one map, and what is wrong with it in words."""
    low, high = _view(placed)
    figure, axes = _axes()
    if placed.true_path_m is not None:
        axes.plot(*placed.true_path_m.T, color=TRUTH_COLOUR, lw=2.5)
    axes.plot(*placed.path_m.T, color=PATH_COLOUR, lw=0.8)
    for cone_class in np.unique(placed.cone_class).tolist():
        cones = placed.xy_m[placed.cone_class == cone_class]
        colour = CONE_COLOUR[ConeClass(cone_class)]
        _mark(axes, cones, s=9, lw=0, c=colour, zorder=3)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    matching = _matching(placed)
    if matching is not None and placed.true_xy_m is not None:
        _draw_truth(axes, placed, placed.true_xy_m, matching, stretch)
    outside = int(((placed.xy_m < low) | (placed.xy_m > high)).any(axis=1).sum())
    return svg_text(figure, name), _see(matching, stretch, outside)


def _see(matching: Matching | None, stretch: int, outside: int) -> str:
    parts = []
    if matching is not None:
        missed, false = len(matching.missed), len(matching.false)
        parts = [
            f"errors {stretch} times enlarged",
            f"{missed} missed",
            f"{false} not there",
            f"{len(matching.duplicate)} duplicates",
        ]
    if outside:
        parts.append(f"{outside} cone{'s' if outside > 1 else ''} outside")
    return f"{', '.join(parts)}.".capitalize() if parts else "No true map to compare."


def _axes() -> tuple[Figure, Axes]:
    """Return a figure and its axes, which hold what `_view` returns."""
    margins = Margins(
        0.8 * LABELS_IN, 0.2 * LABELS_IN, 0.6 * LABELS_IN, 0.4 * LABELS_IN
    )
    figure, axes = new_axes("", "", margins, height_in=HEIGHT_IN)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=LETTERS_PT - 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    return figure, axes


def _view(placed: PlacedMap) -> tuple[Array, Array]:
    """Return the lower left and upper right corner of what is shown, in the truth."""
    known = [p for p in (placed.true_xy_m, placed.true_path_m) if p is not None]
    points = np.concatenate(known or [placed.xy_m, placed.path_m])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        points = np.zeros((1, 2))
    low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    frame = np.array([WIDTH_IN, HEIGHT_IN]) - LABELS_IN
    half = 0.5 * frame * np.max((high - low) / frame)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def _matching(placed: PlacedMap) -> Matching | None:
    if placed.true_xy_m is None:
        return None
    finite = np.isfinite(placed.xy_m)
    # What is not finite is nowhere, so it is near no true cone.
    return match_cones(np.where(finite, placed.xy_m, 1e12), placed.true_xy_m)


def _draw_truth(
    axes: Axes, placed: PlacedMap, truth_xy_m: Array, matching: Matching, stretch: int
) -> None:
    """Draw true cones, what is wrong with the map, and stretched error vectors."""
    hollow = {"facecolors": "none"}
    classes = placed.true_class
    if classes is None:
        classes = np.full(len(truth_xy_m), ConeClass.UNKNOWN.value)
    for cone_class in np.unique(classes).tolist():
        edge = CONE_COLOUR[ConeClass(cone_class)]
        xy = truth_xy_m[classes == cone_class]
        _mark(axes, xy, s=34, lw=0.7, edgecolors=edge, **hollow)
    cones = placed.xy_m
    _mark(axes, truth_xy_m[matching.missed], s=60, c=ERROR_COLOUR, marker="x")
    _mark(axes, cones[matching.false], s=40, c="black", marker="+")
    _mark(axes, cones[matching.duplicate], s=60, ec="black", marker="s", **hollow)
    start = truth_xy_m[matching.truth]
    error = stretch * (cones[matching.estimate] - start)
    length = np.hypot(*error.T)
    longest = LONGEST * np.ptp(axes.get_xlim())
    error *= np.minimum(1.0, longest / np.maximum(length, longest))[:, None]
    lines = np.stack([start, start + error], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=ERROR_COLOUR, lw=1.1))


def _mark(axes: Axes, xy_m: Array, **style: Any) -> None:
    axes.scatter(xy_m[:, 0], xy_m[:, 1], **style)


def _stretch(placed: PlacedMap) -> int:
    """Return the factor that makes the larger errors about a fortieth of the view."""
    matching = _matching(placed)
    if matching is None or len(matching) == 0:
        return STRETCHES[-1]
    low, high = _view(placed)
    large = float(np.percentile(matching.distance_m, 90))
    fits = [k for k in STRETCHES if k * large <= float(np.max(high - low)) / 40.0]
    return max(fits, default=1)
