"""Which front ends there are: a new one is one class and one line here."""

from __future__ import annotations

from conegraph.config import Config, HsvThesisConfig, YoloConfig
from conegraph.frontend.base import Detector, FrontEnd
from conegraph.frontend.front_end import RgbdFrontEnd
from conegraph.frontend.hsv import HsvDetector
from conegraph.frontend.thesis import ThesisFrontEnd
from conegraph.frontend.yolo import YoloDetector


def make_front_end(config: Config) -> FrontEnd:
    """Make the front end that ``[detector]`` names.

    It keeps the ground of the last frame: use a new one for another stream.

    Raises:
        FileFormatError: the network of a learned detector cannot be opened.
        MissingDependencyError: what is to run it is not installed.
    """
    detector = config.detector
    if isinstance(detector, HsvThesisConfig):
        return ThesisFrontEnd(detector)
    finder: Detector = (
        YoloDetector(detector)
        if isinstance(detector, YoloConfig)
        else HsvDetector(detector)
    )
    return RgbdFrontEnd(
        finder,
        config.ground,
        config.localization,
        min_range_m=detector.min_range_m,
        max_range_m=detector.max_range_m,
    )
