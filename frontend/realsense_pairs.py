"""Colour and depth pictures of a recording, joined by their time stamps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.frontend.realsense_frames import (
    BACKWARDS,
    INCOMPLETE,
    MISSING,
    camera_of,
    registered,
    rgb_of,
)
from conegraph.frontend.realsense_playback import Picture, StreamPlayback
from conegraph.frontend.realsense_register import Registration


@dataclass(slots=True)
class Pairs:
    """Joins two streams; counts what has no partner or is not there.

    Attributes:
        half_period_s: how far apart the stamps of a pair may be.
        left_out: counts by reason, added to.
        colors_seen: how many colour pictures came, with a partner or without.
    """

    half_period_s: float
    left_out: Counter[str]
    colors_seen: int = 0

    def of(
        self, colors: Iterator[Picture], depths: Iterator[Picture]
    ) -> Iterator[tuple[Picture, Picture]]:
        """Yield colour with its depth, forward in time."""
        depth = next(depths, None)
        for color in self._forward(colors):
            while depth and depth.stamp_s < color.stamp_s - self.half_period_s:
                self.left_out[INCOMPLETE] += 1
                depth = next(depths, None)
            if depth and depth.stamp_s <= color.stamp_s + self.half_period_s:
                yield color, depth
                depth = next(depths, None)
            else:
                self.left_out[INCOMPLETE] += 1
        while depth:
            self.left_out[INCOMPLETE] += 1
            depth = next(depths, None)

    def _forward(self, colors: Iterator[Picture]) -> Iterator[Picture]:
        """Yield colour whose time runs forward.

        A camera numbers its pictures: a gap in the numbers is that many missing.
        """
        last_number, last_s = -1, float("-inf")
        for color in colors:
            self.colors_seen += 1
            if color.number > last_number + 1 > 0:
                self.left_out[MISSING] += color.number - last_number - 1
            last_number = max(color.number, last_number)
            if color.stamp_s > last_s:
                last_s = color.stamp_s
                yield color
            else:
                self.left_out[BACKWARDS] += 1


class PairReader:
    """Turns pairs of pictures into `RgbdFrame`.

    Args:
        color: playback of the colour stream.
        depth: playback of the depth stream of the same file.
        mount: where the camera sits.
    """

    def __init__(
        self, color: StreamPlayback, depth: StreamPlayback, mount: CameraMount
    ) -> None:
        """Read both lenses and how one sits to the other."""
        self.camera = camera_of(color.profile.get_intrinsics())
        self._form = color.profile.format()
        self._mount = mount
        # One device knows the poses between its own streams only.
        beside = color.beside(depth.profile.stream_type())
        self._registration: Registration | None = None
        if not registered(color.profile, beside):
            moved = beside.get_extrinsics_to(color.profile)
            self._registration = Registration.between(
                camera_of(beside.get_intrinsics()),
                self.camera,
                # The library stores matrices column by column.
                np.array(moved.rotation).reshape(3, 3).T,
                np.array(moved.translation),
            )

    def frame(self, color: Picture, depth: Picture) -> RgbdFrame:
        """Return the frame of a pair, depth registered to colour."""
        depth_m = depth.pixels.astype(np.float32) * np.float32(depth.units_m)
        if self._registration is not None:
            depth_m = self._registration.moved(depth_m)
        rgb = rgb_of(color.pixels, self._form)
        return RgbdFrame(color.stamp_s, rgb, depth_m, self.camera, self._mount)


def half_period_s(color: Any, depth: Any) -> float:
    """Return half the time between pictures of the slower stream."""
    return 0.5 / max(1, min(int(color.fps()), int(depth.fps())))
