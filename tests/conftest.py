"""What tests share: where the real data lies, and a browser to look at pages with."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping
from html import unescape
from pathlib import Path
from typing import Any

import pytest

# As the command line does, and before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
PHONE_PX, DESK_PX = 390, 1280

# Frames, because a browser's own window cannot be as narrow as a phone.
HARNESS = """<!DOCTYPE html><iframe src="{page}" width="{phone}" height="900"
style="border:0"></iframe><iframe src="{page}" width="{desk}" height="900"
style="border:0"></iframe><pre></pre><script>
addEventListener("load", () => {{
  document.querySelector("pre").textContent = JSON.stringify(
    [...document.querySelectorAll("iframe")].map(frame => {{
      const page = frame.contentDocument;
      const fetched = frame.contentWindow.performance.getEntriesByType("resource");
      const sizes = [...page.querySelectorAll("svg, img")].map(
        picture => picture.getBoundingClientRect());
      return {{
        window_px: frame.clientWidth,
        page_px: page.scrollingElement.scrollWidth,
        pictures: sizes.filter(s => s.width > 100 && s.height > 100).length,
        too_small: sizes.filter(s => s.width <= 100 || s.height <= 100).length,
        clipped: [...page.querySelectorAll("svg text")].filter(text => {{
          const box = text.getBoundingClientRect();
          const frame = text.closest("svg").getBoundingClientRect();
          return box.left < frame.left - 1 || box.right > frame.right + 1;
        }}).map(text => text.textContent),
        scrolling: [...page.querySelectorAll(".scroll")].filter(
          table => table.scrollWidth > table.clientWidth + 1).length,
        fetched: fetched.map(entry => entry.name),
      }};
    }}));
}});
</script>"""

Looks = list[Mapping[str, Any]]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of real data, or skip: the project is whole without it."""
    given = os.environ.get("CONEGRAPH_DATA")
    folder = Path(given) if given else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"real data not found at {folder}; set CONEGRAPH_DATA")
    return folder


@pytest.fixture
def look_at(tmp_path: Path) -> Callable[[Path], Looks]:
    """Return what opens a page in a browser, as wide as a phone and as a desk.

    It answers with what it sees in each, and ``console``: what the page said there.
    """
    found = [path for name in BROWSERS if (path := shutil.which(name))]
    if not found:
        pytest.skip("no chromium on PATH to look at pages with")

    def look(page: Path) -> Looks:
        harness = tmp_path / "harness.html"
        harness.write_text(
            HARNESS.format(page=page.as_uri(), phone=PHONE_PX, desk=DESK_PX)
        )
        flags = (
            "--headless --no-sandbox --disable-gpu --disable-background-networking "
            "--disable-sync --no-first-run --disable-dev-shm-usage "
            "--allow-file-access-from-files --enable-logging=stderr --dump-dom"
        )
        profile = f"--user-data-dir={tmp_path / 'browser'}"
        done = subprocess.run(
            [found[0], *flags.split(), profile, harness.as_uri()],
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
        seen = re.search("<pre>(.*)</pre>", done.stdout)
        assert seen is not None, done.stderr
        return [{**one, "console": console} for one in json.loads(unescape(seen[1]))]

    return look
