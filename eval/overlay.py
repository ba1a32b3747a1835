"""Drawing a map and a path over the truth, as SVG text."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from conegraph.eval.judge import RunMetrics, Truth
from conegraph.eval.matching import Matching, match_cones
from conegraph.geometry import compose, to_parent
from conegraph.io.run_folder import RunFolder
from conegraph.types import Array, ConeClass, IntArray, TruthMap

CONE_COLOUR: dict[ConeClass, str] = {
    ConeClass.BLUE: "#1f5fbf",
    ConeClass.YELLOW: "#e0b000",
    ConeClass.ORANGE: "#f07818",
    ConeClass.BIG_ORANGE: "#b84800",
    ConeClass.UNKNOWN: "#808080",
}
TRUTH_COLOUR = "#9a9a9a"
PATH_COLOUR = "#2a2a2a"
ERROR_COLOUR = "#d0006f"
STRETCHES = (1, 2, 5, 10, 20, 50, 100)
WIDTH_IN = 5.6
LABELS_IN = 0.6
MARGIN_M = 4.0


@dataclass(frozen=True, slots=True)
class Overlay:
    """A picture of one run.

    Attributes:
        svg: the drawing, an ``<svg>`` element.
        stretch: how many times its length each error vector is drawn; the same in
            all pictures of a report, so that they can be compared.
        outside: cones of the map that lie beyond the picture.
    """

    svg: str
    stretch: int
    outside: int


def draw_overlays(
    runs: Mapping[str, RunFolder], truth: Truth, metrics: Mapping[str, RunMetrics]
) -> dict[str, Overlay]:
    """Draw each run's map and path where they fit the truth best.

    The view follows the truth, so that a map that ran away does not shrink the
    track to a dot. The same runs give the same text.
    """
    stretch = min(
        (_stretch(run, truth, metrics[n]) for n, run in runs.items()), default=1
    )
    return {n: _draw(run, truth, metrics[n], stretch) for n, run in runs.items()}


def _draw(run: RunFolder, truth: Truth, metrics: RunMetrics, stretch: int) -> Overlay:
    pose = _placement(metrics)
    cones = to_parent(pose, run.cone_map.xy_m)
    path = compose(pose, run.trajectory.pose)[:, :2]
    low, high = _view(cones, path, truth)
    figure, axes = _axes(low, high)
    if truth.trajectory is not None:
        axes.plot(*truth.trajectory.pose[:, :2].T, color=TRUTH_COLOUR, lw=2.5)
    axes.plot(*path.T, color=PATH_COLOUR, lw=0.8)
    _mark(axes, cones, s=9, lw=0, c=_colours(run.cone_map.cone_class), zorder=3)
    if truth.cones is not None and metrics.map is not None:
        matching = match_cones(cones, truth.cones.xy_m, metrics.map.gate_m)
        _draw_truth(axes, cones, truth.cones, matching, stretch)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    outside = int(((cones < low) | (cones > high)).any(axis=1).sum())
    return Overlay(_svg(figure), stretch, outside)


def _axes(low: Array, high: Array) -> tuple[Figure, Axes]:
    """Return a figure and its axes, as tall as the view asks for."""
    size = high - low
    width = WIDTH_IN - LABELS_IN
    height = float(np.clip(width * size[1] / size[0], 0.5, 1.5 * width))
    total = height + LABELS_IN
    figure = Figure(figsize=(WIDTH_IN, total))
    FigureCanvasSVG(figure)
    left, bottom = 0.8 * LABELS_IN / WIDTH_IN, 0.6 * LABELS_IN / total
    axes = figure.add_axes((left, bottom, width / WIDTH_IN, height / total))
    axes.set_aspect("equal")
    axes.tick_params(labelsize=11)
    axes.grid(color="#ececec", lw=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _placement(metrics: RunMetrics) -> Array:
    if metrics.map is not None and metrics.map.matched > 1:
        return metrics.map.pose_truth_run
    if metrics.trajectory is not None:
        return metrics.trajectory.pose_truth_run
    return np.zeros(3)


def _view(cones: Array, path: Array, truth: Truth) -> tuple[Array, Array]:
    """Return the lower left and upper right corner of what is shown."""
    known = [] if truth.cones is None else [truth.cones.xy_m]
    known += [] if truth.trajectory is None else [truth.trajectory.pose[:, :2]]
    points = np.concatenate(known or [cones, path])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        points = np.zeros((1, 2))
    return points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M


def _draw_truth(
    axes: Axes, cones: Array, truth: TruthMap, matching: Matching, stretch: int
) -> None:
    """Draw true cones, what is wrong with the map, and stretched error vectors."""
    hollow = {"facecolors": "none"}
    _mark(
        axes, truth.xy_m, s=34, lw=0.7, edgecolors=_colours(truth.cone_class), **hollow
    )
    _mark(axes, truth.xy_m[matching.missed], s=60, c=ERROR_COLOUR, marker="x")
    _mark(axes, cones[matching.false], s=40, c="black", marker="+")
    _mark(axes, cones[matching.duplicate], s=60, ec="black", marker="s", **hollow)
    start = truth.xy_m[matching.truth]
    error = cones[matching.estimate] - start
    lines = np.stack([start, start + stretch * error], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=ERROR_COLOUR, lw=1.1))


def _mark(axes: Axes, xy_m: Array, **style: Any) -> None:
    axes.scatter(xy_m[:, 0], xy_m[:, 1], **style)


def _colours(classes: IntArray) -> list[str]:
    return [CONE_COLOUR[ConeClass(c)] for c in classes.tolist()]


def _stretch(run: RunFolder, truth: Truth, metrics: RunMetrics) -> int:
    """Return the factor that makes the larger errors about a fortieth of the view."""
    if truth.cones is None or metrics.map is None:
        return STRETCHES[-1]
    cones = to_parent(_placement(metrics), run.cone_map.xy_m)
    matching = match_cones(cones, truth.cones.xy_m, metrics.map.gate_m)
    if len(matching) == 0:
        return STRETCHES[-1]
    low, high = _view(cones, cones, truth)
    large = float(np.percentile(matching.distance_m, 90))
    fits = [k for k in STRETCHES if k * large <= float(np.max(high - low)) / 40.0]
    return max(fits, default=1)


def _svg(figure: Figure) -> str:
    text = io.StringIO()
    # Text stays text, and ids depend on nothing but the drawing.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "conegraph"}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    drawing = text.getvalue()
    # Names of groups would occur twice in a page with two drawings; nothing uses them.
    anonymous = re.sub(r'<g id="[^"]*"', "<g", drawing[drawing.index("<svg") :])
    return anonymous.rstrip()
