"""TOML in, frozen values out, and errors that say which key to mend."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from conegraph.config import (
    Config,
    EkfConfig,
    HsvConfig,
    HsvThesisConfig,
    Isam2Config,
    YoloConfig,
    config_to_toml,
    load_config,
    parse_override,
    resolve_config,
)
from conegraph.config.explain import key_paths, nearest_key
from conegraph.errors import ConfigError

CHOICES: dict[str, list[type[BaseModel]]] = {
    "backend": [EkfConfig, Isam2Config],
    "detector": [HsvConfig, HsvThesisConfig, YoloConfig],
}
positive = st.floats(1e-9, 1e9)


def mutate(model: BaseModel) -> st.SearchStrategy[dict[str, Any]]:
    """Draw other values for some of the model's keys, type by type."""
    choices: dict[str, st.SearchStrategy[Any]] = {}
    for name, field in type(model).model_fields.items():
        default = getattr(model, name)
        options = [o for o in get_args(field.annotation) if isinstance(o, str | int)]
        if isinstance(default, BaseModel):
            models = [b() for b in CHOICES.get(name, [type(default)])]
            choices[name] = st.one_of([mutate(m) for m in models])
        elif options:
            choices[name] = st.sampled_from(options)
        elif isinstance(default, bool):
            choices[name] = st.booleans()
        elif isinstance(default, int):
            choices[name] = st.integers(1, 4)
        elif isinstance(default, str):
            choices[name] = st.text()
        elif isinstance(default, tuple):
            choices[name] = st.just(default)
        elif name == "range_sigma_m":
            choices[name] = st.tuples(positive, positive, positive)
        else:
            choices[name] = st.floats(1e-9, 0.9)
    tags = [name for name in ("kind", "profile") if name in choices]
    required = {name: choices.pop(name) for name in tags}
    return st.fixed_dictionaries(required, optional=choices)


@given(mutate(Config()))
def test_any_config_survives_toml(tree: dict[str, Any]) -> None:
    config = resolve_config(tree)
    assert resolve_config(tomllib.loads(config_to_toml(config))) == config


@pytest.mark.parametrize("backend", ["ekf", "isam2", "ekf/thesis", "isam2/thesis"])
def test_resolved_file_gives_the_same_config(tmp_path: Path, backend: str) -> None:
    config = load_config(backend=backend)
    file = tmp_path / "config.toml"
    file.write_text(config_to_toml(config), encoding="utf-8")
    assert load_config(file) == config
    assert config_to_toml(load_config(file)) == file.read_text(encoding="utf-8")


def test_every_key_and_section_says_what_it_is() -> None:
    assert {key for key, text in key_paths().items() if len(text) < 10} == set()
    assert {"seed", "backend.polish", "association.gate_d2"} <= key_paths().keys()
    schema = json.dumps(Config.model_json_schema())
    for text in key_paths().values():
        assert json.dumps(text.split("\n")[0])[1:-1] in schema


@pytest.mark.parametrize(
    ("key", "nearest"),
    [
        ("backend.gate_chi", "association.gate_d2"),
        ("backend.gate_d2", "association.gate_d2"),
        ("asociation.gate_d2", "association.gate_d2"),
        ("gate.max_range", "gate.max_range_m"),
        ("sensor.max_range", "sensor.max_range_m"),
        ("backend.knd", "backend.kind"),
        ("detector.roi", "detector.roi_top"),
        ("motion.slip", "motion.slip_sigma_m_per_sqrt_m"),
        ("sensor.min_range", "sensor.max_range_m"),
        ("sed", "seed"),
        ("gyro_bias_sigma", "motion.gyro_bias_sigma_radps"),
        ("prune", "landmarks.prune"),
    ],
)
def test_unknown_keys_are_refused_with_the_nearest(key: str, nearest: str) -> None:
    assert nearest_key(key) == nearest
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=[f"{key}=1"])
    assert str(caught.value) == f"{key}: no such key; did you mean {nearest}?"


