"""Which version of the code measures."""

from __future__ import annotations

import subprocess
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import conegraph


@lru_cache
def code_version() -> str:
    """Return the version, and in a clone its commit: ``0.1.0+1a2b3c4.dirty``."""
    released, root = version("conegraph"), Path(conegraph.__file__).parents[1]
    if not (root / ".git").exists():
        return released
    try:
        said = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty=.dirty"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return released
    return f"{released}+{said.stdout.strip()}"
