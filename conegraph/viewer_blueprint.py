"""What the recording looks like: colours, sizes, drawing order and layout."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from conegraph.types import ConeClass, MatchStatus, Status

CONE_COLORS = {
    ConeClass.BLUE: 0x3D8BFFFF,
    ConeClass.YELLOW: 0xFFD60AFF,
    ConeClass.ORANGE: 0xFF9A2EFF,
    ConeClass.BIG_ORANGE: 0xFF5A1FFF,
    ConeClass.UNKNOWN: 0xB0B0B0FF,
}
MATCH_COLORS = {
    MatchStatus.MATCHED: 0x5BD68DFF,
    MatchStatus.NEW: 0x4DD0E1FF,
    MatchStatus.TENTATIVE: 0x90A4AEFF,
    MatchStatus.AMBIGUOUS: 0xF06292FF,
    MatchStatus.REJECTED: 0xFF4D4DFF,
}
STATUS_COLORS = {
    Status.INIT: 0x5C6BC0FF,
    Status.OK: 0x3C9A5FFF,
    Status.DEGRADED: 0xC98A1BFF,
    Status.LOST: 0xC43C3CFF,
}
BACKEND_COLORS = (0x2EE6A6FF, 0xC792EAFF, 0xF78FB3FF, 0x8FD3F7FF)
STAGE_COLORS = (0x4DD0E1FF, 0xFFB74DFF, 0xBA68C8FF, 0xAED581FF, 0xF06292FF, 0x90A4AEFF)
WHITE, GREY, DARK_GREY = 0xFFFFFFFF, 0x8C8C8CFF, 0x4A4A4AFF
GREEN, RED = 0x5BD68DFF, 0xFF4D4DFF
ROAD, AHEAD = 0x2F4F4AFF, 0x7CE7FFFF

CAR_LENGTH_M = 3.0

MATCH_CODE = {status: code for code, status in enumerate(MatchStatus)}
"""The class id under which Rerun knows each `MatchStatus`."""

_LEGEND = """\
- **Dots** are cones in their colours, **outlines** their 3-sigma ellipses: the true
  cone lies inside with 98.9 % where the covariance is honest.
- **Grey** are the true cones and path, laid on the first estimated pose.
- The **coloured line** is the causal path, as known at each moment; the **white
  line** is the final, smoothed one.
- **Blue and yellow lines** are the boundaries of the track on the map so far, the
  triangles between them its road; the **light blue lane** is the one ahead of the car.
- **Rays** lead from the car to what it sees and on to the cone that it was taken
  for: green matched, cyan new, grey tentative, pink ambiguous, red rejected.
- **Green and red dots** are loop closures accepted and refused.
- **NIS / dof** is the squared innovation over its degrees of freedom: 95 % of it
  lies between the grey lines where the filter is consistent. **White** is the same
  over the last 5 s: above the **red** line the noise is assumed too small.
