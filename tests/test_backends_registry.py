"""Back ends by name."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import conegraph.backends
from conegraph.backends import make_backend
from conegraph.backends.registry import BACKENDS
from conegraph.config import (
    EkfConfig,
    Isam2Config,
    load_config,
    resolve_config,
)
from conegraph.errors import ConfigError, MissingDependencyError
from conegraph.types import ConeMap, ConeObservations, SensorModel


@pytest.mark.parametrize("kind", ["ekf", "isam2"])
def test_the_backend_section_alone_makes_a_back_end(kind: str) -> None:
    config = load_config(backend=kind)
    backend = make_backend(config.backend)
    assert (
        type(backend).__name__ == {"ekf": "EkfBackend", "isam2": "Isam2Backend"}[kind]
    )
    assert len(backend.cone_map()) == 0
    estimate = backend.estimate()
    np.testing.assert_array_equal(estimate.pose, np.zeros(3))
    assert backend.finish() is None
    assert backend.last_frame is None
    assert dict(backend.rejected) == {}


def test_the_section_decides_even_beside_another_configuration() -> None:
    config = resolve_config({"backend": {"kind": "ekf"}})
    backend = make_backend(Isam2Config(), config)
    assert type(backend).__name__ == "Isam2Backend"


def test_a_profile_brings_its_own_defaults() -> None:
    empty = np.zeros((0, 2))
    first = ConeObservations(0.0, empty, empty, empty)
    doubts = []
    for section in (EkfConfig(profile="thesis", invariant=False), EkfConfig()):
        backend = make_backend(section)
        backend.observe_cones(first)
        backend.predict(0.1)
        doubts.append(backend.estimate().pose_cov[0, 0])
    # The thesis starts at rest for sure, and an acceleration of 6 m/s^2 is all there
    # is in 0.1 s; by default the start's speed is doubted by 2 m/s beside.
    assert doubts[0] == pytest.approx((6.0 * 0.1**2 / 2) ** 2)
    assert doubts[1] == pytest.approx((6.0 * 0.1**2 / 2) ** 2 + (2.0 * 0.1) ** 2)


def test_a_known_map_and_a_sensor_are_handed_on() -> None:
    known = ConeMap(
        np.array([4]),
        np.array([[5.0, 1.0]]),
        0.01 * np.eye(2)[None],
        np.array([[0.9, 0.025, 0.025, 0.025, 0.025]]),
        np.array([9]),
    )
    sensor = SensorModel(np.array([0.1, 0.0, 0.0]), 0.01)
    for section in (EkfConfig(), Isam2Config()):
        backend = make_backend(section, sensor=sensor, known_map=known, add_cones=False)
        np.testing.assert_array_equal(backend.cone_map().id, [4])
        np.testing.assert_allclose(backend.cone_map().xy_m, [[5.0, 1.0]])


def test_a_missing_solver_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.startswith("conegraph.backends.")]:
        if name.endswith(("isam2", "mapper", "snapshot", "factors")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(MissingDependencyError, match=r"isam2 needs .*gtsam") as error:
        make_backend(Isam2Config())
    assert "--backend ekf works without" in str(error.value)
    make_backend(EkfConfig())


def test_a_missing_module_of_our_own_is_not_called_a_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(BACKENDS, "ekf", "conegraph.backends.nowhere:EkfBackend")
    with pytest.raises(ModuleNotFoundError, match=r"conegraph\.backends\.nowhere"):
        make_backend(EkfConfig())


def test_back_ends_that_do_not_exist_are_config_errors() -> None:
    with pytest.raises(ConfigError, match="gtsam"):
        load_config(backend="gtsam")
    with pytest.raises(ConfigError, match=r"backend.*kind|kind"):
        resolve_config({"backend": {"kind": "gtsam"}})
    with pytest.raises(ConfigError, match="robust_width"):
        resolve_config({"backend": {"kind": "ekf", "robust_width": 1.0}})


def test_every_registered_back_end_can_be_configured_and_the_reverse() -> None:
    for kind in BACKENDS:
        assert load_config(backend=kind).backend.kind == kind


def test_the_package_offers_what_it_names_and_nothing_else() -> None:
    for name in conegraph.backends.__all__:
        assert getattr(conegraph.backends, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'particle_filter'"):
        _ = conegraph.backends.particle_filter
