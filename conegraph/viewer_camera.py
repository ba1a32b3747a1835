"""The camera's part of the Rerun recording: pictures, boxes, depth, cones in 3D.

Pictures go as JPEG and no more often than asked: raw ones would be most of the
recording. What is found in them is logged with them, so that boxes fit the picture.
"""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from conegraph.camera import RgbdFrame
from conegraph.frontend.base import Detections
from conegraph.types import Array, ConeClass, IntArray
from conegraph.viewer_blueprint import CONE_COLORS
from conegraph.viewer_rerun import covariance_ellipses
from conegraph.viewer_stream import SharedStream

JPEG_QUALITY = 80
FARTHEST_SHOWN_M = 12.0
FOOT_M = {False: 0.228, True: 0.285}
"""Side of a cone's foot, by whether it is a big one."""
_CORNERS = np.array([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)])
_SIDES = np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])


class CameraViewer:
    """Logs what the camera sees and what the front end makes of it."""

    def __init__(self, stream: SharedStream, *, period_s: float) -> None:
        """Log into ``stream``, one picture each ``period_s`` of the stream's time."""
        self._stream = stream
        self._period_s = period_s
        self._due_s = -np.inf
        self._frame = -1

    def __call__(self, frame: RgbdFrame, seen: Detections) -> None:
        """Show a frame if one is due."""
        self._frame += 1
        if frame.stamp_s < self._due_s or not self._stream.is_on():
            return
        self._due_s = frame.stamp_s + self._period_s
        with self._stream.guarded():
            self._stream.set_time(frame.stamp_s, self._frame)
            self._log_lens(frame, seen)
            self._log_cones(seen)

    def _log(self, path: str, *parts: rr.AsComponents) -> None:
        self._stream.recording.log(f"camera/{path}", *parts)

    def _log_lens(self, frame: RgbdFrame, seen: Detections) -> None:
        lens, mount = frame.camera, seen.ground.mount(frame.mount)
        self._log(
            "lens",
            rr.Transform3D(
                translation=mount.position_m, mat3x3=mount.rotation_car_optical
            ),
            rr.Pinhole(
                image_from_camera=lens.matrix,
                resolution=[lens.width_px, lens.height_px],
                image_plane_distance=1.0,
            ),
        )
        picture = cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR)
        self._log("lens/picture", _jpeg(picture))
        # Rerun counts from the corner of a pixel, boxes here from its centre.
        low, high = np.hsplit(seen.box_px + 0.5, 2)
        classes = seen.observations.class_prob.argmax(axis=1)
        boxes = rr.Boxes2D(
            mins=low, sizes=high - low, class_ids=classes, show_labels=False
        )
        self._log("lens/cones", boxes)
        self._log("depth", _jpeg(depth_picture(frame.depth_m)))

    def _log_cones(self, seen: Detections) -> None:
        cones = seen.observations
        classes: IntArray = cones.class_prob.argmax(axis=1)
        vertices, triangles, colors = cone_meshes(cones.xy_m, seen.height_m, classes)
        if len(cones):
            mesh = rr.Mesh3D(
                vertex_positions=vertices,
                triangle_indices=triangles,
                vertex_colors=colors,
            )
            self._log("cones", mesh)
        else:
            self._log("cones", rr.Clear(recursive=False))
        flat = covariance_ellipses(cones.xy_m, cones.cov_m2)
        on_ground = np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2)
        self._log(
            "doubt", rr.LineStrips3D(on_ground, class_ids=classes, show_labels=False)
        )


def cone_meshes(
    xy_m: Array, height_m: Array, classes: IntArray
) -> tuple[Array, IntArray, NDArray[np.uint32]]:
    """Return pyramids as vertices (5 N, 3), triangles (4 N, 3) and colours (5 N,)."""
    n = len(xy_m)
    side = np.array([FOOT_M[c == ConeClass.BIG_ORANGE] for c in classes.tolist()])
    apex = np.column_stack([xy_m, height_m])[:, None, :]
    foot = _CORNERS * side.reshape(n, 1, 1)
    foot = foot + np.column_stack([xy_m, np.zeros(n)])[:, None, :]
    vertices = np.concatenate([foot, apex], axis=1).reshape(-1, 3)
    triangles = (_SIDES + 5 * np.arange(n)[:, None, None]).reshape(-1, 3)
    colors = [CONE_COLORS[ConeClass(c)] for c in classes.tolist()]
    return vertices, triangles, np.repeat(np.array(colors, dtype=np.uint32), 5)


def depth_picture(depth_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return depth (H, W) as a picture (H, W, 3), near red, far blue, none black."""
    near = np.clip(1.0 - depth_m / FARTHEST_SHOWN_M, 0.0, 1.0)
    shown = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_TURBO)
    painted = np.asarray(shown, dtype=np.uint8).copy()
    painted[depth_m <= 0] = 0
    return painted


def _jpeg(picture_bgr: cv2.typing.MatLike) -> rr.EncodedImage:
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    _, data = cv2.imencode(".jpg", picture_bgr, quality)
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")
