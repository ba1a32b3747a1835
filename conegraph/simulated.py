"""The simulator as a source: what ``sim:TRACK?KEY=VALUE&...`` asks for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

from conegraph.errors import SourceError

if TYPE_CHECKING:
    from conegraph.sim.camera_drive import CameraDrive
    from conegraph.types import Recording, TrackLayout

LIGHTS = ("bright", "overcast", "low_sun", "dusk")
MAX_LAPS = 1000
MAX_DELAY_S = 10.0
MAX_STAND_S = 3600.0
MAX_RATE_HZ = 120.0
PICTURES = "gives pictures, and only cones are of use here"


@dataclass(frozen=True, slots=True)
class SimOptions:
    """How to drive a track in the simulator.

    Attributes:
        laps: laps to complete.
        seed: seed of everything random.
        sensor: ``camera`` or ``lidar`` for cones, ``rgbd`` for pictures.
        odometry: whether wheels and gyro are recorded too.
        wrong_colour: share of detections that are given another colour.
        unknown_colour: share of detections whose class is taken away.
        missed: share of detections that are left out.
        false_cones: false detections added for each one that there was.
        delay: time in s between a frame's stamp and its arrival; odometry has none.
        stand: time in s that the car stands before it sets off.
        rate: pictures per second.
        light: light of the pictures, one of `LIGHTS`; by chance where it is empty.
    """

    laps: int = 2
    seed: int = 0
    sensor: str = "camera"
    odometry: bool = True
    wrong_colour: float = 0.0
    unknown_colour: float = 0.0
    missed: float = 0.0
    false_cones: float = 0.0
    delay: float = 0.0
    stand: float = 1.0
    rate: float = 15.0
    light: str = ""


def simulate_track(track: str, options: SimOptions) -> Recording:
    """Drive a track, given as a file or by a built-in name, in the simulator.

    ``random`` is made from the options' seed, ``random:7`` always from seed 7. The
    truth is in the frame of the car at its start, the world of the estimates.

    Raises:
        SourceError: neither a file nor a built-in name, or options of pictures.
        FileFormatError: the file is no track.
    """
    from conegraph.sim.cone_sensor import CAMERA, LIDAR
    from conegraph.sim.drive import simulate
    from conegraph.sim.faults import StreamFaults
    from conegraph.sim.odometry import OdometrySensor
    from conegraph.sim.vehicle import VehicleModel

    if options.sensor == "rgbd":
        raise SourceError(f"sim:{track}: {PICTURES}")
    if options.light or options.rate != SimOptions().rate:
        raise SourceError(f"sim:{track}: rate and light are for sensor=rgbd only")
    sensor = LIDAR if options.sensor == "lidar" else CAMERA
    return simulate(
        _layout(track, options.seed),
        laps=options.laps,
        seed=options.seed,
        sensor=replace(sensor, delay_s=options.delay),
        vehicle=VehicleModel(stand_s=options.stand),
        odometry=OdometrySensor() if options.odometry else None,
        faults=StreamFaults(
            options.wrong_colour,
            options.unknown_colour,
            options.missed,
            options.false_cones,
        ),
        origin="start",
    )


def render_track(track: str, options: SimOptions) -> CameraDrive:
    """Drive a track as `simulate_track` does, with an RGB-D camera on the car.

    Raises:
        SourceError: neither a file nor a built-in name, or no such light.
        FileFormatError: the file is no track.
    """
    from conegraph.sim.camera_drive import drive_with_camera
    from conegraph.sim.odometry import OdometrySensor
    from conegraph.sim.render import LIGHT_NAMES
    from conegraph.sim.vehicle import VehicleModel

    light = next((name for name in LIGHT_NAMES if name == options.light), None)
    return drive_with_camera(
        _layout(track, options.seed),
        laps=options.laps,
        seed=options.seed,
        rate_hz=options.rate,
        light=light,
        vehicle=VehicleModel(stand_s=options.stand),
        odometry=OdometrySensor() if options.odometry else None,
    )


def parse_sim_query(query: str, *, seed: int = 0) -> SimOptions:
    """Read ``laps=3&sensor=lidar`` and so on; what is left out keeps its default.

    Raises:
        SourceError: an unknown key (the nearest is named) or a value that is none.
    """
    options = SimOptions(seed=seed)
    for item in filter(None, query.split("&")):
        key, _, value = item.partition("=")
        match key:
            case "laps":
                options = replace(options, laps=_whole(item, value, 1, MAX_LAPS))
            case "seed":
                options = replace(options, seed=_whole(item, value, 0, 2**63 - 1))
            case "sensor":
                _one_of(item, value, ("camera", "lidar", "rgbd"))
                options = replace(options, sensor=value)
            case "odometry":
                _one_of(item, value, ("on", "off"))
                options = replace(options, odometry=value == "on")
            case "wrong_colour":
                options = replace(options, wrong_colour=_share(item, value))
            case "unknown_colour":
                options = replace(options, unknown_colour=_share(item, value))
            case "missed":
                options = replace(options, missed=_share(item, value))
            case "false_cones":
                options = replace(options, false_cones=_share(item, value))
            case "delay":
                options = replace(options, delay=_seconds(item, value, MAX_DELAY_S))
            case "stand":
                options = replace(options, stand=_seconds(item, value, MAX_STAND_S))
            case "rate":
                rate = _number(item, value, MAX_RATE_HZ, f"Hz, up to {MAX_RATE_HZ:g}")
                if rate <= 0.0:
                    raise SourceError(f"sim: {item!r}: expected more than 0 Hz")
                options = replace(options, rate=rate)
            case "light":
                _one_of(item, value, LIGHTS)
                options = replace(options, light=value)
            case _:
                keys = tuple(SimOptions.__dataclass_fields__)
                raise SourceError(
                    f"sim: has no key {key!r}{hint(key, keys)} "
                    f"(it has {', '.join(keys)})"
                )
    if options.wrong_colour + options.unknown_colour > 1.0:
        raise SourceError("sim: wrong_colour and unknown_colour add up to more than 1")
    return options


def _share(item: str, value: str) -> float:
    return _number(item, value, 1.0, "a share, 0 to 1")


def _seconds(item: str, value: str, most_s: float) -> float:
    return _number(item, value, most_s, f"seconds, 0 to {most_s:g}")


def _number(item: str, value: str, most: float, kind: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = -1.0
    if not 0.0 <= number <= most:
        raise SourceError(f"sim: {item!r}: expected {kind}")
    return number


def _whole(item: str, value: str, low: int, high: int) -> int:
    if not (value.isascii() and value.isdigit() and low <= int(value) <= high):
        raise SourceError(f"sim: {item!r}: expected a whole number, {low} to {high}")
    return int(value)


def _one_of(item: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        *others, last = allowed
        names = f"{', '.join(others)} or {last}"
        raise SourceError(f"sim: {item!r}: expected {names}")


def _layout(track: str, seed: int) -> TrackLayout:
    from conegraph.io.tracks import read_track
    from conegraph.sim.track_shapes import BUILT_IN_TRACKS, built_in_track

    if track in BUILT_IN_TRACKS:
        return built_in_track(track, seed)
    shape, _, number = track.partition(":")
    if shape == "random" and number.isascii() and number.isdigit():
        course = built_in_track(shape, int(number))
        return replace(course, name=f"random-{number}")
    path = Path(track)
    if track and path.is_file():
        return read_track(path)
    names = ", ".join(BUILT_IN_TRACKS)
    near = hint(track, [*BUILT_IN_TRACKS, *siblings(path)])
    raise SourceError(f"sim:{track}: neither a track file nor one of {names}{near}")


def siblings(path: Path) -> list[str]:
    """Return what lies in the folder that a path names something in."""
    if not path.parent.is_dir():
        return []
    return [str(path.parent / file.name) for file in path.parent.iterdir()]


def hint(given: str, valid: Iterable[str]) -> str:
    """Return ``; did you mean ...?`` if something valid is near, else nothing."""
    near = get_close_matches(given, list(valid), n=1)
    return f"; did you mean {near[0]}?" if near else ""
