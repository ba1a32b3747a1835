"""From the text of a SOURCE to something that yields events."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

from conegraph.errors import SourceError

if TYPE_CHECKING:
    from conegraph.camera import Stream
    from conegraph.sim.camera_drive import CameraDrive
    from conegraph.types import Recording, Source, TrackLayout

SCHEMES = ("mrclam", "victoria-park", "sim", "realsense")
NOT_YET = {
    ".mcap": "ROS recordings",
    "metadata.yaml": "ROS recordings",
}
LIGHTS = ("bright", "overcast", "low_sun", "dusk")
PICTURES = "gives pictures, and only cones are of use here"
MAX_LAPS = 1000
MAX_RATE_HZ = 120.0
MAX_DELAY_S = 10.0
MAX_STAND_S = 3600.0


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


def open_stream(text: str, *, seed: int = 0) -> Stream:
    """Open what a SOURCE names, cones or pictures.

    Args:
        text: what `open_source` takes; or a folder with ``rgb.txt``, ``depth.txt``
            and ``camera.toml``, a RealSense recording (``.db3``, ``.bag``),
            ``realsense[:SERIAL]``, or ``sim:TRACK?sensor=rgbd``, which also takes
            ``rate`` and ``light``.
        seed: seed of a simulated source that names none.

    Raises:
        SourceError: it names nothing that can be opened; the text says why.
        FileFormatError: the file is there, and is not what it should be.
        MissingDependencyError: the RealSense library cannot be loaded.
    """
    scheme, colon, rest = text.partition(":")
    if scheme == "sim" and colon:
        track, options = _simulated(rest, seed)
        if options.sensor == "rgbd":
            return render_track(track, options)
    if scheme == "realsense":
        from conegraph.frontend.realsense import LiveCamera

        return LiveCamera(rest)
    path = Path(text)
    if _is_there(path / "rgb.txt"):
        from conegraph.io.rgbd_folder import read_rgbd_folder

        return read_rgbd_folder(path)
    if path.suffix in (".db3", ".bag") and _is_there(path):
        from conegraph.frontend.realsense import read_realsense

        return read_realsense(path)
    return open_source(text, seed=seed)


def _is_there(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _simulated(rest: str, seed: int) -> tuple[str, SimOptions]:
    track, _, query = rest.partition("?")
    return track, parse_sim_query(query, seed=seed)


def open_source(text: str, *, seed: int = 0) -> Source:
    """Open a SOURCE of cones.

    Args:
        text: a folder with a cone log, ``mrclam:FOLDER/RobotN``,
            ``victoria-park[:FILE]`` or
            ``sim:TRACK[?laps=N&seed=N&sensor=camera|lidar&odometry=on|off]``, which
            also takes the numbers that `SimOptions` names, as in ``missed=0.1``.
        seed: seed of a simulated source that names none.

    Raises:
        SourceError: it names nothing that can be opened; the text says why.
        FileFormatError: the file is there, and is not what it should be.
    """
    scheme, colon, rest = text.partition(":")
    if scheme == "sim" and colon:
        return simulate_track(*_simulated(rest, seed))
    if scheme == "mrclam" and colon:
        return _open_mrclam(rest)
    if scheme == "victoria-park":
        from conegraph.io.victoria_park import read_victoria_park

        return read_victoria_park(_existing(rest) if rest else None)
    if scheme == "realsense":
        raise SourceError(f"{text}: {PICTURES}")
    return _open_path(text)


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


def simulate_track(track: str, options: SimOptions) -> Recording:
    """Drive a track, given as a file or by a built-in name, in the simulator.

    ``random`` is made from the options' seed, ``random:7`` always from seed 7. The
    truth is in the frame of the car at its start, the world of the estimates.

    Raises:
        SourceError: neither a file nor a built-in name.
        FileFormatError: the file is no track.
    """
    from conegraph.sim.cone_sensor import CAMERA, LIDAR
    from conegraph.sim.drive import simulate
    from conegraph.sim.faults import StreamFaults
    from conegraph.sim.odometry import OdometrySensor
    from conegraph.sim.vehicle import VehicleModel

    if options.sensor == "rgbd":
        raise SourceError(f"sim:{track}: {PICTURES}")
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
                    f"sim: has no key {key!r}{_hint(key, keys)} "
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
    near = _hint(track, [*BUILT_IN_TRACKS, *_siblings(path)])
    raise SourceError(f"sim:{track}: neither a track file nor one of {names}{near}")


def _open_mrclam(rest: str) -> Recording:
    from conegraph.io.mrclam import read_mrclam

    path = Path(rest)
    folder = _existing(str(path.parent))
    robots = sorted(
        file.name.removesuffix("_Odometry.dat")
        for file in folder.glob("*_Odometry.dat")
    )
    if path.name not in robots:
        there = ", ".join(robots) or "none"
        raise SourceError(
            f"mrclam:{rest}: no {path.name}_Odometry.dat in {folder} (robots there: "
            f"{there}); write mrclam:FOLDER/RobotN"
        )
    return read_mrclam(folder, path.name)


def _open_path(text: str) -> Recording:
    from conegraph.io.cone_log import read_cone_log

    path = _existing(text)
    names = {path.suffix} if path.is_file() else _names_in(path)
    if names & {"cones.csv", "cones.csv.gz"}:
        return read_cone_log(path)
    for mark, what in NOT_YET.items():
        if mark in names:
            raise SourceError(f"{text}: {what} are not supported yet")
    if names & {"rgb.txt", ".db3", ".bag"}:
        raise SourceError(f"{text}: {PICTURES}")
    if path.is_dir():
        if "Barcodes.dat" in names:
            raise SourceError(f"{text}: for a robot's drive write mrclam:{text}/Robot1")
        raise SourceError(f"{text}: no cones.csv in this folder, so no cone log")
    if path.name.startswith("cones.csv"):
        raise SourceError(f"{text}: give the folder, {path.parent}, not the file")
    raise SourceError(
        f"{text}: a file is no SOURCE by itself; to drive it as a track write "
        f"sim:{text}"
    )


def _names_in(folder: Path) -> set[str]:
    files = [file.name for file in folder.iterdir()]
    return {*files, *(Path(name).suffix for name in files)}


def _existing(text: str) -> Path:
    if not text:
        raise SourceError("give a SOURCE: a folder with a cone log, or sim:oval")
    path = Path(text)
    try:
        if path.exists():
            return path
    except OSError as error:
        raise SourceError(f"{text[:80]}: {error.strerror}") from None
    hint = _hint(text, [*(f"{scheme}:" for scheme in SCHEMES), *_siblings(path)])
    raise SourceError(f"{text}: no such file or folder{hint}")


def _siblings(path: Path) -> list[str]:
    if not path.parent.is_dir():
        return []
    return [str(path.parent / file.name) for file in path.parent.iterdir()]


def _hint(given: str, valid: Iterable[str]) -> str:
    near = get_close_matches(given, list(valid), n=1)
    return f"; did you mean {near[0]}?" if near else ""
