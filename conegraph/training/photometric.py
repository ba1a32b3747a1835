"""What cameras do to pictures: exposure, colour, glare, blur, noise, compression."""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.sim.render.paint import Bytes
from conegraph.training.view import Floats


def photographed(picture: Bytes, rng: np.random.Generator) -> Bytes:
    """Return the picture (H, W, 3) as some camera in some light would show it."""
    lit = _developed(picture, rng)
    if rng.random() < 0.2:
        lit = _glare(lit, rng)
    lit = _blurred(lit, rng)
    noise = rng.uniform(0, 1) ** 3 * 16.0
    if noise > 0.5:
        white = rng.standard_normal(lit.shape, dtype=np.float32)
        if rng.random() < 0.5:
            white[:] = white.mean(axis=2, keepdims=True) * np.float32(1.7)
        lit = lit + np.float32(noise) * white
    shown: Bytes = np.clip(lit, 0, 255).astype(np.uint8)
    if rng.random() < 0.7:
        quality = int(rng.integers(22, 96))
        _, code = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, quality])
        shown = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), dtype=np.uint8)
    return shown


def _developed(picture: Bytes, rng: np.random.Generator) -> Floats:
    """Apply white balance, gamma, exposure, contrast and saturation."""
    level = np.arange(256, dtype=np.float32) / 255
    gamma = np.exp(rng.normal(0, 0.25))
    exposure = np.exp(rng.normal(-0.05, 0.3))
    if rng.random() < 0.12:
        exposure *= rng.uniform(0.25, 0.6)
    warm, green = rng.normal(0, 0.06), rng.normal(0, 0.03)
    gains = exposure * np.array([1 + warm, 1 + green, 1 - warm])
    lift = rng.uniform(0, 45) if rng.random() < 0.3 else 0.0
    curve = lift + (255 - lift) * level[:, None] ** gamma * gains
    table = np.clip(curve, 0, 255).astype(np.uint8)
    # Saturation as a small change of basis, before the curve.
    share = np.float32(np.clip(rng.normal(1.0, 0.25), 0.35, 1.6))
    grey = np.array([[0.3, 0.59, 0.11]], np.float32).repeat(3, 0)
    mix = share * np.eye(3, dtype=np.float32) + (1 - share) * grey
    colored = cv2.transform(picture, mix)
    return np.asarray(cv2.LUT(colored, table[None]), dtype=np.float32)


def _glare(lit: Floats, rng: np.random.Generator) -> Floats:
    """Add a bright spot with its halo, or a veil over all."""
    height, width = lit.shape[:2]
    at = rng.uniform((-0.2, -0.3), (1.2, 0.7)) * (width, height)
    u = np.arange(width, dtype=np.float32)[None] - np.float32(at[0])
    v = np.arange(height, dtype=np.float32)[:, None] - np.float32(at[1])
    reach = np.float32(rng.uniform(0.15, 0.9) * width)
    halo = np.float32(rng.uniform(40, 220)) * np.exp(-np.sqrt(u * u + v * v) / reach)
    return np.asarray(lit + halo[..., None])


def _blurred(lit: Floats, rng: np.random.Generator) -> Floats:
    """Blur by defocus, motion or enlargement; or sharpen, as cameras do."""
    kind = rng.random()
    if kind < 0.3:
        return np.asarray(cv2.GaussianBlur(lit, (0, 0), rng.uniform(0.3, 1.6)))
    if kind < 0.42:
        length = int(rng.integers(2, 10))
        kernel = np.zeros((length, length), np.float32)
        angle = rng.normal(0, 0.5)
        way = 0.5 * length * np.array([np.cos(angle), np.sin(angle)])
        middle = 0.5 * (length - 1)
        start, end = (middle - way).astype(int), (middle + way).astype(int)
        cv2.line(kernel, start.tolist(), end.tolist(), 1.0)
        return np.asarray(cv2.filter2D(lit, -1, kernel / max(kernel.sum(), 1.0)))
    if kind < 0.55:
        height, width = lit.shape[:2]
        share = rng.uniform(0.4, 0.9)
        small = cv2.resize(
            lit, (int(width * share), int(height * share)), interpolation=cv2.INTER_AREA
        )
        return np.asarray(
            cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
        )
    if kind < 0.75:
        soft = cv2.GaussianBlur(lit, (0, 0), rng.uniform(0.7, 1.5))
        return np.asarray(lit + np.float32(rng.uniform(0.2, 1.2)) * (lit - soft))
    return lit
