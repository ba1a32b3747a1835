"""From RealSense frames to ours: lens, colour, depth registered to colour."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.errors import ConegraphError, MissingDependencyError
from conegraph.types import Array

MISSING = "frames missing in the recording"
INCOMPLETE = "frames without colour or depth"
BACKWARDS = "frame before the last one"
APART = "frames whose colour and depth are of different times"
LIBUSB_HELP = (
    "the RealSense library cannot be loaded: install pyrealsense2, and libusb "
    "(Debian, Ubuntu: apt install libusb-1.0-0)"
)


def load_library() -> Any:
    """Return the module ``pyrealsense2``, which is imported here and nowhere else.

    Raises:
        MissingDependencyError: it is not installed, or libusb is missing.
    """
    try:
        import pyrealsense2
    except (ImportError, OSError) as error:
        raise MissingDependencyError(f"{LIBUSB_HELP}: {error}") from error
    return pyrealsense2


class FrameReader:
    """Turns framesets of one started pipeline into `RgbdFrame`.

    Args:
        profile: of the pipeline; must have a depth and a colour stream.
        mount: where the camera sits.

    Raises:
        ConegraphError: there is no colour or no depth stream.
    """

    def __init__(self, profile: Any, mount: CameraMount) -> None:
        """Read lens and units from the device."""
        rs = load_library()
        try:
            color = profile.get_stream(rs.stream.color).as_video_stream_profile()
            depth = profile.get_stream(rs.stream.depth).as_video_stream_profile()
        except RuntimeError as error:
            raise ConegraphError("no colour and depth streams together") from error
        self.camera = camera_of(color.get_intrinsics())
        self.period_s = 1.0 / max(1, min(int(color.fps()), int(depth.fps())))
        self._mount = mount
        self._align = None if registered(color, depth) else rs.align(rs.stream.color)

    def frame(self, frameset: Any) -> RgbdFrame | None:
        """Return the frame, None where colour or depth is missing."""
        both = frameset if self._align is None else self._align.process(frameset)
        color, depth = both.get_color_frame(), both.get_depth_frame()
        if not color or not depth:
            return None
        stored = np.asanyarray(depth.get_data())
        units = np.float32(depth.get_units())
        return RgbdFrame(
            float(color.get_timestamp()) / 1000.0,
            rgb_of(np.asanyarray(color.get_data()), color.get_profile().format()),
            stored.astype(np.float32) * units,
            self.camera,
            self._mount,
        )


def in_order(
    framesets: Iterator[Any], reader: FrameReader, left_out: Counter[str]
) -> Iterator[RgbdFrame]:
    """Yield frames whose time runs forward; count those that are not there.

    A camera numbers its pictures: a gap in the numbers is that many missing.
    """
    last_number, last_s = -1, float("-inf")
    for frameset in framesets:
        color = frameset.get_color_frame()
        number = int(color.get_frame_number()) if color else -1
        if number > last_number + 1 > 0:
            left_out[MISSING] += number - last_number - 1
        last_number = max(number, last_number)
        frame = reader.frame(frameset)
        if frame is None:
            left_out[INCOMPLETE] += 1
        elif _seconds_apart(frameset) > reader.period_s:
            left_out[APART] += 1
        elif frame.stamp_s <= last_s:
            left_out[BACKWARDS] += 1
        else:
            last_s = frame.stamp_s
            yield frame


def _seconds_apart(frameset: Any) -> float:
    """Return the time between colour and depth of a whole frameset."""
    color, depth = frameset.get_color_frame(), frameset.get_depth_frame()
    return abs(float(color.get_timestamp() - depth.get_timestamp())) / 1000.0


def registered(color: Any, depth: Any) -> bool:
    """Return whether depth is that of the colour pixels already."""
    one, other = color.get_intrinsics(), depth.get_intrinsics()
    moved = depth.get_extrinsics_to(color)
    still = np.allclose(moved.rotation, np.eye(3).ravel()) and not any(
        moved.translation
    )
    names = ("width", "height", "fx", "fy", "ppx", "ppy", "coeffs")
    return bool(still) and all(getattr(one, n) == getattr(other, n) for n in names)


def rgb_of(data: NDArray[Any], form: Any) -> NDArray[np.uint8]:
    """Return a copy of a colour picture as (H, W, 3) RGB.

    Args:
        data: the picture as the camera sends it.
        form: how it is laid out, an ``rs.format``.

    Raises:
        ConegraphError: the camera sends a format that is not read here.
    """
    import cv2

    rs = load_library()
    if form == rs.format.rgb8:
        return np.array(data, dtype=np.uint8)
    turns = {
        rs.format.bgr8: cv2.COLOR_BGR2RGB,
        rs.format.rgba8: cv2.COLOR_RGBA2RGB,
        rs.format.bgra8: cv2.COLOR_BGRA2RGB,
        rs.format.yuyv: cv2.COLOR_YUV2RGB_YUYV,
        rs.format.uyvy: cv2.COLOR_YUV2RGB_UYVY,
        rs.format.y8: cv2.COLOR_GRAY2RGB,
    }
    if form not in turns:
        raise ConegraphError(f"colour format {form} is not read; record rgb8")
    if data.dtype == np.uint16:
        # Two bytes a pixel come as one number.
        data = data.view(np.uint8).reshape(*data.shape, 2)
    return np.asarray(cv2.cvtColor(data, turns[form]), dtype=np.uint8)


def camera_of(intrinsics: Any) -> Camera:
    """Return the lens that a device reports.

    An inverse lens (Brown and Conrady from distorted to straight) is turned round
    by least squares over the picture.
    """
    rs = load_library()
    k1, k2, p1, p2, k3 = (float(c) for c in intrinsics.coeffs)
    lens = (k1, k2, p1, p2, k3)
    if intrinsics.model == rs.distortion.inverse_brown_conrady and any(lens):
        lens = turned_round(lens, _slopes_at_the_border(intrinsics))
    return Camera(
        int(intrinsics.width),
        int(intrinsics.height),
        float(intrinsics.fx),
        float(intrinsics.fy),
        float(intrinsics.ppx),
        float(intrinsics.ppy),
        lens,
    )


Lens = tuple[float, float, float, float, float]


def _slopes_at_the_border(intrinsics: Any) -> tuple[float, float]:
    wide = max(intrinsics.ppx, intrinsics.width - intrinsics.ppx) / intrinsics.fx
    tall = max(intrinsics.ppy, intrinsics.height - intrinsics.ppy) / intrinsics.fy
    return float(wide), float(tall)


def turned_round(lens: Lens, border: tuple[float, float]) -> Lens:
    """Return the lens that undoes another over a field of view.

    Brown and Conrady's polynomial is linear in its coefficients: with points bent by
    the given lens as input and the straight ones as output, they follow by least
    squares.

    Args:
        lens: k1, k2, p1, p2, k3.
        border: largest |x/z| and |y/z|.
    """
    x, y = (
        grid.ravel()
        for grid in np.meshgrid(
            np.linspace(-border[0], border[0], 41),
            np.linspace(-border[1], border[1], 31),
        )
    )
    moved = bending(x, y) @ np.array(lens)
    bent_x, bent_y = x + moved[: len(x)], y + moved[len(x) :]
    solved, *_ = np.linalg.lstsq(bending(bent_x, bent_y), -moved, rcond=None)
    k1, k2, p1, p2, k3 = (float(c) for c in solved)
    return k1, k2, p1, p2, k3


def bending(x: Array, y: Array) -> Array:
    """Return (2 N, 5) what each of k1, k2, p1, p2, k3 adds to x and to y."""
    r2 = x * x + y * y
    across = [x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3]
    down = [y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3]
    return np.vstack([np.column_stack(across), np.column_stack(down)])
