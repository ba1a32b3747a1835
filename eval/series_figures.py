"""What happened along the way, drawn for one run or for many of each contender."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from conegraph.eval.consistency import POSE_DOF, nees_bounds
from conegraph.eval.document import Picture
from conegraph.eval.drawing import (
    GOOD_COLOUR,
    Margins,
    Stroke,
    legend_above,
    new_axes,
    plain_decades,
    strokes,
    svg_text,
)
from conegraph.eval.series import RunSeries
from conegraph.types import Array

GRID = 150
"""Places along the way at which runs are put beside each other."""

LEAST_ERROR_M = 1e-3
"""Errors below a millimetre are drawn as one: a logarithm has no zero."""

LEAST_NEES = 1e-2

Runs = Mapping[str, Sequence[RunSeries]]


def error_over_distance(
    runs: Runs, name: str = "error-over-distance", about: str = ""
) -> Picture | None:
    """Draw the position error of the causal path, None where no run has any.

    Args:
        runs: the runs of each contender.
        name: of the picture, unique in the page.
        about: which runs these are, for the title.
    """
    figure, axes = new_axes(
        "distance driven [m]", "position error [m]", Margins.below_legend(_drawn(runs))
    )
    drawn = _bands(
        axes,
        runs,
        lambda run: (run.distance_m, run.position_error_m.clip(LEAST_ERROR_M)),
    )
    if not drawn:
        return None
    axes.set_yscale("log")
    plain_decades(axes.yaxis)
    legend_above(axes)
    see = (
        "Truth and estimate start from one pose. A line that climbs is drift; a fall "
        "is a closed loop. After the first lap it "
        "should stay level." + _band_words(runs)
    )
    title = f"Error while driving{about}"
    return Picture(name, title, see, svg_text(figure, name))


def nees_over_time(
    runs: Runs, name: str = "nees-over-time", about: str = ""
) -> Picture | None:
    """Draw NEES of the causal pose beside its bounds; arguments as above."""
    figure, axes = new_axes(
        "time [s]", "NEES per dof", Margins.below_legend(_drawn(runs) + 1)
    )
    drawn = _bands(
        axes,
        runs,
        lambda run: (run.stamp_s, (run.nees / POSE_DOF).clip(LEAST_NEES)),
        centre=np.nanmean,
    )
    if not drawn:
        return None
    counts = [len(of_one) for of_one in runs.values() if of_one]
    # The widest band, that of the fewest runs: a line of more should lie well inside.
    low, high = nees_bounds(POSE_DOF, min(counts))
    axes.axhspan(low, high, color=GOOD_COLOUR, zorder=0, label="95 % of χ²")
    axes.set_yscale("log")
    plain_decades(axes.yaxis)
    legend_above(axes)
    mean = max(counts) > 1
    line = "Each line is the mean over runs" if mean else "Each line is one run"
    see = (
        f"{line}. Inside the grey band ({low:.2f} to {high:.2f}) its covariances are "
        "as large as its errors. Above, the back end is too sure of itself; below, too "
        "cautious." + _band_words(runs)
    )
    title = f"Is the pose's covariance honest? NEES over time{about}"
    return Picture(name, title, see, svg_text(figure, name))


def latency_histogram(
    runs: Runs, name: str = "latency", about: str = ""
) -> Picture | None:
    """Draw how long frames took; arguments as above."""
    figure, axes = new_axes(
        "time per frame [ms]", "share of frames [%]", Margins.below_legend(_drawn(runs))
    )
    shown: list[Array] = []
    for contender, stroke in strokes(tuple(runs)).items():
        of_one = [run for run in runs[contender] if run.frame_ms_counts.sum()]
        if not of_one:
            continue
        edges = of_one[0].frame_ms_edges
        counts = np.sum([run.frame_ms_counts for run in of_one], axis=0)
        share = 100.0 * counts / counts.sum()
        axes.stairs(share, edges, color=stroke.colour, ls=stroke.dashes, lw=1.6)
        axes.plot([], [], color=stroke.colour, ls=stroke.dashes, label=contender)
        shown.append(edges[np.flatnonzero(np.r_[counts, 0] + np.r_[0, counts])])
    if not shown:
        return None
    axes.set_xscale("log")
    plain_decades(axes.xaxis)
    every = np.concatenate(shown)
    axes.set_xlim(every.min() / 1.3, every.max() * 1.3)
    axes.set_ylim(bottom=0.0)
    legend_above(axes)
    see = "Farther left is faster; a long tail to the right is a frame that came late."
    title = f"Time per frame{about}"
    return Picture(name, title, see, svg_text(figure, name))


def latency_over_laps(
    runs: Runs, name: str = "latency-over-laps", about: str = ""
) -> Picture | None:
    """Draw how long the slowest frames of each lap took; arguments as above."""
    figure, axes = new_axes(
        "lap", "p99 of a frame [ms]", Margins.below_legend(_drawn(runs))
    )

    def lap_times(run: RunSeries) -> tuple[Array, Array]:
        return np.arange(1.0, len(run.lap_p99_ms) + 1.0), run.lap_p99_ms

    laps = max((len(r.lap_p99_ms) for of in runs.values() for r in of), default=0)
    grid = np.arange(1.0, laps + 1.0)
    if laps < 2 or not _bands(axes, runs, lap_times, grid=grid, marked=True):
        return None
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(0.7, laps + 0.3)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    legend_above(axes)
    see = (
        "A level line is a cost that does not grow with the length of the drive. One "
        "frame in a hundred took longer; the longest of all is said with the verdict."
        + _band_words(runs)
    )
    title = f"The slowest frames (99th percentile), lap by lap{about}"
    return Picture(name, title, see, svg_text(figure, name))


def _bands(
    axes: Axes,
    runs: Runs,
    curve: Callable[[RunSeries], tuple[Array, Array]],
    *,
    centre: Callable[..., Array] = np.nanmedian,
    grid: Array | None = None,
    marked: bool = False,
) -> bool:
    """Draw a line and a band for each contender; return whether there was any.

    The line is the centre over runs, the band holds the middle 80 % of them, as far
    as half of the runs go.
    """
    any_drawn = False
    for name, stroke in strokes(tuple(runs)).items():
        curves = [curve(run) for run in runs[name]]
        curves = [(x, y) for x, y in curves if np.isfinite(y).any()]
        if not curves:
            continue
        x = _common_grid(curves) if grid is None else grid
        y = np.stack([_resampled(x, *one) for one in curves])
        enough = np.isfinite(y).sum(axis=0) >= 0.5 * len(curves)
        _band(axes, x[enough], y[:, enough], centre, name, stroke, marked)
        any_drawn = True
    return any_drawn


def _band(
    axes: Axes,
    x: Array,
    y: Array,
    centre: Callable[..., Array],
    name: str,
    stroke: Stroke,
    marked: bool,
) -> None:
    if len(y) > 1:
        low, high = np.nanpercentile(y, (10, 90), axis=0)
        axes.fill_between(x, low, high, color=stroke.colour, alpha=0.18, lw=0)
    axes.plot(
        x,
        centre(y, axis=0),
        color=stroke.colour,
        ls=stroke.dashes,
        lw=1.8,
        marker=stroke.marker if marked else None,
        ms=5,
        label=name,
    )


def _common_grid(curves: Sequence[tuple[Array, Array]]) -> Array:
    """Return the x of a single run itself, of several an even grid."""
    if len(curves) == 1:
        return curves[0][0]
    return np.linspace(0.0, max(float(np.nanmax(x)) for x, _ in curves), GRID)


def _resampled(grid: Array, x: Array, y: Array) -> Array:
    """Return y (G,) at the grid, NaN outside of where it is known."""
    known = np.isfinite(x) & np.isfinite(y)
    return np.interp(grid, x[known], y[known], left=np.nan, right=np.nan)


def _drawn(runs: Runs) -> int:
    """Return how many contenders have a run to draw."""
    return sum(len(of_one) > 0 for of_one in runs.values())


def _band_words(runs: Runs) -> str:
    if all(len(of_one) == 1 for of_one in runs.values()):
        return ""
    counts = ", ".join(f"{name} {len(of_one)}" for name, of_one in runs.items())
    return f" The shade holds the middle 80 % of the runs ({counts})."
