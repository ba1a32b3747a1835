"""What can be configured of the front end: from a picture to cones with covariances."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from conegraph.config.section import NonNegative, Positive, Section

Byte = Annotated[int, Field(ge=0, le=255)]
Hue = Annotated[int, Field(ge=0, le=180)]
HueRange = Annotated[tuple[Hue, Hue], Field(strict=False)]
Hsv = Annotated[tuple[Hue, Byte, Byte], Field(strict=False)]
ConeLabel = Literal["blue", "yellow", "orange", "big_orange", "unknown"]
EngineName = Literal["auto", "onnxruntime", "opencv"]
Side = Annotated[int, Field(ge=0, le=4096)]


def _both_or_none(size: tuple[int, int]) -> tuple[int, int]:
    if 0 in size and any(size):
        raise ValueError("is 0 on one side only")
    return size


Size = Annotated[tuple[Side, Side], Field(strict=False), AfterValidator(_both_or_none)]


class HsvConfig(Section):
    """The colour detector as we measured it to be best."""

    kind: Literal["hsv"] = "hsv"
    """Which detector this section configures."""
    profile: Literal["default"] = "default"
    """`thesis` is the published method, with keys of its own."""
    blue_hue: HueRange = (96, 128)
    """First and last hue of blue cones, 0 to 180 as in OpenCV; a range whose first
    hue is above its last wraps around red."""
    yellow_hue: HueRange = (16, 36)
    """First and last hue of yellow cones."""
    orange_hue: HueRange = (168, 14)
    """First and last hue of orange cones."""
    min_saturation: Byte = 90
    """Paler pixels are no cone."""
    min_chroma: Byte = 25
    """And whose saturation times value, over 255, is at least this."""
    min_value: Byte = 35
    """Darker pixels are no cone: their hue is noise."""
    min_contrast: Positive = 0.25
    """How much a cone's colour, less its grey, must differ from what is beside it, as a
    share of itself, squared; half as much is none, twice as much is plenty."""
    min_pixels: Annotated[int, Field(ge=1)] = 8
    """Coloured pixels that a cone must have."""
    min_score: Annotated[float, Field(gt=0, le=1)] = 0.1
    """How much like a cone's, 0 to 1, an outline must be."""
    min_range_m: NonNegative = 0.5
    """Nearer cones are not reported."""
    max_range_m: Positive = 20.0
    """Farther cones are not reported."""


class ColourRange(Section):
    """One row of the thesis's Table 3.1."""

    cone: ConeLabel
    """What a pixel in the range is taken for."""
    low: Hsv
    """Least hue (0 to 180), saturation and value (0 to 255)."""
    high: Hsv
    """Greatest hue, saturation and value."""


TABLE_3_1 = (
    ColourRange(cone="orange", low=(0, 120, 100), high=(15, 255, 255)),
    ColourRange(cone="blue", low=(105, 120, 100), high=(120, 255, 255)),
    ColourRange(cone="yellow", low=(23, 120, 100), high=(38, 255, 255)),
)


class HsvThesisConfig(Section):
    """The thesis's chapter 3, step by step."""

    kind: Literal["hsv"] = "hsv"
    """Which detector this section configures."""
    profile: Literal["thesis"] = "thesis"
    """`thesis` is the published method, `default` has keys of its own."""
    colours: Annotated[tuple[ColourRange, ...], Field(min_length=1, strict=False)] = (
        TABLE_3_1
    )
    """Table 3.1. Its red training cones stand for orange ones; its green and pink
    ones, which no competition has, may be added."""
    spatial_radius_px: Positive = 10.0
    """Mean shift: how far in the picture."""
    colour_radius: Positive = 20.0
    """Mean shift: how far in colour."""
    pyramid_levels: Annotated[int, Field(ge=0, le=4)] = 1
    """Mean shift: levels above the full picture."""
    median_px: Literal[3, 5] = 5
    """Side of the median filter on depth."""
    roi_top: Annotated[float, Field(ge=0, lt=1)] = 0.34
    """Share of the picture above the region of interest: the sky."""
    roi_bottom: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Where the region of interest ends: the car's nose."""
    min_area_px: NonNegative = 30.0
    """Contours must be larger than this."""
    max_area_px: Positive = 20000.0
    """And smaller than this."""
    min_range_m: NonNegative = 0.3
    """Depths at the centroid must be larger than this."""
    max_range_m: Positive = 12.0
    """And smaller than this."""


