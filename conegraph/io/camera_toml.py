"""``camera.toml``: the lens, where the camera sits, and what its depths mean.

[camera]
width_px = 640
height_px = 480
fx_px = 465.0
fy_px = 465.0
cx_px = 321.3
cy_px = 238.1
distortion = [-0.06, 0.02, 0.0004, -0.0003, 0.0]   # k1, k2, p1, p2, k3

[mount]                # optional: height_m, pitch_rad, roll_rad, yaw_rad, x_m, y_m
height_m = 0.9
pitch_rad = 0.14

[depth]                # optional
units_per_m = 1000.0   # 1000 for millimetres, 5000 as the TUM sequences have it
max_gap_s = 0.02       # between a colour picture and its depth
"""

from __future__ import annotations

import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tomli_w
from pydantic import Field, ValidationError

from conegraph.camera import Camera, CameraMount
from conegraph.config.section import Positive, Section
from conegraph.errors import FileFormatError
from conegraph.io.csv_table import read_text

CAMERA_TOML = "camera.toml"
MAX_GAP_S = 0.02
UNITS_PER_M = 1000.0
_MAX_BYTES = 2**20
_SHOWN = 60

Side = Annotated[int, Field(ge=8, le=16384)]
Angle = Annotated[float, Field(ge=-1.6, le=1.6)]
Lens = tuple[float, float, float, float, float]


class _CameraSection(Section):
    width_px: Side
    height_px: Side
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: Annotated[Lens, Field(strict=False)] = (0.0, 0.0, 0.0, 0.0, 0.0)


class _MountSection(Section):
    x_m: float = 0.0
    y_m: float = 0.0
    height_m: Annotated[float, Field(gt=0, le=10)] = 1.0
    pitch_rad: Angle = 0.0
    roll_rad: Angle = 0.0
    yaw_rad: Annotated[float, Field(ge=-3.2, le=3.2)] = 0.0


class _DepthSection(Section):
    units_per_m: Positive = UNITS_PER_M
    max_gap_s: Positive = MAX_GAP_S


class _File(Section):
    camera: _CameraSection
    mount: _MountSection | None = None
    depth: _DepthSection = _DepthSection()


@dataclass(frozen=True, slots=True)
class CameraFile:
    """What a ``camera.toml`` says.

    Attributes:
        camera: the lens.
        mount: where it sits, None where the file does not say.
        units_per_m: numbers in a depth picture that make a metre.
        max_gap_s: longest time between a colour picture and its depth.
    """

    camera: Camera
    mount: CameraMount | None = None
    units_per_m: float = UNITS_PER_M
    max_gap_s: float = MAX_GAP_S


def read_camera_toml(path: Path) -> CameraFile:
    """Read a ``camera.toml``.

    Raises:
        FileFormatError: missing, no TOML, or a key that is unknown, missing or
            makes no sense; the text names it.
    """
    if not path.is_file():
        raise FileFormatError(path, "is missing: it says what camera took the pictures")
    try:
        tree = tomllib.loads(read_text(path, _MAX_BYTES))
        given = _File.model_validate(tree)
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(path, f"is no TOML: {error}") from error
    except ValidationError as error:
        raise FileFormatError(path, _explained(error)) from error
    lens = Camera(**given.camera.model_dump())
    for name, value, side in (
        ("cx_px", lens.cx_px, lens.width_px),
        ("cy_px", lens.cy_px, lens.height_px),
    ):
        if not 0 <= value <= side:
            raise FileFormatError(path, f"camera.{name}: {value} is off the picture")
    mount = None if given.mount is None else CameraMount(**given.mount.model_dump())
    return CameraFile(lens, mount, given.depth.units_per_m, given.depth.max_gap_s)


def _explained(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    key = ".".join(map(str, first["loc"]))
    if first["type"] == "missing":
        return f"{key}: is missing"
    if first["type"] == "extra_forbidden":
        return f"{key}: no such key"
    shown = repr(first["input"])[:_SHOWN]
    return f"{key}: {first['msg'].lower()} (got {shown})"


def format_camera_toml(file: CameraFile) -> str:
    """Return the text of a ``camera.toml`` that reads back to the last bit."""
    lens = asdict(file.camera)
    lens["distortion"] = list(lens["distortion"])
    tree: dict[str, object] = {"camera": lens}
    if file.mount is not None:
        tree["mount"] = asdict(file.mount)
    tree["depth"] = {"units_per_m": file.units_per_m, "max_gap_s": file.max_gap_s}
    return tomli_w.dumps(tree)
