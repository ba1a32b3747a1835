"""What cones are made of, after the rules of Formula Student."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.types import Array, ConeClass

Rgb = tuple[float, float, float]

WHITE: Rgb = (238.0, 238.0, 232.0)
BLACK: Rgb = (28.0, 28.0, 30.0)
BLUE: Rgb = (40.0, 99.0, 186.0)
YELLOW: Rgb = (240.0, 199.0, 52.0)
ORANGE: Rgb = (230.0, 54.0, 54.0)

PLATE_M = 0.02
"""Thickness of the square foot."""


@dataclass(frozen=True, slots=True)
class ConeShape:
    """A cone: a cut-off circular cone on a square foot.

    Attributes:
        side_m: side of the foot.
        height_m: from the ground to the top.
        base_radius_m: radius of the body on the foot.
        top_radius_m: radius at the top.
        color: of body and foot, 0 to 255 as a picture in plain light shows it.
        stripes: lower and upper end as a share of the height, and colour.
    """

    side_m: float
    height_m: float
    base_radius_m: float
    top_radius_m: float
    color: Rgb
    stripes: tuple[tuple[float, float, Rgb], ...]

    @property
    def outline_m(self) -> Array:
        """(20, 3) points whose hull is the cone's, standing at the origin."""
        half = self.side_m / 2
        foot = half * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        top = self.top_radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        levels = ((foot, 0.0), (foot, PLATE_M), (top, self.height_m))
        return np.vstack(
            [np.column_stack([xy, np.full(len(xy), z)]) for xy, z in levels]
        )


def _small(color: Rgb, stripe: Rgb) -> ConeShape:
    return ConeShape(0.228, 0.325, 0.085, 0.024, color, ((0.42, 0.68, stripe),))


CONE_SHAPES: dict[int, ConeShape] = {
    ConeClass.BLUE: _small(BLUE, WHITE),
    ConeClass.YELLOW: _small(YELLOW, BLACK),
    ConeClass.ORANGE: _small(ORANGE, WHITE),
    ConeClass.BIG_ORANGE: ConeShape(
        0.285, 0.505, 0.105, 0.028, ORANGE, ((0.30, 0.47, WHITE), (0.62, 0.78, WHITE))
    ),
    ConeClass.UNKNOWN: _small((150.0, 150.0, 148.0), WHITE),
}
"""The shape of each `ConeClass`; an unknown cone is a grey one."""
