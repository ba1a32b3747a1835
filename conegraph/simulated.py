"""The simulator as a source: what ``sim:TRACK?KEY=VALUE&...`` asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from conegraph.errors import SourceError

if TYPE_CHECKING:
    from conegraph.sim.camera_drive import CameraDrive
    from conegraph.sim.odometry import OdometrySensor
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
        noise_scale: factor on the noise of cones, not on what is said of it.
        range_scale: factor on the range of every cone, 1.05 is 5 % too far.
        sensor_yaw: angle in rad by which every cone appears too far left.
        stamp_offset: time in s by which the stamps of frames are too late.
        hide_start: 1 for orange cones that are never detected.
        false_start: 1 for a second pair of big orange cones half a lap on.
        yaw_bias: bias of the odometry's yaw rate in rad/s.
        wheel_scale: factor on the odometry's speed.
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
    noise_scale: float = 1.0
    range_scale: float = 1.0
    sensor_yaw: float = 0.0
    stamp_offset: float = 0.0
    hide_start: bool = False
    false_start: bool = False
    yaw_bias: float = 0.0
    wheel_scale: float = 1.0
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
    from conegraph.sim.vehicle import VehicleModel

    if options.sensor == "rgbd":
        raise SourceError(f"sim:{track}: {PICTURES}")
    if options.light or options.rate != SimOptions().rate:
        raise SourceError(f"sim:{track}: rate and light are for sensor=rgbd only")
    sensor = LIDAR if options.sensor == "lidar" else CAMERA
    return simulate(
        track_layout(track, options.seed),
        laps=options.laps,
        seed=options.seed,
        sensor=replace(sensor, delay_s=options.delay),
        vehicle=VehicleModel(stand_s=options.stand),
        odometry=_odometry(options),
        faults=StreamFaults(
            wrong_colour=options.wrong_colour,
            unknown_colour=options.unknown_colour,
            missed=options.missed,
            false_cones=options.false_cones,
            noise_scale=options.noise_scale,
            range_scale=options.range_scale,
            sensor_yaw_rad=options.sensor_yaw,
            stamp_offset_s=options.stamp_offset,
            hide_start=options.hide_start,
            false_start=options.false_start,
        ),
        origin="start",
    )


def _odometry(options: SimOptions) -> OdometrySensor | None:
    """Return wheels and gyro with the faults that are asked for."""
    from conegraph.sim.odometry import OdometrySensor

    if not options.odometry:
        return None
    return OdometrySensor(
        yaw_rate_bias_radps=options.yaw_bias, wheel_scale=options.wheel_scale - 1.0
    )


def render_track(track: str, options: SimOptions) -> CameraDrive:
    """Drive a track as `simulate_track` does, with an RGB-D camera on the car.

    Raises:
        SourceError: neither a file nor a built-in name, or no such light.
        FileFormatError: the file is no track.
    """
    from conegraph.sim.camera_drive import drive_with_camera
    from conegraph.sim.render import LIGHT_NAMES
    from conegraph.sim.vehicle import VehicleModel

    light = next((name for name in LIGHT_NAMES if name == options.light), None)
    return drive_with_camera(
        track_layout(track, options.seed),
        laps=options.laps,
        seed=options.seed,
        rate_hz=options.rate,
        light=light,
        vehicle=VehicleModel(stand_s=options.stand),
        odometry=_odometry(options),
    )


def parse_sim_query(query: str, *, seed: int = 0) -> SimOptions:
    """Read ``laps=3&sensor=lidar`` and so on; what is left out keeps its default.

    Raises:
        SourceError: an unknown key (the nearest is named) or a value that is none.
    """
    given: dict[str, Any] = {"seed": seed}
    for item in filter(None, query.split("&")):
        key, _, value = item.partition("=")
        if key not in _READ:
            raise SourceError(
                f"sim: has no key {key!r}{hint(key, _READ)} "
                f"(it has {', '.join(SimOptions.__dataclass_fields__)})"
            )
        given[key] = _READ[key](item, value)
    options = SimOptions(**given)
    if options.wrong_colour + options.unknown_colour > 1.0:
        raise SourceError("sim: wrong_colour and unknown_colour add up to more than 1")
    return options


def _share(item: str, value: str) -> float:
    return _number(item, value, 0.0, 1.0, "a share, 0 to 1")


def _scale(item: str, value: str) -> float:
    return _number(item, value, 0.5, 2.0, "a factor, 0.5 to 2")


def _noise(item: str, value: str) -> float:
    return _number(item, value, 1.0, 100.0, "a factor, 1 to 100")


def _rad(item: str, value: str) -> float:
    return _number(item, value, -1.0, 1.0, "rad or rad/s, -1 to 1")


def _delay(item: str, value: str) -> float:
    return _number(item, value, 0.0, MAX_DELAY_S, f"seconds, 0 to {MAX_DELAY_S:g}")


def _stand(item: str, value: str) -> float:
    return _number(item, value, 0.0, MAX_STAND_S, f"seconds, 0 to {MAX_STAND_S:g}")


def _rate(item: str, value: str) -> float:
    kind = f"Hz, up to {MAX_RATE_HZ:g}"
    rate = _number(item, value, 0.0, MAX_RATE_HZ, kind)
    if rate <= 0.0:
        raise SourceError(f"sim: {item!r}: expected more than 0 Hz")
    return rate


def _number(item: str, value: str, low: float, high: float, kind: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not low <= number <= high:
        raise SourceError(f"sim: {item!r}: expected {kind}")
    return number


def _switch(item: str, value: str) -> bool:
    return _whole(item, value, 0, 1) == 1


def _whole(item: str, value: str, low: int, high: int) -> int:
    if not (value.isascii() and value.isdigit() and low <= int(value) <= high):
        raise SourceError(f"sim: {item!r}: expected a whole number, {low} to {high}")
    return int(value)


def _one_of(*allowed: str) -> Callable[[str, str], str]:
    *others, last = allowed

    def read(item: str, value: str) -> str:
        if value not in allowed:
            names = f"{', '.join(others)} or {last}"
            raise SourceError(f"sim: {item!r}: expected {names}")
        return value

    return read


_READ: dict[str, Callable[[str, str], object]] = {
    "laps": lambda item, value: _whole(item, value, 1, MAX_LAPS),
    "seed": lambda item, value: _whole(item, value, 0, 2**63 - 1),
    "sensor": _one_of("camera", "lidar", "rgbd"),
    "odometry": lambda item, value: _one_of("on", "off")(item, value) == "on",
    "wrong_colour": _share,
    "unknown_colour": _share,
    "missed": _share,
    "false_cones": _share,
    "noise_scale": _noise,
    "range_scale": _scale,
    "sensor_yaw": _rad,
    "stamp_offset": _delay,
    "hide_start": _switch,
    "false_start": _switch,
    "yaw_bias": _rad,
    "wheel_scale": _scale,
    "delay": _delay,
    "stand": _stand,
    "rate": _rate,
    "light": _one_of(*LIGHTS),
}
"""What reads the value of each key."""


def track_layout(track: str, seed: int = 0) -> TrackLayout:
    """Return the layout of a track, given as a file or by a built-in name.

    Raises:
        SourceError: neither; the nearest name is given.
        FileFormatError: the file is no track.
    """
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
