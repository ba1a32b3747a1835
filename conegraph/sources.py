"""From the text of a SOURCE to something that yields events."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from conegraph.errors import SourceError
from conegraph.simulated import (
    MAX_LAPS,
    MAX_RATE_HZ,
    PICTURES,
    SimOptions,
    hint,
    parse_sim_query,
    render_track,
    siblings,
    simulate_track,
)

if TYPE_CHECKING:
    from conegraph.camera import Stream
    from conegraph.types import Recording, Source

__all__ = [
    "MAX_LAPS",
    "MAX_RATE_HZ",
    "SimOptions",
    "open_source",
    "open_stream",
    "parse_sim_query",
    "render_track",
    "simulate_track",
]
SCHEMES = ("mrclam", "victoria-park", "sim", "realsense")
NOT_YET = {
    ".mcap": "ROS recordings",
    "metadata.yaml": "ROS recordings",
}


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
        from conegraph.frontend.realsense_live import LiveCamera

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
        raise SourceError(f"{text}: neither cones.csv nor rgb.txt is in this folder")
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
    near = hint(text, [*(f"{scheme}:" for scheme in SCHEMES), *siblings(path)])
    raise SourceError(f"{text}: no such file or folder{near}")
