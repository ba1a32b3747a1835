"""The recording holds what was sent, where and when; and nobody is disturbed by it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conegraph import geometry, viewer_stream
from conegraph.errors import FileFormatError, MissingDependencyError
from conegraph.types import (
    Associations,
    ConeMap,
    ConeObservations,
    Consistency,
    Estimate,
    FrameRecord,
    Lap,
    LoopClosure,
    MatchStatus,
    Recording,
    Status,
    Trajectory,
    TruthMap,
)
from conegraph.viewer import NullViewer, Viewer, open_viewer
from conegraph.viewer_rerun import align_truth, covariance_ellipses

START_S = 1000.0
PERIOD_S = 0.1
N_FRAMES = 12
STAMPS_S = START_S + PERIOD_S * np.arange(N_FRAMES, dtype=np.float64)
SPEED_MPS = 3.0
WORLD_IN_TRUTH = np.array([20.0, -5.0, 0.5 * np.pi])
"""Where the run's world lies in the truth's frame."""
MAP = ConeMap(
    np.array([7, 3]),
    np.array([[4.0, 1.5], [4.0, -1.5]]),
    np.array([np.diag([0.04, 0.01]), np.diag([0.01, 0.04])]),
    np.array([[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0]]),
    np.array([5, 5]),
)


def pose_at(frame: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The car drives straight, at a slight angle."""
    way_m = SPEED_MPS * PERIOD_S * frame
    return np.array([way_m * np.cos(0.1), way_m * np.sin(0.1), 0.1])


def record_at(frame: int) -> FrameRecord:
    """Both cones of the map seen exactly, a third observation rejected."""
    stamp_s = START_S + PERIOD_S * frame
    seen = geometry.to_child(pose_at(frame), np.vstack([MAP.xy_m, [2.0, 0.0]]))
    observations = ConeObservations(
        stamp_s, seen, np.tile(0.01 * np.eye(2), (3, 1, 1)), np.full((3, 5), 0.2)
    )
    status = (MatchStatus.MATCHED, MatchStatus.MATCHED, MatchStatus.REJECTED)
    ids = np.array([7, 3, -1])
    nis = float("nan") if frame == 0 else 6.0
    made = Associations(stamp_s, status, ids, np.zeros(3), nis, 4)
    state = Status.INIT if frame == 0 else Status.OK
    estimate = Estimate(stamp_s, pose_at(frame), np.eye(3), np.array([3.0, 0]), state)
    closures: tuple[LoopClosure, ...] = ()
    laps: tuple[Lap, ...] = ()
    if frame == 10:
        closures = (
            LoopClosure(stamp_s, 80.0, True, "four cones"),
            LoopClosure(stamp_s, 80.0, False, "too far"),
        )
        laps = (Lap(1, START_S, stamp_s),)
    stages = {"update": 0.5 + frame, "frame": 1.0 + frame}
    return FrameRecord(
        observations,
        made,
        estimate,
        "warming up",
        closures,
        laps,
        stages,
        Consistency(1.5, 1.25, overconfident=frame > 0),
    )


def source() -> Recording:
    poses = np.array([pose_at(k) for k in range(N_FRAMES)])
    return Recording(
        "a straight drive",
        (),
        truth_trajectory=Trajectory(STAMPS_S, geometry.compose(WORLD_IN_TRUTH, poses)),
        truth_map=TruthMap(
            MAP.id, geometry.to_parent(WORLD_IN_TRUTH, MAP.xy_m), MAP.cone_class
        ),
    )


def drive(viewer: Viewer) -> int:
    """Tell a viewer the whole drive; return how often it asked for the map."""
    asked = 0

    def cone_map() -> ConeMap:
        nonlocal asked
        asked += 1
        return MAP

    viewer.start(source())
    for frame in range(N_FRAMES):
        viewer.frame(record_at(frame), cone_map)
    smoothed = np.array([pose_at(k) for k in range(N_FRAMES)])
    viewer.finish(MAP, Trajectory(STAMPS_S, smoothed))
    viewer.close()
    return asked


