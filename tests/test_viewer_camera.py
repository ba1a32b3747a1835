"""The camera's pictures are in the recording: as JPEG, with boxes, not too often."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from conegraph.camera import RgbdFrame
from conegraph.frontend.base import Detections
from conegraph.frontend.camera import plane_of_mount
from conegraph.frontend.ground import GroundPlane
from conegraph.sim.render import D435
from conegraph.types import ConeClass, ConeObservations
from conegraph.viewer import NullViewer, open_viewer, watch_camera
from conegraph.viewer_camera import cone_meshes, depth_picture


def frame_and_cones(stamp_s: float, n: int = 2) -> tuple[RgbdFrame, Detections]:
    color = np.full((480, 640, 3), 99, dtype=np.uint8)
    depth_m = np.full((480, 640), 5.0, dtype=np.float32)
    frame = RgbdFrame(stamp_s, color, depth_m, D435.camera, D435.mount)
    plane = GroundPlane(plane_of_mount(D435.mount), np.eye(3) * 1e-6, 0.004, True)
    cones = ConeObservations(
        stamp_s,
        np.array([[4.0, 1.0], [6.0, -1.0]])[:n],
        np.tile(0.01 * np.eye(2), (n, 1, 1)),
        np.eye(5)[[ConeClass.BLUE, ConeClass.BIG_ORANGE][:n]],
    )
    box = np.array([[100.0, 200, 120, 230], [300, 210, 310, 225]])[:n]
    seen = Detections(cones, box, np.ones(n), np.array([0.325, 0.505])[:n], plane)
    return frame, seen


def test_pictures_are_logged_at_most_so_often(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    viewers = open_viewer(["ekf"], live=False, path=path, map_period_s=0.5, camera=True)
    watch = watch_camera(viewers, period_s=0.2)
    assert watch is not None
    for step in range(11):
        watch(*frame_and_cones(10.0 + 0.05 * step, n=0 if step == 8 else 2))
    for viewer in viewers.values():
        viewer.close()
    rows: dict[str, int] = {}
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            path_name = str(chunk.entity_path)
            rows[path_name] = rows.get(path_name, 0) + chunk.num_rows
    for entity in ("lens/picture", "lens/cones", "depth", "cones", "doubt"):
        assert rows[f"/camera/{entity}"] == 3, entity
    assert path.stat().st_size < 3 * 640 * 480


def test_nobody_watches_where_nobody_looks() -> None:
    viewers = open_viewer(["ekf"], live=False, path=None, map_period_s=0.5, camera=True)
    assert isinstance(viewers["ekf"], NullViewer)
    assert watch_camera(viewers, period_s=0.2) is None


def test_cones_are_pyramids_on_their_feet() -> None:
    _, seen = frame_and_cones(0.0)
    classes = seen.observations.class_prob.argmax(axis=1)
    vertices, triangles, colours = cone_meshes(
        seen.observations.xy_m, seen.height_m, classes
    )
    assert vertices.shape == (10, 3)
    assert triangles.shape == (8, 3)
    assert vertices[[4, 9]].tolist() == [[4.0, 1.0, 0.325], [6.0, -1.0, 0.505]]
    assert np.ptp(vertices[:4, 0]) == pytest.approx(0.228)
    assert np.ptp(vertices[5:9, 0]) == pytest.approx(0.285)
    assert triangles.max() == 9
    assert len(set(colours.tolist())) == 2


def test_depth_is_painted_and_holes_stay_black() -> None:
    depth_m = np.array([[0.0, 1.0, 11.0]], dtype=np.float32)
    hole, near, far = depth_picture(depth_m)[0].tolist()
    assert hole == [0, 0, 0]
    assert near[2] > near[0]
    assert far[0] > far[2]
