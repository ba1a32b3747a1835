"""The streams that back ends are measured on, each named by a text that opens it."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from conegraph.errors import FileFormatError, SourceError
from conegraph.io.tracks import read_track
from conegraph.sim.cone_rows import closed_course
from conegraph.sim.cone_sensor import CAMERA, LIDAR
from conegraph.sim.drive import simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.random_course import random_center
from conegraph.sim.track_shapes import HALF_LANE_M
from conegraph.sources import SimOptions, open_source, simulate_track
from conegraph.types import Recording, TrackLayout

log = logging.getLogger(__name__)

SIZED = "cones"
"""Tracks named ``cones:400`` are random courses with that many cones."""

FAULTS = ("wrong_colour", "unknown_colour", "missed", "false_cones")


class Stream(BaseModel):
    """A drive in the simulator, or a recorded one.

    Attributes:
        track: a track file, a built-in name, ``random:SEED``, ``cones:COUNT``, or
            ``mrclam:FOLDER/RobotN``, for which nothing below counts.
        seed: of everything random in the drive.
        laps: laps to drive.
        sensor: ``camera`` or ``lidar``.
        odometry: whether there are wheels and a gyro.
        wrong_colour: share of detections, as `SimOptions` has it; likewise the rest.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    track: str
    seed: int = 0
    laps: int = 3
    sensor: str = "camera"
    odometry: bool = True
    wrong_colour: float = 0.0
    unknown_colour: float = 0.0
    missed: float = 0.0
    false_cones: float = 0.0

    @property
    def recorded(self) -> bool:
        """Whether it was driven by a real robot."""
        return self.track.startswith("mrclam:")

    @property
    def source(self) -> str:
        """The SOURCE that opens it; only sized courses have none of their own."""
        if self.recorded:
            return self.track
        odometry = "on" if self.odometry else "off"
        faults = "".join(
            f"&{key}={share:g}" for key in FAULTS if (share := getattr(self, key))
        )
        return (
            f"sim:{self.track}?laps={self.laps}&seed={self.seed}"
            f"&sensor={self.sensor}&odometry={odometry}{faults}"
        )

    @property
    def colours_right(self) -> Stream:
        """The same stream without colour faults: it has the same batch optimum."""
        return self.model_copy(update={"wrong_colour": 0.0, "unknown_colour": 0.0})

    def recording(self) -> Recording:
        """Make or read it.

        Raises:
            SourceError: there is no such track or recording.
            FileFormatError: it cannot be read.
        """
        if self.recorded:
            source = open_source(self.track)
            if not isinstance(source, Recording):
                raise SourceError(f"{self.track}: not held in memory")
            return source
        kind, _, count = self.track.partition(":")
        if kind == SIZED:
            return simulate(
                sized_course(int(count)),
                laps=self.laps,
                seed=self.seed,
                sensor=LIDAR if self.sensor == "lidar" else CAMERA,
                odometry=OdometrySensor() if self.odometry else None,
                origin="start",
            )
        options = SimOptions(**self.model_dump(exclude={"track"}))
        return simulate_track(self.track, options)


def sized_course(cones: int) -> TrackLayout:
    """Return a random course, blown up until it has as many cones as asked for.

    The count steps by a few cones as the course grows; the first one that reaches it
    is taken.
    """
    center = random_center(np.random.default_rng(cones))
    low, high = 0.1, 30.0
    for _ in range(40):
        scale = float(np.sqrt(low * high))
        count = len(closed_course(SIZED, scale * center, HALF_LANE_M))
        low, high = (scale, high) if count < cones else (low, scale)
    layout = closed_course(SIZED, high * center, HALF_LANE_M)
    return replace(layout, name=f"{SIZED}-{cones}")


def track_names(given: str) -> tuple[str, ...]:
    """Return the closed tracks of a comma-separated list of folders, files and names.

    A folder stands for its track files, without the open ones: they have no laps.
    What cannot be read there is left out, and logged.

    Raises:
        SourceError: nothing is left.
    """
    names: list[str] = []
    for part in filter(None, (p.strip() for p in given.split(","))):
        folder = Path(part)
        if folder.is_dir():
            files = sorted(f for f in folder.iterdir() if f.suffix in (".yaml", ".csv"))
            names += [str(f) for f in files if _is_closed(f)]
        else:
            names.append(part)
    if not names:
        raise SourceError(f"--tracks {given!r}: no closed track there")
    return tuple(names)


def _is_closed(path: Path) -> bool:
    try:
        return read_track(path).closed
    except FileFormatError as error:
        log.warning("left out: %s", error)
        return False


def drives(tracks: tuple[str, ...], seeds: tuple[int, ...]) -> list[tuple[str, int]]:
    """Return (track, seed) pairs: each seed drives one track, in turn.

    With fewer seeds than tracks the rest of the tracks is left out.
    """
    return [(tracks[n % len(tracks)], seed) for n, seed in enumerate(seeds)]