class YoloConfig(Section):
    """The learned detector: our network, or one of your own in YOLO's layout."""

    kind: Literal["yolo"] = "yolo"
    """Which detector this section configures."""
    profile: Literal["default"] = "default"
    """There is only one."""
    model: str = ""
    """An ONNX file with the output of YOLO v5, v7, v8, v9 or v11; ours if empty."""
    classes: Annotated[tuple[ConeLabel, ...], Field(min_length=1, strict=False)] = (
        "blue",
        "yellow",
        "orange",
        "big_orange",
    )
    """What the model's classes are, in its order."""
    engine: EngineName = "auto"
    """What runs it; `auto` is onnxruntime where it is installed, else OpenCV."""
    input_px: Size = (0, 0)
    """Width and height of its input, for models that take only one; else zeros."""
    max_side_px: Annotated[int, Field(ge=1, le=4096)] = 1280
    """Larger pictures are made smaller first."""
    min_score: Annotated[float, Field(gt=0, lt=1)] = 0.4
    """Boxes with a lower score are no cones."""
    overlap: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """Of boxes that overlap by more (intersection over union) one stays."""
    min_range_m: NonNegative = 0.5
    """Nearer cones are not reported."""
    max_range_m: Positive = 20.0
    """Farther cones are not reported."""


def _tag(given: Any) -> str:
    read = given.get if isinstance(given, Mapping) else partial(getattr, given)
    profile = read("profile", "default")
    kind = read("kind", "yolo" if profile == "default" else "hsv")
    return f"{kind}" if profile == "default" else f"{kind}/{profile}"


DetectorConfig = Annotated[
    Annotated[HsvConfig, Tag("hsv")]
    | Annotated[HsvThesisConfig, Tag("hsv/thesis")]
    | Annotated[YoloConfig, Tag("yolo")],
    Discriminator(_tag),
]
DETECTORS: dict[str, type[Section]] = {
    "hsv": HsvConfig,
    "hsv/thesis": HsvThesisConfig,
    "yolo": YoloConfig,
}
"""Every detector's section by its kind, and its profile unless that is the default."""


class GroundConfig(Section):
    """The ground plane under the camera."""

    fit: bool = True
    """Fit it to the depth of every frame; False trusts the mount."""
    attitude_sigma_rad: Positive = 0.02
    """How far pitch and roll stray from the mount's, by braking and bumps."""
    height_sigma_m: Positive = 0.03
    """How far the camera's height strays from the mount's."""
    time_constant_s: Positive = 0.15
    """How long the body keeps an attitude; after it only the mount is known."""
    gate_d2: Positive = 25.0
    """A plane farther than this from the expected one is taken for something else."""


class LocalizationConfig(Section):
    """From a detection in the picture to a position with its covariance."""

    edge_sigma_px: Positive = 0.132
    """Error of the row at which a cone meets the ground."""
    center_sigma_px: Positive = 0.09
    """Error of the column of a cone's axis."""
    axis_sigma_m: Positive = 0.0011
    """Error of the axis up close, where pixels are small."""
    behind_sigma_m: NonNegative = 0.004
    """Error of the axis at 15 m by cones that peep out behind; it grows with the square
    of the range, as ever more of them do."""
    depth_correlation_px: Positive = 5.0
    """Side of the square of pixels whose depths err together."""
    foot_sigma_m: Positive = 0.0092
    """How far the foot's near edge strays from where a foot at a middling angle has
    it."""
    gate_d2: Positive = 7.0
    """Depth and ground that disagree by more are not fused: something hides the
    foot, or the depth is of something else."""
