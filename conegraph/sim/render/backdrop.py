"""What is too far away to move: sky, sun, clouds, hills, woods and stands."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from conegraph.sim.render.light import Light
from conegraph.sim.render.paint import Bytes, Floats, cloudy, lit, to_bytes

_WIDTH_PX = 3072
_LOW_RAD, _HIGH_RAD = np.radians(-4.0), np.radians(46.0)
_PER_RAD = _WIDTH_PX / (2 * np.pi)
_ROWS = int((_HIGH_RAD - _LOW_RAD) * _PER_RAD)


@dataclass(frozen=True, slots=True)
class Backdrop:
    """A picture all around.

    Attributes:
        picture: (H, W + 1, 3) columns go round with the azimuth, rows down.
        haze: (3,) colour of the air towards the horizon.
    """

    picture: Bytes
    haze: Floats

    def paint(self, x: Floats, y: Floats, z: Floats) -> Bytes:
        """Return the picture (R, W, 3) in directions of the world, (R, W) each."""
        level, azimuth = cv2.cartToPolar(x, y)
        elevation = np.arctan2(z, np.asarray(level))
        u = np.asarray(azimuth) * np.float32(_PER_RAD)
        v = np.float32(_ROWS - 1) - (elevation - np.float32(_LOW_RAD)) * np.float32(
            _PER_RAD
        )
        seen = cv2.remap(
            self.picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(seen, dtype=np.uint8)


def make_backdrop(light: Light, rng: np.random.Generator) -> Backdrop:
    """Return sky and horizon in a light."""
    elevation = (_HIGH_RAD - np.arange(_ROWS) / _PER_RAD).astype(np.float32)[:, None]
    azimuth = (np.arange(_WIDTH_PX) / _PER_RAD).astype(np.float32)[None]
    sky = _sky(elevation, azimuth, light, rng)
    haze = sky[(elevation[:, 0] > 0.01) & (elevation[:, 0] < 0.06)].mean(axis=(0, 1))
    hills = np.array([88.0, 104.0, 92.0])
    woods = np.array([58.0, 72.0, 44.0])
    _stand(sky, elevation, rng.uniform(0.02, 0.05), 60, (hills + haze) / 2, 0.03, rng)
    _stand(sky, elevation, rng.uniform(0.0, 0.05), 12, woods, 0.12, rng)
    _stand(sky, elevation, rng.uniform(-0.02, 0.02), 9, woods * 0.9, 0.18, rng)
    _buildings(sky, rng)
    ground = elevation < np.radians(-0.3)
    sky = np.where(ground[..., None], haze * 0.75, sky)
    shown = to_bytes(lit(_closed(sky), light))
    return Backdrop(shown, lit(haze, light))


def _sky(
    elevation: Floats, azimuth: Floats, light: Light, rng: np.random.Generator
) -> Floats:
    up = np.clip(elevation / np.radians(40), 0, 1)[..., None] ** 0.6
    dull = light.clouds**2
    zenith = (1 - dull) * np.array([96, 146, 212]) + dull * np.array([178, 184, 192])
    horizon = (1 - dull) * np.array([206, 220, 232]) + dull * np.array([206, 208, 210])
    if light.name in ("low_sun", "dusk"):
        horizon = 0.6 * horizon + 0.4 * np.array([246, 196, 150])
    sky = (1 - up) * horizon + up * zenith
    shape = (_ROWS, _WIDTH_PX)
    flat = cloudy((_ROWS // 2 + 1, _WIDTH_PX), 160, 6, rng)
    noise = flat.repeat(2, 0)[:_ROWS]
    cover = np.clip((noise - 1.5 + 2.2 * light.clouds) / 2.0, 0, 1)[..., None]
    body = 226 - 12 * cloudy(shape, 120, 5, rng)[..., None] * light.clouds
    sky = sky * (1 - cover) + body * cover
    away = np.cos(elevation) * np.cos(light.sun_elevation_rad) * np.cos(
        azimuth - light.sun_azimuth_rad
    ) + np.sin(elevation) * np.sin(light.sun_elevation_rad)
    near = np.arccos(np.clip(away, -1, 1))
    strength = min(light.sun, 1.0)
    glow = 150 * np.exp(-near / 0.12) + 60 * np.exp(-near / 0.6)
    shining: Floats = (sky + strength * glow[..., None]).astype(np.float32)
    return shining


def _stand(
    sky: Floats,
    elevation: Floats,
    height_rad: float,
    size_px: float,
    color: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    rough: float,
    rng: np.random.Generator,
) -> None:
    """Put a skyline of hills or woods before the sky."""
    wave = cloudy((8, _WIDTH_PX), size_px * 8, 5, rng)[4]
    fine = cloudy((8, _WIDTH_PX), size_px, 3, rng)[4]
    top = height_rad * (1 + 0.5 * wave) + 0.12 * abs(height_rad) * fine
    inside = elevation < top[None]
    texture = 1 + rough * cloudy((_ROWS, _WIDTH_PX), 10, 3, rng)
    shown = color * texture[..., None]
    sky[inside] = shown[inside].astype(np.float32)


def _buildings(sky: Floats, rng: np.random.Generator) -> None:
    """Put stands, lorries, tents and walls of tyres and banners on the horizon."""
    foot = int((_HIGH_RAD + np.radians(0.3)) * _PER_RAD)
    for _ in range(int(rng.integers(15, 45))):
        left = int(rng.integers(0, _WIDTH_PX))
        wide, tall = int(rng.uniform(6, 90)), int(rng.uniform(4, 22))
        color = rng.uniform(40, 200) + rng.normal(0, 30, 3)
        if rng.random() < 0.5:
            color = np.full(3, rng.uniform(60, 210)) + rng.normal(0, 8, 3)
        top = foot - tall
        sky[top:foot, left : left + wide] = color
        if rng.random() < 0.5:
            crowd = rng.uniform(
                20, 230, (tall, sky[top:foot, left : left + wide].shape[1], 3)
            )
            sky[top:foot, left : left + wide] += 0.3 * (crowd - 128).astype(np.float32)


def _closed(picture: Floats) -> Floats:
    """Return the picture with its seam blended and its first column repeated."""
    width = 160
    share = np.linspace(0, 1, width, dtype=np.float32)[None, :, None]
    mirrored = picture[:, :width][:, ::-1]
    picture[:, -width:] = picture[:, -width:] * (1 - share) + mirrored * share
    return np.concatenate([picture, picture[:, :1]], axis=1)
