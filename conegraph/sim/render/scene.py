"""The world that a camera looks at: cones, ground, backdrop, clutter, light."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from conegraph.sim.render.backdrop import Backdrop, make_backdrop
from conegraph.sim.render.clutter import Panel, place_clutter
from conegraph.sim.render.cone_shape import CONE_SHAPES
from conegraph.sim.render.ground import Ground, make_ground
from conegraph.sim.render.light import Light, draw_light
from conegraph.sim.render.paint import Floats, lit
from conegraph.types import Array, TruthMap

_SHEET_PX = (1024, 2048)
_CLUTTER_PER_CONE = 0.8


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that does not change from frame to frame.

    Attributes:
        cones: the true cones in the world.
        cone_yaw_rad: (N,) how each foot is turned.
        outline_m: (N, 20, 3) outline of each, as if it stood at the origin.
        body_color: (N, 3) colour of each body in plain light at this exposure.
        stripe_color: for each cone the colours of its stripes (S, 3).
        sunlit: (N,) how much of the sun reaches each, 0 to 1.
        light: the light.
        ground: the ground.
        backdrop: sky and horizon.
        clutter: things that are no cones.
        noise: (H, W, 3) int16 that noise is cut from.
    """

    cones: TruthMap
    cone_yaw_rad: Array
    outline_m: Array
    body_color: Floats
    stripe_color: tuple[Floats, ...]
    sunlit: Array
    light: Light
    ground: Ground
    backdrop: Backdrop
    clutter: tuple[Panel, ...]
    noise: np.ndarray[tuple[int, ...], np.dtype[np.int16]]


def make_scene(
    cones: TruthMap,
    rng: np.random.Generator,
    *,
    light: Light | None = None,
    clutter: int | None = None,
) -> Scene:
    """Build a world around cones.

    Args:
        cones: the cones, at least one.
        rng: draws everything random about the world.
        light: the light; drawn by chance where none is given.
        clutter: how many things to place beside the track; as many as fit the
            number of cones where none is given.
    """
    light = draw_light(rng) if light is None else light
    things = int(_CLUTTER_PER_CONE * len(cones)) if clutter is None else clutter
    parts = [np.random.default_rng(s) for s in rng.integers(0, 2**63, 5)]
    ground = make_ground(cones.xy_m, light, parts[0])
    shapes = [CONE_SHAPES[int(c)] for c in cones.cone_class]
    bodies = np.array([shape.color for shape in shapes])
    worn = _worn(bodies, parts[1])
    dirt = parts[1].uniform(0.85, 1.0, len(cones))
    stripes = tuple(
        lit(np.array([s[2] for s in shape.stripes]) * dirty, light)
        for shape, dirty in zip(shapes, dirt, strict=True)
    )
    noise = parts[2].normal(0, light.noise, (*_SHEET_PX, 3))
    # A sensor behind a colour mosaic errs alike in all three channels, mostly.
    noise = 0.7 * noise + 0.7 * noise.mean(axis=2, keepdims=True) * np.sqrt(3)
    return Scene(
        cones,
        parts[1].uniform(-np.pi, np.pi, len(cones)),
        np.array([shape.outline_m for shape in shapes]),
        lit(worn, light),
        stripes,
        ground.sunlit(cones.xy_m),
        light,
        ground,
        make_backdrop(light, parts[3]),
        place_clutter(cones.xy_m, things, light, parts[4]),
        np.round(noise).astype(np.int16),
    )


def _worn(colors: Array, rng: np.random.Generator) -> Array:
    """Return colours (N, 3) as bought in different years: hue, depth, brightness."""
    hsv = cv2.cvtColor((colors / 255).astype(np.float32)[None], cv2.COLOR_RGB2HSV)[0]
    count = len(colors)
    # Reds fade to pink or to orange; real photographs spread as much.
    red = np.cos(np.radians(hsv[:, 0])) > 0.9
    hue = hsv[:, 0] + np.where(red, 6.0, 4.0) * rng.standard_normal(count)
    depth = hsv[:, 1] * rng.uniform(0.82, 1.05, count)
    value = hsv[:, 2] * rng.uniform(0.85, 1.05, count)
    mixed = np.column_stack([hue % 360, np.clip(depth, 0, 1), np.clip(value, 0, 1)])
    plain = cv2.cvtColor(mixed.astype(np.float32)[None], cv2.COLOR_HSV2RGB)[0]
    return np.asarray(plain, dtype=np.float64) * 255
