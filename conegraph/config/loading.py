"""From TOML and command-line overrides to a `Config`, and back."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from conegraph.config.explain import explain
from conegraph.config.models import BACKENDS, Config
from conegraph.errors import ConfigError

Tree = dict[str, Any]

THESIS: Tree = {
    "backend": {"invariant": False},
    "association": {
        "method": "nearest",
        "gate_d2": 9.0,
        "no_birth_d2": 9.0,
        "ambiguity_d2": 0.0,
        "colour": "same_role",
    },
    "motion": {
        "integration": "euler",
        "odometry_as_input": False,
        "standstill": False,
        "gyro_bias_sigma_radps": 0.0,
        "start_speed_sigma_mps": 0.0,
        "cone_velocity": True,
    },
    "landmarks": {
        "prune": False,
        "publish_hits": 1,
        "publish_log_odds": -1.0,
        "merge_d2": 0.0,
    },
    "start_line": {"forced": True},
    "sensor": {"noise_at": "measured"},
    "recovery": {"enabled": False},
}
"""What the thesis does differently, laid under the user's own keys.

Its car has no odometry; where a source has some, its velocities correct the state
as those from cones do in section 4.4.2; `motion.use_odometry = false` leaves them out.
"""


def load_config(
    path: Path | str | None = None,
    overrides: Sequence[str] = (),
    *,
    backend: str | None = None,
) -> Config:
    """Read a TOML file, apply ``KEY=VALUE`` overrides and the chosen back end.

    ``backend`` is a kind, or ``kind/profile``; it drops the keys that only
    another kind's section has.

    Raises:
        ConfigError: file, key or value cannot be used; the text names them.
    """
    tree = {} if path is None else _read_toml(Path(path))
    for text in overrides:
        _assign(tree, *parse_override(text))
    if backend is not None:
        _choose_backend(tree, backend)
    return resolve_config(tree, origin=None if path is None else str(path))


def resolve_config(tree: Mapping[str, Any], *, origin: str | None = None) -> Config:
    """Lay the profile's defaults under the tree and validate the whole.

    Raises:
        ConfigError: names the first wrong key, its value and the nearest valid key.
    """
    section = tree.get("backend", {})
    profile = section.get("profile") if isinstance(section, Mapping) else None
    merged = _overlay(THESIS if profile == "thesis" else {}, tree)
    if isinstance(merged.get("backend"), dict):
        merged["backend"].setdefault("kind", "ekf")
    try:
        return Config.model_validate(merged)
    except ValidationError as error:
        place = "" if origin is None else f"{origin}: "
        raise ConfigError(place + explain(error)) from None


def config_to_toml(config: Config) -> str:
    """Write every key with its value, so that the run can be repeated exactly."""
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))


def given_to_toml(config: Config) -> str:
    """Write the keys that were given, and no default."""
    given = config.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    return tomli_w.dumps({k: v for k, v in given.items() if v != {}})


def parse_override(text: str) -> tuple[tuple[str, ...], Any]:
    """Split ``a.b=value``; the value is TOML, or a bare string.

    Raises:
        ConfigError: there is no key or no ``=``.
    """
    key, equals, value = text.partition("=")
    parts = tuple(part.strip() for part in key.split("."))
    if not equals or not all(parts):
        raise ConfigError(f"--set {text!r}: expected KEY=VALUE, as in backend.kind=ekf")
    try:
        read = tomllib.loads(f"v = {value}")
    except tomllib.TOMLDecodeError:
        return parts, value.strip()
    return parts, read["v"] if len(read) == 1 else value


def _read_toml(path: Path) -> Tree:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None


def _assign(tree: Tree, parts: tuple[str, ...], value: Any) -> None:
    for depth, part in enumerate(parts[:-1]):
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            key = ".".join(parts[: depth + 1])
            raise ConfigError(f"--set {'.'.join(parts)}: {key} is not a section")
    tree[parts[-1]] = value


def _choose_backend(tree: Tree, backend: str) -> None:
    kind, _, profile = backend.partition("/")
    if kind not in BACKENDS:
        raise ConfigError(
            f"back end {kind!r} does not exist; choose from {', '.join(BACKENDS)}"
        )
    section = tree.setdefault("backend", {})
    if not isinstance(section, dict):
        raise ConfigError("backend is not a section")
    foreign = {key for model in BACKENDS.values() for key in model.model_fields}
    for key in foreign - set(BACKENDS[kind].model_fields):
        section.pop(key, None)
    section["kind"] = kind
    if profile:
        section["profile"] = profile


def _overlay(base: Mapping[str, Any], top: Mapping[str, Any]) -> Tree:
    merged: Tree = {
        k: _overlay(v, {}) if isinstance(v, Mapping) else v for k, v in base.items()
    }
    for key, value in top.items():
        below = merged.get(key)
        if isinstance(value, Mapping):
            under = below if isinstance(below, Mapping) else {}
            merged[key] = _overlay(under, value)
        else:
            merged[key] = value
    return merged