"""


def layout(backends: Sequence[str], *, camera: bool = False) -> rrb.Blueprint:
    """Return one layout with a column for each back end above what they share.

    With ``camera``, a column of what it sees comes first.
    """
    seen = [_camera_column()] if camera else []
    shares = [2] * len(seen) + [3] * len(backends)
    each = (_column(name) for name in backends)
    columns = rrb.Horizontal(*seen, *each, column_shares=shares)
    status = rrb.StateTimelineView(
        name="Status",
        contents=[f"/{name}/status" for name in backends],
        time_view=_whole_run(),
    )
    events = rrb.TextLogView(
        name="Events",
        contents=[f"/{name}/events" for name in backends],
        columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
    )
    legend = rrb.TextDocumentView(name="How to read this", origin="/legend")
    texts = rrb.Tabs(events, legend, active_tab=0)
    shared = rrb.Horizontal(status, texts)
    return rrb.Blueprint(
        rrb.Vertical(columns, shared, row_shares=[4, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="following"),
    )


def _camera_column() -> rrb.Container:
    picture = rrb.Spatial2DView(
        name="camera: cones found",
        origin="/camera/lens",
        contents=["/camera/lens/picture", "/camera/lens/cones"],
    )
    depth = rrb.Spatial2DView(name="camera: depth", origin="/camera/depth")
    space = rrb.Spatial3DView(
        name="cones on the ground, from the car",
        origin="/camera",
        contents=["/camera/cones", "/camera/doubt", "/camera/lens/picture"],
    )
    return rrb.Vertical(picture, depth, space)


def camera_parts() -> Iterator[tuple[str, rr.AsComponents]]:
    """Yield each path of the camera with its lasting look."""
    yield "camera", rr.ViewCoordinates.FLU
    yield "camera", _cone_classes()


def _column(name: str) -> rrb.Container:
    so_far = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline,
                start=rrb.TimeRangeBoundary.infinite(),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
            for timeline in ("time", "frame")
        ]
    )
    gathered = ("trajectory", "closures/accepted", "closures/refused")
    world = rrb.Spatial2DView(
        name=f"{name}: cones with 3-sigma ellipses",
        origin="/",
        contents=f"/{name}/**",
        overrides={f"/{name}/{path}": so_far for path in gathered},
    )
    nis = rrb.TimeSeriesView(
        name=f"{name}: NIS / dof and its 95 % band",
        origin=f"/{name}/nis",
        axis_x=_whole_run(),
        axis_y=rrb.ScalarAxis(range=(0.0, 4.0)),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    latency = rrb.TimeSeriesView(
        name=f"{name}: time per frame, ms",
        origin=f"/{name}/latency",
        axis_x=_whole_run(),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    plots = rrb.Horizontal(nis, latency)
    return rrb.Vertical(world, plots, row_shares=[3, 1])


def _whole_run() -> rrb.TimeAxis:
    ever = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=ever, end=ever))


def legend() -> rr.TextDocument:
    """Return the text that says what the colours and lines mean."""
    return rr.TextDocument(_LEGEND, media_type="text/markdown")


def static_parts(name: str, index: int) -> Iterator[tuple[str, rr.AsComponents]]:
    """Yield each path of back end number ``index`` with its lasting look.

    Rerun draws 2D scenes with y down: the root mirrors, so that the data keep y up.
    """
    color = BACKEND_COLORS[index % len(BACKEND_COLORS)]
    yield name, rr.Transform3D(mat3x3=np.diag([1.0, -1.0, 1.0]))
    yield f"{name}/truth/trajectory", _lines(1.0, 1, DARK_GREY)
    yield f"{name}/truth/cones", _points(5.5, 2, DARK_GREY)
    yield f"{name}/track/road", _lines(0.3, 3, ROAD)
    yield f"{name}/track/left", _lines(0.6, 4, CONE_COLORS[ConeClass.BLUE])
    yield f"{name}/track/right", _lines(0.6, 4, CONE_COLORS[ConeClass.YELLOW])
    yield f"{name}/track/centerline", _lines(0.5, 5, GREY)
    yield f"{name}/track/ahead/edges", _lines(1.0, 6, AHEAD)
    yield f"{name}/track/ahead/centerline", _lines(1.5, 12, AHEAD)
    yield f"{name}/smoothed", _lines(1.25, 10, WHITE)
    yield f"{name}/trajectory", _lines(0.6, 11, color)
    yield f"{name}/observations", _match_classes()
    yield f"{name}/observations/rays", _lines(0.4, 13)
    yield f"{name}/observations/cones", _points(1.5, 22)
    yield f"{name}/map", _cone_classes()
    yield f"{name}/map/ellipses", _lines(0.5, 20)
    yield f"{name}/map/cones", _points(3.0, 21)
    yield f"{name}/closures/accepted", _points(5.0, 30, GREEN)
    yield f"{name}/closures/refused", _points(3.0, 30, RED)
    yield f"{name}/lap", _points(4.0, 31, WHITE, labelled=True)
    yield f"{name}/car/body", _car()
    yield f"{name}/status", _status_classes()
    nis = ["NIS / dof", "95 % from", "95 % to", "over 5 s", "overconfident above"]
    yield f"{name}/nis", _series(nis, [color, GREY, GREY, WHITE, RED])


def latency_lines(stages: Sequence[str]) -> rr.SeriesLines:
    """Return the look of the latency plot; the stage ``frame`` is the whole."""
    colors = [STAGE_COLORS[i % len(STAGE_COLORS)] for i in range(len(stages))]
    whole = [WHITE if s == "frame" else c for s, c in zip(stages, colors, strict=True)]
    return _series(stages, whole)


def _points(
    radius_px: float, order: float, color: int | None = None, *, labelled: bool = False
) -> rr.Points2D:
    return rr.Points2D.from_fields(
        radii=rr.Radius.ui_points(radius_px),
        draw_order=order,
        colors=color,
        show_labels=labelled,
    )


def _lines(radius_px: float, order: float, color: int | None = None) -> rr.LineStrips2D:
    return rr.LineStrips2D.from_fields(
        radii=rr.Radius.ui_points(radius_px),
        draw_order=order,
        colors=color,
        show_labels=False,
    )


def _cone_classes() -> rr.AnnotationContext:
    return rr.AnnotationContext(
        [rr.AnnotationInfo(int(c), c.label, CONE_COLORS[c]) for c in ConeClass]
    )


def _match_classes() -> rr.AnnotationContext:
    return rr.AnnotationContext(
        [
            rr.AnnotationInfo(code, status.value, MATCH_COLORS[status])
            for status, code in MATCH_CODE.items()
        ]
    )


def _status_classes() -> rr.StateConfiguration:
    return rr.StateConfiguration(
        values=[s.value for s in STATUS_COLORS], colors=_rgba(STATUS_COLORS.values())
    )


def _car() -> rr.LineStrips2D:
    half_m, side_m = 0.5 * CAR_LENGTH_M, 0.25 * CAR_LENGTH_M
    rear_left, rear_right, nose = (-half_m, side_m), (-half_m, -side_m), (half_m, 0.0)
    return rr.LineStrips2D(
        [[rear_left, nose, rear_right, (-0.5 * half_m, 0.0), rear_left]],
        radii=rr.Radius.ui_points(1.0),
        colors=WHITE,
        draw_order=40.0,
    )


def _series(names: Sequence[str], colors: Sequence[int]) -> rr.SeriesLines:
    return rr.SeriesLines(names=list(names), colors=_rgba(colors), widths=1.0)


def _rgba(colors: Iterable[int]) -> NDArray[np.uint32]:
    """Return colours in the one form of a list that Rerun finds unambiguous."""
    return np.array(list(colors), dtype=np.uint32)