class Rows:
    """The rows of a recording, by entity path, in the order of the frames."""

    def __init__(self, path: Path) -> None:
        import rerun as rr

        reader = rr.chunk.RrdReader(path)
        assert len(reader.blueprints()) == 1
        self.static: dict[str, list[dict[str, Any]]] = {}
        self.timed: dict[str, list[dict[str, Any]]] = {}
        for chunk in reader.stream():
            rows = self.static if chunk.is_static else self.timed
            found = rows.setdefault(chunk.entity_path, [])
            found += chunk.to_record_batch().to_pylist()
        for found in self.timed.values():
            found.sort(key=lambda row: int(row["frame"]))

    def column(self, entity: str, name: str) -> list[Any]:
        """A component of every frame."""
        return [row[name] for row in self.timed[entity]]

    def lasting(self, entity: str, name: str) -> Any:
        """The newest static value of a component."""
        return [row[name] for row in self.static[entity] if row.get(name)][-1]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    """Two back ends driven one after the other into one recording, read back."""
    path = tmp_path_factory.mktemp("viewer") / "run.rrd"
    viewers = open_viewer(["ekf", "isam2"], live=False, path=path, map_period_s=0.5)
    assert list(viewers) == ["ekf", "isam2"]
    assert drive(viewers["ekf"]) == 3
    assert drive(viewers["isam2"]) == 3
    return Rows(path)


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_every_entity_has_the_rows_that_were_sent(recorded: Rows, name: str) -> None:
    rows = {
        path.removeprefix(f"/{name}/"): len(found)
        for path, found in recorded.timed.items()
        if path.startswith(f"/{name}/")
    }
    assert rows == {
        "car": N_FRAMES,
        "trajectory": N_FRAMES - 1,
        "map/cones": 3 + 1,
        "map/ellipses": 3 + 1,
        **{f"track/{line}": 1 for line in ("left", "right", "road", "centerline")},
        "track/ahead/edges": N_FRAMES,
        "track/ahead/centerline": N_FRAMES,
        "observations/cones": N_FRAMES,
        "observations/rays": N_FRAMES,
        "closures/accepted": 1,
        "closures/refused": 1,
        "lap": 1,
        "status": 2,
        "events": 6,
        "nis": N_FRAMES - 1,
        "latency": N_FRAMES,
        "smoothed": 1,
    }


def test_time_is_seconds_since_the_first_stamp_beside_the_frame(recorded: Rows) -> None:
    assert recorded.column("/isam2/car", "frame") == list(range(N_FRAMES))
    seconds = [t.total_seconds() for t in recorded.column("/isam2/car", "time")]
    assert seconds == pytest.approx(PERIOD_S * np.arange(N_FRAMES), abs=1e-6)
    due = [t.total_seconds() for t in recorded.column("/ekf/map/cones", "time")]
    assert due == pytest.approx([0.0, 0.5, 1.0, 1.1], abs=1e-6)


def test_the_map_is_where_it_was_with_its_classes_and_ids(recorded: Rows) -> None:
    for found in recorded.timed["/ekf/map/cones"]:
        assert found["Points2D:positions"] == MAP.xy_m.tolist()
        assert found["Points2D:class_ids"] == [0, 1]
        assert found["Points2D:labels"] == ["7", "3"]
    outlines = np.array(recorded.column("/ekf/map/ellipses", "LineStrips2D:strips")[0])
    reach = np.abs(outlines - MAP.xy_m[:, None, :]).max(axis=1)
    assert reach == pytest.approx(np.array([[0.6, 0.3], [0.3, 0.6]]), abs=1e-5)


def test_the_view_mirrors_what_is_logged_with_y_up(recorded: Rows) -> None:
    columns = recorded.lasting("/ekf", "Transform3D:mat3x3")[0]
    assert columns == np.diag([1.0, -1.0, 1.0]).ravel().tolist()


