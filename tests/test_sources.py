"""Every SOURCE opens, and every wrong one says what to write instead."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conegraph.camera import RgbdFrame
from conegraph.cli.simulate import LightName
from conegraph.errors import ConegraphError, SourceError
from conegraph.sim.camera_drive import CameraDrive
from conegraph.sim.render import LIGHT_NAMES
from conegraph.simulated import LIGHTS
from conegraph.sources import SimOptions, open_source, open_stream, parse_sim_query
from conegraph.types import ConeObservations, Recording, Source, VelocityObservation

CONES = "t,x,y,class\n0,1,2,blue\n0,3,-2,yellow\n0.1,1.5,2,blue\n"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    folder = tmp_path / "log"
    folder.mkdir()
    (folder / "cones.csv").write_text(CONES, encoding="utf-8")
    return folder


def frame_sizes(source: Source) -> list[int]:
    return [len(e) for e in source.events() if isinstance(e, ConeObservations)]


def test_a_folder_with_cones_is_a_cone_log(log: Path) -> None:
    source = open_source(str(log))
    assert source.name == "log"
    assert frame_sizes(source) == [2, 1]


def test_a_sim_query_sets_what_it_names() -> None:
    assert parse_sim_query("", seed=7) == SimOptions(2, 7, "camera", True)
    query = "laps=5&seed=3&sensor=lidar&odometry=off"
    assert parse_sim_query(query, seed=7) == SimOptions(5, 3, "lidar", False)
    query = "wrong_colour=0.02&unknown_colour=0.2&missed=0.1&false_cones=1e-2"
    faults = SimOptions(2, 7, "camera", True, 0.02, 0.2, 0.1, 0.01)
    assert parse_sim_query(query, seed=7) == faults


def test_a_random_track_may_name_its_own_seed() -> None:
    first, second = (open_source(f"sim:random:7?laps=1&seed={n}") for n in (1, 2))
    assert first.truth_map is not None
    assert second.truth_map is not None
    own = open_source("sim:random?laps=1&seed=7")
    assert own.truth_map is not None
    # Each drive wanders from its first metre, and the truth is seen from its start.
    np.testing.assert_allclose(own.truth_map.xy_m, first.truth_map.xy_m, atol=0.01)
    np.testing.assert_allclose(own.truth_map.xy_m, second.truth_map.xy_m, atol=0.01)


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("lap=3", "sim: has no key 'lap'; did you mean laps?"),
        (
            "noise=3",
            "sim: has no key 'noise'; did you mean noise_scale? "
            "(it has laps, seed, sensor, odometry, ",
        ),
        ("laps=0", "sim: 'laps=0': expected a whole number, 1 to 1000"),
        ("laps=1e9", "sim: 'laps=1e9': expected a whole number, 1 to 1000"),
        ("laps", "sim: 'laps': expected a whole number, 1 to 1000"),
        ("seed=-1", "sim: 'seed=-1': expected a whole number, 0 to"),
        ("seed=²", "sim: 'seed=²': expected a whole number, 0 to"),
        ("sensor=radar", "sim: 'sensor=radar': expected camera, lidar or rgbd"),
        ("odometry=yes", "sim: 'odometry=yes': expected on or off"),
        ("rate=0", "sim: 'rate=0': expected more than 0 Hz"),
        ("light=dark", "sim: 'light=dark': expected bright, overcast, low_sun or dusk"),
        ("missed=1.5", "sim: 'missed=1.5': expected a share, 0 to 1"),
        ("false_cones=nan", "sim: 'false_cones=nan': expected a share, 0 to 1"),
        ("wrong_colour=few", "sim: 'wrong_colour=few': expected a share, 0 to 1"),
        (
            "wrong_colour=0.6&unknown_colour=0.6",
            "sim: wrong_colour and unknown_colour add up to more than 1",
        ),
    ],
)
def test_a_wrong_sim_query_names_the_key(query: str, message: str) -> None:
    with pytest.raises(SourceError) as caught:
        open_source(f"sim:oval?{query}")
    assert str(caught.value).startswith(message)


def test_a_built_in_track_is_driven_with_the_seed_that_counts() -> None:
    default = open_source("sim:oval?laps=1", seed=4)
    named = open_source("sim:oval?laps=1&seed=4")
    other = open_source("sim:oval?laps=1", seed=5)
    first, same, different = (
        next(e for e in s.events() if isinstance(e, ConeObservations) and len(e))
        for s in (default, named, other)
    )
    assert (first.xy_m == same.xy_m).all()
    assert first.xy_m.shape != different.xy_m.shape or (
        (first.xy_m != different.xy_m).any()
    )


def test_odometry_can_be_switched_off() -> None:
    for switch, expected in (("on", True), ("off", False)):
        source = open_source(f"sim:oval?laps=1&odometry={switch}")
        kinds = {type(event) for event in source.events()}
        assert (VelocityObservation in kinds) is expected


def test_a_track_file_is_driven(tmp_path: Path) -> None:
    track = tmp_path / "ring.csv"
    rows = ["x,y,class"]
    for cone_class, radius in (("blue", 13.5), ("yellow", 16.5)):
        for i in range(24):
            angle = i * 15.0
            x, y = _polar(radius, angle)
            rows.append(f"{x},{y},{cone_class}")
    track.write_text("\n".join(rows) + "\n", encoding="utf-8")
    source = open_source(f"sim:{track}?laps=1")
    assert source.truth_map is not None
    assert len(source.truth_map) == 48
    assert sum(frame_sizes(source)) > 48


def _polar(radius_m: float, angle_deg: float) -> tuple[float, float]:
    import math

    angle = math.radians(angle_deg)
    return radius_m * math.cos(angle), radius_m * math.sin(angle)


@pytest.mark.parametrize(
    ("make", "text", "message"),
    [
        ("", "{}/lgo", "{}/lgo: no such file or folder; did you mean {}/log?"),
        ("", "{}/nowhere/x", "{}/nowhere/x: no such file or folder"),
        ("", "{}/log/cones.csv", "{}/log/cones.csv: give the folder, {}/log, not"),
        ("", "", "give a SOURCE"),
        ("bag/a.txt", "{}/bag", "{}/bag: neither cones.csv nor rgb.txt"),
        ("track.yaml", "{}/track.yaml", "{}/track.yaml: a file is no SOURCE by"),
        ("r.bag", "{}/r.bag", "{}/r.bag: gives pictures, and only cones"),
        ("r.mcap", "{}/r.mcap", "{}/r.mcap: ROS recordings are not supported yet"),
        ("b/metadata.yaml", "{}/b", "{}/b: ROS recordings are not supported yet"),
        ("tum/rgb.txt", "{}/tum", "{}/tum: gives pictures, and only cones"),
        ("", "realsense", "realsense: gives pictures, and only cones"),
        ("", "realsense:123", "realsense:123: gives pictures, and only cones"),
        ("", "sim:oval?sensor=rgbd", "sim:oval: gives pictures, and only cones"),
        ("m/Barcodes.dat", "{}/m", "{}/m: for a robot's drive write mrclam:{}/m/Robo"),
        ("", "mrclam:{}/log/Robot1", "mrclam:{}/log/Robot1: no Robot1_Odometry.dat"),
        ("", "mrclam:{}/lgo/Robot1", "{}/lgo: no such file or folder; did you mean"),
        ("", "victoria-park:{}/v.txt", "{}/v.txt: no such file or folder"),
        ("", "victoria-prak", "victoria-prak: no such file or folder; did you mean v"),
        ("", "sim:ovall", "sim:ovall: neither a track file nor one of"),
        ("oval.csv", "sim:{}/ovl.csv", "sim:{}/ovl.csv: neither a track file nor one"),
    ],
)
def test_what_cannot_be_opened_says_why(
    log: Path, make: str, text: str, message: str
) -> None:
    root = log.parent
    if make:
        (root / make).parent.mkdir(exist_ok=True)
        (root / make).touch()
    with pytest.raises(SourceError) as caught:
        open_source(text.format(root))
    assert str(caught.value).startswith(message.format(root, root))


@pytest.mark.parametrize("query", ["light=dusk", "rate=30"])
def test_options_of_pictures_are_not_ignored_without_pictures(query: str) -> None:
    with pytest.raises(SourceError, match="rate and light are for sensor=rgbd only"):
        open_source(f"sim:oval?{query}")


def test_a_drive_can_be_had_as_pictures() -> None:
    stream = open_stream("sim:acceleration?sensor=rgbd&rate=2&light=dusk&seed=3")
    assert isinstance(stream, CameraDrive)
    assert stream.scene.light.name == "dusk"
    frame = next(e for e in stream.events() if isinstance(e, RgbdFrame))
    assert frame.color.shape == (480, 640, 3)
    assert stream.n_frames is not None
    duration = stream.truth_trajectory.stamp_s[-1]
    assert stream.n_frames == int(duration * 2) + 1


def test_lights_are_those_of_the_renderer() -> None:
    assert LIGHTS == LIGHT_NAMES == tuple(LightName)


def test_a_stream_may_be_of_cones(log: Path) -> None:
    assert isinstance(open_stream(str(log)), Recording)


@pytest.mark.parametrize(
    ("make", "text", "message"),
    [
        ("tum/rgb.txt", "{}/tum", "{}/tum/depth.txt: is missing: not an RGB-D"),
        ("r.bag", "{}/r.bag", "{}/r.bag: is no RealSense recording: "),
        ("r.db3", "{}/r.db3", "{}/r.db3: is no RealSense recording: "),
        ("", "{}/none.db3", "{}/none.db3: no such file or folder"),
    ],
)
def test_pictures_that_cannot_be_opened_say_why(
    tmp_path: Path, make: str, text: str, message: str
) -> None:
    if make:
        (tmp_path / make).parent.mkdir(exist_ok=True)
        (tmp_path / make).touch()
    with pytest.raises(ConegraphError) as caught:
        open_stream(text.format(tmp_path))
    assert str(caught.value).startswith(message.format(tmp_path))


@pytest.mark.parametrize("text", ["sim:", "sim:?laps=1", "mrclam:", "\0", "a" * 5000])
def test_odd_text_is_a_known_error(text: str) -> None:
    with pytest.raises(ConegraphError):
        open_source(text)


def test_the_real_drives_open(data_dir: Path) -> None:
    robot = open_source(f"mrclam:{data_dir}/mrclam6/Robot1")
    assert robot.truth_map is not None
    assert len(robot.truth_map) == 15
    with pytest.raises(SourceError, match=r"robots there: Robot1, Robot2, Robot3"):
        open_source(f"mrclam:{data_dir}/mrclam6/Robot9")
    assert open_source("victoria-park").n_frames == 6969


def test_without_the_realsense_library_one_sentence_says_what_to_install(
    tmp_path: Path,
) -> None:
    recording = tmp_path / "drive.db3"
    recording.touch()
    for source in ("realsense", str(recording)):
        # None in sys.modules is how Python itself says that a module is not there.
        code = (
            "import sys\n"
            "sys.modules['pyrealsense2'] = None\n"
            "from conegraph.cli import main\n"
            f"main(['record', {source!r}, '--out', {str(tmp_path / 'out')!r}])\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
        assert done.returncode == 1
        assert "apt install libusb-1.0-0" in done.stderr
        assert done.stderr.count("\n") == 1
