"""Cones that invite a wrong road: each case is right, or the answer is unsure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from conegraph.config import TrackConfig
from conegraph.io.cone_names import hard_class_prob
from conegraph.track import Track, detect_track
from conegraph.types import Array, ConeClass, ConeMap

UNSURE = 0.35
"""A track with less confidence than this says "I do not know"."""
Case = tuple[str, Callable[[TrackConfig], bool]]
_ORIGIN = np.zeros(3)


def map_of(left_m: Array, right_m: Array, shift_m: float = 0.0) -> ConeMap:
    """Return a map of blue cones on the left and yellow ones on the right."""
    xy = np.vstack([left_m, right_m]) + shift_m
    kind = np.repeat([ConeClass.BLUE, ConeClass.YELLOW], [len(left_m), len(right_m)])
    n = len(xy)
    cov = np.broadcast_to(0.0025 * np.eye(2), (n, 2, 2))
    prob = hard_class_prob(kind.astype(np.int64))
    return ConeMap(np.arange(n), xy, cov, prob, np.ones(n, dtype=np.int64))


def hairpin(gap_m: float, lane_m: float = 3.0) -> tuple[Array, Array]:
    """Return a hairpin whose legs' inner walls are so far apart; left turn."""
    x = np.arange(0.0, 30.1, 3.0)
    inner, outer = 0.5 * gap_m, 0.5 * gap_m + lane_m
    turn = np.linspace(-np.pi / 2, np.pi / 2, 7)[1:-1]
    arc = np.column_stack([np.cos(turn), np.sin(turn)])
    few = np.array([[1.0, 0.0]])
    left = [_row(x, -inner), x[-1:] * (1, 0) + inner * few, _row(x[::-1], inner)]
    right = [_row(x, -outer), x[-1:] * (1, 0) + outer * arc, _row(x[::-1], outer)]
    return np.vstack(left), np.vstack(right)


def _row(x: Array, y: float) -> Array:
    return np.column_stack([x, np.full_like(x, y)])


def _is_chain(track: Track, left: int, right: int) -> bool:
    """Return whether the boundaries are rows 0..left-1 and the rest, in order."""
    a: list[int] = track.left.tolist()
    b: list[int] = track.right.tolist()
    return a == list(range(left)) and b == list(range(left, left + right))


def _ring_of(chain: list[int], low: int, high: int) -> bool:
    """Return whether a loop runs through rows low..high-1, rising or falling."""
    if sorted(chain) != list(range(low, high)):
        return False
    step = np.unique((np.roll(chain, -1) - chain) % (high - low))
    return len(step) == 1 and int(step[0]) in (1, high - low - 1)


def hard_cases(seed: int) -> list[Case]:
    """Return the cases by name, each a test of a configuration."""
    rng = np.random.default_rng([seed, 9])
    x = np.arange(0.0, 60.1, 4.0)
    straight = (_row(x, 1.5), _row(x, -1.5))
    angle = 2 * np.pi * np.arange(24) / 24
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    ring = (8.0 * circle, 11.0 * circle)
    pose = np.array([-1.0, 0.0, 0.0])
    n = len(x)

    def hairpin_right(config: TrackConfig) -> bool:
        left, right = hairpin(1.5)
        start = np.array([-1.0, -2.25, 0.0])
        track = detect_track(map_of(left, right), start, config=config)
        return _is_chain(track, len(left), len(right)) or track.confidence < UNSURE

    def straight_right(config: TrackConfig) -> bool:
        track = detect_track(
            map_of(*straight, 400.0),
            pose + np.array([400.0, 400.0, 0.0]),
            config=config,
        )
        return _is_chain(track, n, n)

    def circle_right(config: TrackConfig) -> bool:
        track = detect_track(map_of(*ring), config=config)
        left, right = track.left.tolist(), track.right.tolist()
        return track.closed and _ring_of(left, 0, 24) and _ring_of(right, 24, 48)

    def few(config: TrackConfig) -> bool:
        cones = [np.zeros((0, 2)), np.array([[3.0, 1.5]])]
        maps = [map_of(a, b * (1, -1)) for a in cones for b in cones]
        tracks = [
            detect_track(m, p, config=config) for m in maps for p in (None, _ORIGIN)
        ]
        return all(track.confidence < UNSURE for track in tracks)

    def one_side(config: TrackConfig) -> bool:
        track = detect_track(map_of(straight[0], np.zeros((0, 2))), pose, config=config)
        line = track.centerline.xy_m
        near = len(line) > 0 and bool((np.abs(line[:, 1]) < 1.0).all())
        return track.confidence < UNSURE and (near or len(line) == 0)

    def duplicates(config: TrackConfig) -> bool:
        left, right = (np.vstack([s, s + 0.02]) for s in straight)
        track = detect_track(map_of(left, right), pose, config=config)
        places = sorted({k % n for k in track.left.tolist()})
        return len(track.left) == n and places == list(range(n))

    def collinear(config: TrackConfig) -> bool:
        track = detect_track(
            map_of(_row(x, 0.0), _row(x + 2.0, 0.0)), pose, config=config
        )
        return track.confidence < UNSURE

    def not_a_number(config: TrackConfig) -> bool:
        left = np.vstack([straight[0], [[np.nan, 1.0], [np.inf, np.nan]]])
        track = detect_track(map_of(left, straight[1]), pose, config=config)
        return len(track.left) == n and len(track.right) == n

    def shuffled(config: TrackConfig) -> bool:
        cones = map_of(*ring)
        mixed = rng.permutation(len(cones))
        again = cones.subset(mixed)
        a, b = (detect_track(m, config=config) for m in (cones, again))
        return bool((a.left_id == b.left_id).all() and (a.right_id == b.right_id).all())

    def noise_only(config: TrackConfig) -> bool:
        scattered = rng.uniform(-20.0, 20.0, (40, 2))
        kind = rng.integers(2, size=40).astype(bool)
        track = detect_track(
            map_of(scattered[kind], scattered[~kind]), pose, config=config
        )
        return track.confidence < 0.5

    return [
        ("hairpin, legs 1.5 m apart", hairpin_right),
        ("exact straight, far from the origin", straight_right),
        ("exact circle", circle_right),
        ("0 to 2 cones", few),
        ("one side only", one_side),
        ("duplicates", duplicates),
        ("collinear", collinear),
        ("not a number", not_a_number),
        ("shuffled", shuffled),
        ("noise only", noise_only),
    ]