def test_the_car_and_its_path_follow_the_estimate(recorded: Rows) -> None:
    poses = np.array([pose_at(k) for k in range(N_FRAMES)])
    at = np.array(recorded.column("/ekf/car", "Transform3D:translation"))[:, 0]
    assert at == pytest.approx(np.c_[poses[:, :2], np.zeros(N_FRAMES)], abs=1e-5)
    pieces = np.array(recorded.column("/ekf/trajectory", "LineStrips2D:strips"))[:, 0]
    assert pieces[:, 0] == pytest.approx(poses[:-1, :2], abs=1e-5)
    assert pieces[:, 1] == pytest.approx(poses[1:, :2], abs=1e-5)
    smoothed = recorded.column("/ekf/smoothed", "LineStrips2D:strips")[0][0]
    assert np.array(smoothed) == pytest.approx(poses[:, :2], abs=1e-5)


def test_rays_lead_from_the_car_to_what_it_sees_and_to_its_cone(recorded: Rows) -> None:
    rays = np.array(recorded.column("/ekf/observations/rays", "LineStrips2D:strips"))
    assert rays.shape == (N_FRAMES, 3, 3, 2)
    for frame, (first, second, third) in enumerate(rays):
        here = pose_at(frame)[:2]
        assert first == pytest.approx(np.array([here, *MAP.xy_m[[0, 0]]]), abs=1e-5)
        assert second == pytest.approx(np.array([here, *MAP.xy_m[[1, 1]]]), abs=1e-5)
        assert third == pytest.approx(np.array([here, [2, 0], [2, 0]]), abs=1e-5)
    codes = recorded.column("/ekf/observations/cones", "Points2D:class_ids")
    rejected = list(MatchStatus).index(MatchStatus.REJECTED)
    assert codes == [[0, 0, rejected]] * N_FRAMES


def test_truth_is_laid_on_the_first_estimate(recorded: Rows) -> None:
    poses = np.array([pose_at(k)[:2] for k in range(N_FRAMES)])
    path = recorded.lasting("/ekf/truth/trajectory", "LineStrips2D:strips")[0]
    assert np.array(path) == pytest.approx(poses, abs=1e-5)
    cones = recorded.lasting("/ekf/truth/cones", "Points2D:positions")
    assert np.array(cones) == pytest.approx(MAP.xy_m, abs=1e-5)


def test_plots_show_nis_over_dof_in_its_band_and_every_stage(recorded: Rows) -> None:
    # The 2.5 % and 97.5 % quantiles of chi-square with 4 degrees of freedom.
    band = [*np.array([6.0, 0.484419, 11.143287]) / 4, 1.5, 1.25]
    for values in recorded.column("/ekf/nis", "Scalars:scalars"):
        assert values == pytest.approx(band, abs=1e-6)
    assert recorded.lasting("/ekf/latency", "SeriesLines:names") == ["update", "frame"]
    latency = recorded.column("/ekf/latency", "Scalars:scalars")
    assert latency == [[0.5 + k, 1.0 + k] for k in range(N_FRAMES)]


def test_events_say_what_happened_and_to_whom(recorded: Rows) -> None:
    said = recorded.column("/isam2/events", "TextLog:text")
    assert [text[0] for text in said] == [
        "isam2: INIT: warming up",
        "isam2: OK: warming up",
        "isam2: warming up",
        "isam2: loop closure accepted after 80.0 m: four cones",
        "isam2: loop closure refused after 80.0 m: too far",
        "isam2: lap 1: 1.00 s",
    ]
    states = recorded.column("/isam2/status", "StateChange:state")
    assert states == [["INIT"], ["OK"]]


def test_a_stage_that_comes_later_gets_its_own_line(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    viewer = open_viewer(["ekf"], live=False, path=path, map_period_s=0.0)["ekf"]
    seen = record_at(1)
    for stages in ({"frame": 1.0}, {"graph": 2.0, "frame": 3.0}):
        record = FrameRecord(
            seen.observations, seen.associations, seen.estimate, stage_ms=stages
        )
        viewer.frame(record, ConeMap.empty)
    viewer.close()
    rows = Rows(path)
    assert rows.lasting("/ekf/latency", "SeriesLines:names") == ["frame", "graph"]
    assert rows.column("/ekf/latency", "Scalars:scalars") == [[1.0], [3.0, 2.0]]


def test_ellipses_lie_at_three_sigmas_whatever_the_direction() -> None:
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(50, 2, 2))
    cov = spread @ np.swapaxes(spread, 1, 2) + 1e-3 * np.eye(2)
    xy = rng.normal(size=(50, 2))
    offset = covariance_ellipses(xy, cov) - xy[:, None, :]
    d2 = np.einsum("nki,nij,nkj->nk", offset, np.linalg.inv(cov), offset)
    assert d2 == pytest.approx(np.full_like(d2, 9.0))


