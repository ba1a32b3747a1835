"""Light from bright to dusk, and how the camera answers it.

Pictures are made in display values, 0 to 255, which go with the power 1/2.2 of the
light. A product of lights is a product of display values too, so that shade is a
factor there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from conegraph.types import Array

GAMMA = 2.2
LightName = Literal["bright", "overcast", "low_sun", "dusk"]
LIGHT_NAMES: tuple[LightName, ...] = get_args(LightName)


@dataclass(frozen=True, slots=True)
class Light:
    """The sky's light and the camera's exposure.

    Attributes:
        name: what it is called.
        sun_azimuth_rad: where the sun stands in the world, from x towards y.
        sun_elevation_rad: how high.
        sun: its strength on a surface that faces it.
        sky: the sky's strength on the ground.
        tint: (3,) factors on red, green and blue.
        exposure: factor on the whole picture, in display values.
        saturation: 1 keeps colours, 0 makes them grey.
        haze_m: distance at which haze hides two thirds of a thing.
        clouds: share of the sky that is covered.
        exposure_s: how long the shutter is open.
        noise: sigma of the picture's noise, in display values.
    """

    name: LightName
    sun_azimuth_rad: float
    sun_elevation_rad: float
    sun: float
    sky: float
    tint: tuple[float, float, float]
    exposure: float
    saturation: float
    haze_m: float
    clouds: float
    exposure_s: float
    noise: float

    @property
    def sun_direction(self) -> Array:
        """(3,) from the ground towards the sun, in the world."""
        az, el = self.sun_azimuth_rad, self.sun_elevation_rad
        return np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])

    @property
    def on_ground(self) -> float:
        """Light on sunlit level ground."""
        return self.sky + self.sun * float(np.sin(self.sun_elevation_rad))

    @property
    def in_shade(self) -> float:
        """Factor of display values on level ground in shade."""
        return float((self.sky / self.on_ground) ** (1 / GAMMA))


_RANGES: dict[LightName, dict[str, tuple[float, float]]] = {
    "bright": {
        "elevation_deg": (30, 65),
        "sun": (0.9, 1.1),
        "sky": (0.22, 0.40),
        "warmth": (-0.01, 0.03),
        "exposure": (0.92, 1.12),
        "saturation": (0.95, 1.05),
        "haze_m": (150, 400),
        "clouds": (0.1, 0.6),
        "exposure_ms": (1, 3),
        "noise": (1.5, 2.5),
    },
    "overcast": {
        "elevation_deg": (30, 60),
        "sun": (0.0, 0.10),
        "sky": (0.8, 1.0),
        "warmth": (-0.03, 0.01),
        "exposure": (0.80, 1.0),
        "saturation": (0.85, 0.95),
        "haze_m": (80, 250),
        "clouds": (0.9, 1.0),
        "exposure_ms": (3, 6),
        "noise": (2.0, 3.0),
    },
    "low_sun": {
        "elevation_deg": (8, 20),
        "sun": (1.0, 1.4),
        "sky": (0.16, 0.28),
        "warmth": (0.04, 0.10),
        "exposure": (0.80, 1.0),
        "saturation": (0.9, 1.0),
        "haze_m": (80, 250),
        "clouds": (0.1, 0.5),
        "exposure_ms": (2, 6),
        "noise": (2.0, 3.5),
    },
    "dusk": {
        "elevation_deg": (2, 6),
        "sun": (0.0, 0.15),
        "sky": (0.5, 0.6),
        "warmth": (-0.10, -0.02),
        "exposure": (0.45, 0.68),
        "saturation": (0.75, 0.9),
        "haze_m": (60, 200),
        "clouds": (0.3, 0.9),
        "exposure_ms": (8, 15),
        "noise": (4.0, 6.5),
    },
}


def draw_light(rng: np.random.Generator, name: LightName | None = None) -> Light:
    """Return a light of the given name, or of one by chance.

    Args:
        rng: draws everything within the range that belongs to the name.
        name: ``bright``, ``overcast``, ``low_sun`` or ``dusk``.
    """
    pick = int(rng.integers(len(LIGHT_NAMES)))
    name = LIGHT_NAMES[pick] if name is None else name
    value = {key: float(rng.uniform(*span)) for key, span in _RANGES[name].items()}
    warmth = value["warmth"]
    return Light(
        name=name,
        sun_azimuth_rad=float(rng.uniform(-np.pi, np.pi)),
        sun_elevation_rad=float(np.radians(value["elevation_deg"])),
        sun=value["sun"],
        sky=value["sky"],
        tint=(1.0 + warmth, 1.0 + 0.2 * warmth, 1.0 - warmth),
        exposure=value["exposure"],
        saturation=value["saturation"],
        haze_m=value["haze_m"],
        clouds=value["clouds"],
        exposure_s=1e-3 * value["exposure_ms"],
        noise=value["noise"],
    )
