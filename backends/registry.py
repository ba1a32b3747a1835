"""Which back ends there are: a new one is one file and one line here."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from conegraph.config import BackendConfig, Config, resolve_config
from conegraph.errors import MissingDependencyError

if TYPE_CHECKING:
    from conegraph.backends.base import Backend
    from conegraph.types import ConeMap, SensorModel

BACKENDS = {
    "ekf": "conegraph.backends.ekf:EkfBackend",
    "isam2": "conegraph.backends.isam2:Isam2Backend",
}


def make_backend(
    backend: BackendConfig,
    config: Config | None = None,
    *,
    sensor: SensorModel | None = None,
    known_map: ConeMap | None = None,
    add_cones: bool = True,
) -> Backend:
    """Make the back end that a configuration names.

    Args:
        backend: the section ``backend`` of a configuration.
        config: the whole of it; the rest is the profile's default without.
        sensor: the cone sensor, where the source knows it.
        known_map: cones to start from, in whose frame the car starts at the origin.
        add_cones: False keeps the map as it is (localisation only).

    Raises:
        MissingDependencyError: the back end needs a package that is not installed.
    """
    whole = config or resolve_config({"backend": backend.model_dump()})
    whole = whole.model_copy(update={"backend": backend})
    module, _, name = BACKENDS[backend.kind].partition(":")
    try:
        kind = getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "conegraph":
            raise
        raise MissingDependencyError(
            f"back end {backend.kind} needs the package {error.name}, which is not "
            "installed here; --backend ekf works without"
        ) from None
    made: Backend = kind(whole, sensor, known_map, add_cones=add_cones)
    return made