@given(st.sampled_from(sorted(key_paths())))
def test_a_valid_key_is_nearest_to_itself(key: str) -> None:
    assert nearest_key(key) == key


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["backend.polish=true"],
            "backend.polish belongs to isam2, not to ekf",
        ),
        (
            ["backend.kind=icp"],
            "backend.kind: 'icp' is none of ekf, isam2",
        ),
        (
            ["association.gate_d2=-3"],
            "association.gate_d2: Input should be greater than 0 (got -3)",
        ),
        (
            ["association.gate_d2=true"],
            "association.gate_d2: Input should be a valid number (got True)",
        ),
        (
            ["landmarks.delete_log_odds=inf"],
            "landmarks.delete_log_odds: Input should be a finite number (got inf)",
        ),
        (
            ["motion.use_odometry=no"],
            "motion.use_odometry: Input should be a valid boolean (got 'no')",
        ),
        (
            ["association=nearest"],
            "association is a section of keys, not a value (got 'nearest')",
        ),
        (
            ["seed=1", "seed.value=2"],
            "--set seed.value: seed is not a section",
        ),
        (
            ["seed"],
            "--set 'seed': expected KEY=VALUE, as in backend.kind=ekf",
        ),
        (
            ["association.ekf=1"],
            "association.ekf: no such key; did you mean association.method?",
        ),
    ],
)
def test_bad_values_are_named_in_one_line(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=overrides)
    assert str(caught.value) == message


def test_long_values_are_cut_in_the_message() -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=["seed=" + "x" * 10_000])
    assert len(str(caught.value)) < 200


def test_errors_of_a_file_name_it(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    with pytest.raises(ConfigError, match=r"c\.toml: no such file"):
        load_config(file)
    file.write_text("[backend]\nkind = ekf\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"c\.toml: not valid TOML: .*line 2"):
        load_config(file)
    file.write_text("[association]\ngate = 3\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"c\.toml: association\.gate: no such key"):
        load_config(file)
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(file)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a.b=3", 3),
        ("a.b=3.5", 3.5),
        ("a.b=true", True),
        ("a.b=[1, 2]", [1, 2]),
        ('a.b="3"', "3"),
        ("a.b=same_role", "same_role"),
        ("a.b=sim:oval?laps=2", "sim:oval?laps=2"),
        ("a.b=x\nc=4", "x\nc=4"),
        ("a.b=1\nc=4", "1\nc=4"),
        ("a.b=", ""),
    ],
)
def test_override_values_are_toml_or_bare_text(text: str, value: object) -> None:
    assert parse_override(text) == (("a", "b"), value)


def test_choosing_a_back_end_drops_only_the_other_ones_keys(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text(
        '[backend]\nkind = "isam2"\npolish = false\ninvariant = false\n',
        encoding="utf-8",
    )
    ekf = load_config(file, backend="ekf").backend
    assert ekf == EkfConfig(invariant=False)
    isam2 = load_config(file, backend="isam2").backend
    assert isam2 == Isam2Config(invariant=False, polish=False)
    with pytest.raises(ConfigError, match="'icp' does not exist; choose from ekf"):
        load_config(backend="icp")


def test_thesis_profile_lies_under_the_users_keys() -> None:
    config = load_config(overrides=["association.gate_d2=5"], backend="isam2/thesis")
    assert config.backend.profile == "thesis"
    assert config.association.gate_d2 == 5
    assert config.association.method == "nearest"
    assert not config.backend.invariant
    assert config.start_line.forced
    assert not Config().start_line.forced


def test_resolving_leaves_the_given_tree_alone() -> None:
    tree: dict[str, Any] = {"backend": {"polish": True}}
    with pytest.raises(ConfigError):
        resolve_config(tree)
    assert tree == {"backend": {"polish": True}}


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("detector.profile=best", "detector.kind: 'hsv/best' is none of hsv, hsv/the"),
        ("detector.kind=net", "detector.kind: 'net' is none of hsv"),
        ("detector.colour_radius=3", "belongs to hsv/thesis, not to yolo"),
        ("detector.min_pixel=3", "did you mean detector.min_pixels?"),
        ("detector=3", "detector is a section of keys"),
        ("detector.min_score=2", "detector.min_score: Input should be less"),
    ],
)
def test_a_wrong_detector_key_is_named(override: str, said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        load_config(None, [override])


def test_each_detector_profile_has_its_own_keys() -> None:
    thesis = load_config(None, ["detector.profile=thesis", "detector.median_px=3"])
    assert isinstance(thesis.detector, HsvThesisConfig)
    assert thesis.detector.median_px == 3
    assert isinstance(load_config().detector, YoloConfig)
    by_colour = load_config(None, ["detector.kind=hsv", "detector.blue_hue=[90, 99]"])
    assert isinstance(by_colour.detector, HsvConfig)
