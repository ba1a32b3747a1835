"""The Rerun recording that all back ends of one run share, and where it goes."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rerun as rr

from conegraph import viewer_blueprint as look
from conegraph.errors import FileFormatError, MissingDependencyError

log = logging.getLogger(__name__)

# Rerun's writer can hang for ever once a disk is full, and the run's own results
# need the room more than its recording does.
MIN_FREE_BYTES = 64 * 2**20
FREE_CHECK_PERIOD_S = 0.5

VIEWER_HOST = "127.0.0.1"
VIEWER_PORT = 9876
VIEWER_START_S = 15.0
FLUSH_TIMEOUT_S = 10.0


class SharedStream:
    """One recording with one clock, open until its last user has left it."""

    def __init__(
        self,
        backends: Sequence[str],
        *,
        live: bool,
        path: Path | None,
        camera: bool = False,
    ) -> None:
        """Open the file, the live viewer, or both, and send the layout.

        With ``camera`` the layout has room for pictures and what is found in them.

        Raises:
            FileFormatError: ``path`` cannot be written.
            MissingDependencyError: the live viewer cannot be started.
        """
        if path is not None:
            _check_writable(path)
        self.recording = rr.RecordingStream("conegraph")
        self.off = False
        self._users = set(backends)
        self._path = path
        self._first_stamp_s: float | None = None
        self._next_check_s = 0.0
        if not live and path is not None:
            self.recording.save(path)
        elif path is None:
            self.recording.connect_grpc(_live_viewer())
        else:
            viewer = rr.GrpcSink(_live_viewer())
            self.recording.set_sinks(viewer, rr.FileSink(path))
        self.recording.send_blueprint(look.layout(backends, camera=camera))
        self.recording.log("legend", look.legend(), static=True)
        for index, name in enumerate(backends):
            for entity, part in look.static_parts(name, index):
                self.recording.log(entity, part, static=True)
        if camera:
            for entity, part in look.camera_parts():
                self.recording.log(entity, part, static=True)

    def is_on(self) -> bool:
        """Say whether showing still works; stop it before the disk is full."""
        now_s = time.monotonic()
        if not self.off and self._path is not None and now_s >= self._next_check_s:
            self._next_check_s = now_s + FREE_CHECK_PERIOD_S
            with self.guarded():
                if _free_bytes(self._path) < MIN_FREE_BYTES:
                    self._switch_off("the disk is nearly full")
        return not self.off

    def set_time(self, stamp_s: float, frame: int) -> None:
        """Date what follows: seconds since the first stamp, and frame number."""
        if self._first_stamp_s is None:
            self._first_stamp_s = stamp_s
        self.recording.set_time("time", duration=stamp_s - self._first_stamp_s)
        self.recording.set_time("frame", sequence=frame)

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Switch the recording off, with one warning, where showing fails."""
        was_strict = rr.strict_mode()
        rr.set_strict_mode(True)
        try:
            yield
        except Exception as error:
            self._switch_off(f"{type(error).__name__}: {error}")
        finally:
            rr.set_strict_mode(was_strict)

    def leave(self, user: str) -> None:
        """Take one user's leave; the last one completes the recording."""
        if user not in self._users:
            return
        self._users.remove(user)
        if not self._users and not self.off:
            self._complete()

    def _switch_off(self, reason: str) -> None:
        if self.off:
            return
        self.off = True
        log.warning("viewer switched off, the run goes on: %s", reason)
        self._complete()

    def _complete(self) -> None:
        try:
            self.recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:
            log.warning("viewer: the end of the run may be missing: %s", error)
        self.recording.disconnect()


def _free_bytes(path: Path) -> int:
    return shutil.disk_usage(path.parent).free


def _check_writable(path: Path) -> None:
    try:
        path.open("wb").close()
    except OSError as error:
        reason = f"cannot write the recording: {error.strerror}"
        raise FileFormatError(path, reason) from error
    if _free_bytes(path) < MIN_FREE_BYTES:
        room_mb = MIN_FREE_BYTES // 2**20
        raise FileFormatError(path, f"a recording needs {room_mb} MB of free disk")


def _live_viewer() -> str:
    """Return the address of a viewer on this machine, started where there is none.

    Rerun's own ``spawn`` makes the viewer listen on every network interface; this
    one listens on the local one alone.
    """
    if not _listens():
        _start_viewer()
    return f"rerun+http://{VIEWER_HOST}:{VIEWER_PORT}/proxy"


def _listens() -> bool:
    try:
        socket.create_connection((VIEWER_HOST, VIEWER_PORT), timeout=0.5).close()
    except OSError:
        return False
    return True


def _start_viewer() -> None:
    address = ["--bind", VIEWER_HOST, "--port", str(VIEWER_PORT)]
    options = [*address, "--hide-welcome-screen", "--expect-data-soon"]
    with tempfile.TemporaryFile() as messages:
        viewer = subprocess.Popen(
            [sys.executable, "-m", "rerun_cli", *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            start_new_session=True,
        )
        if _stays_up(viewer):
            return
        messages.seek(0)
        said = messages.read().decode(errors="replace").strip().splitlines()
    reason = said[-1].rpartition(": ")[2] if said else "it gave no reason"
    raise MissingDependencyError(
        f"the Rerun viewer did not start ({reason}); "
        "without a screen, write a recording with --save-rrd instead of --view"
    )


def _stays_up(viewer: subprocess.Popen[bytes]) -> bool:
    """Wait until the viewer listens, and see that it then opens its window.

    Without a display it listens first and ends a moment later.
    """
    deadline_s = time.monotonic() + VIEWER_START_S
    while time.monotonic() < deadline_s:
        if viewer.poll() is not None:
            return False
        if _listens():
            time.sleep(1.0)
            return viewer.poll() is None
        time.sleep(0.1)
    _end(viewer)
    return False


def _end(viewer: subprocess.Popen[bytes]) -> None:
    # Rerun's Python command waits for a program of its own in the same session.
    if sys.platform == "win32":
        viewer.terminate()
    else:
        os.killpg(viewer.pid, signal.SIGTERM)
    viewer.wait()
