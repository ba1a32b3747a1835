"""What tests share: where the real data lies."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# As the command line does, and before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of real data, or skip: the project is whole without it."""
    given = os.environ.get("CONEGRAPH_DATA")
    folder = Path(given) if given else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"real data not found at {folder}; set CONEGRAPH_DATA")
    return folder