def test_truth_is_placed_between_its_samples_across_the_cut_of_yaw() -> None:
    poses = np.array([[0.0, 0.0, np.pi - 0.1], [2.0, 0.0, -np.pi + 0.1]])
    truth = Trajectory(np.array([0.0, 1.0]), poses)
    placed = align_truth(truth, 0.5, np.zeros(3))
    middle = np.array([1.0, 0.0, np.pi])
    assert geometry.compose(placed, middle) == pytest.approx(np.zeros(3), abs=1e-12)


def test_nobody_watching_costs_nothing() -> None:
    viewers = open_viewer(["ekf", "isam2"], live=False, path=None, map_period_s=0.5)
    assert all(isinstance(v, NullViewer) for v in viewers.values())
    assert drive(viewers["ekf"]) == 0


def test_importing_the_viewer_does_not_import_rerun() -> None:
    code = "import sys, conegraph.viewer; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_recording_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "run.rrd"
    with pytest.raises(FileFormatError) as caught:
        open_viewer(["ekf"], live=False, path=path, map_period_s=0.5)
    reason = "cannot write the recording: No such file or directory"
    assert str(caught.value) == f"{path}: {reason}"


def test_a_full_disk_is_refused_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer_stream, "MIN_FREE_BYTES", 2**62)
    with pytest.raises(FileFormatError, match=r"needs \d+ MB of free disk"):
        open_viewer(["ekf"], live=False, path=tmp_path / "x.rrd", map_period_s=0.5)


def test_a_disk_that_fills_up_ends_the_recording_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(viewer_stream, "FREE_CHECK_PERIOD_S", 0.0)
    path = tmp_path / "run.rrd"
    viewers = open_viewer(["ekf", "isam2"], live=False, path=path, map_period_s=0.5)
    viewers["ekf"].frame(record_at(0), lambda: MAP)
    monkeypatch.setattr(viewer_stream, "MIN_FREE_BYTES", 2**62)
    assert drive(viewers["isam2"]) == 0
    viewers["ekf"].frame(record_at(1), lambda: MAP)
    viewers["ekf"].close()
    assert len(caplog.records) == 1
    assert "the run goes on: the disk is nearly full" in caplog.text
    rows = Rows(path)
    assert rows.column("/ekf/car", "frame") == [0]
    assert "/isam2/car" not in rows.timed


def test_a_viewer_that_fails_warns_once_and_is_switched_off(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.rrd"
    viewer = open_viewer(["ekf"], live=False, path=path, map_period_s=0.5)["ekf"]
    good = record_at(0)
    short = Associations(START_S, (), np.zeros(0, dtype=np.int64), np.zeros(0))
    bad = FrameRecord(good.observations, short, good.estimate)
    viewer.frame(good, lambda: MAP)
    for _ in range(3):
        viewer.frame(bad, lambda: MAP)
    viewer.finish(MAP, None)
    viewer.close()
    assert len(caplog.records) == 1
    assert "viewer switched off, the run goes on: ValueError" in caplog.text
    assert Rows(path).column("/ekf/observations/rays", "frame") == [0]


def test_a_failing_back_end_is_not_hidden_by_the_viewer(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    viewer = open_viewer(["ekf"], live=False, path=path, map_period_s=0.5)["ekf"]

    def broken() -> ConeMap:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        viewer.frame(record_at(0), broken)
    viewer.close()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window would open")
def test_a_live_view_without_a_screen_is_one_clear_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for display in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(display, raising=False)
    monkeypatch.setattr(viewer_stream, "VIEWER_PORT", 20_000 + os.getpid() % 20_000)
    with pytest.raises(MissingDependencyError, match=r"did not start.*--save-rrd"):
        open_viewer(["ekf"], live=True, path=None, map_period_s=0.5)
