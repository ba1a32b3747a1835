"""Networks in ONNX files: checked, opened and run, by onnxruntime or by OpenCV."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.errors import FileFormatError, MissingDependencyError

if TYPE_CHECKING:
    from conegraph.config.detector import EngineName

Floats = NDArray[np.float32]
SHIPPED = Path(__file__).parent / "weights" / "cones.onnx"
SHIPPED_SHA256 = "5508e502c6195b5925a2be4c340969e7ad78df0c9f550c9c55bcd1fed2d10759"
MAX_BYTES = 300_000_000
"""Larger files are refused before they are read."""


class Engine(Protocol):
    """A network that is ready to run."""

    def run(self, pictures: Floats) -> Floats:
        """Return the first output for pictures (B, 3, H, W) in [0, 1].

        Raises:
            FileFormatError: it does not take pictures of this size.
        """
        ...


def open_engine(path: Path, name: EngineName) -> Engine:
    """Open a network.

    Args:
        path: an ONNX file; that of `SHIPPED` must be the one that was trained.
        name: what runs it; ``auto`` is onnxruntime where it is installed, else OpenCV.

    Raises:
        FileFormatError: it is missing, too large, damaged or no network.
        MissingDependencyError: onnxruntime is asked for and not installed.
    """
    installed = find_spec("onnxruntime") is not None
    if name == "onnxruntime" and not installed:
        reason = "detector.engine = onnxruntime: pip install 'conegraph[yolo]'"
        raise MissingDependencyError(reason)
    data = _checked(path)
    if path == SHIPPED and hashlib.sha256(data).hexdigest() != SHIPPED_SHA256:
        raise FileFormatError(path, "is not the file that ships (SHA-256 differs)")
    if installed and name != "opencv":
        return _OnnxRuntime(path, data)
    return _OpenCv(path, data)


def _checked(path: Path) -> bytes:
    """Return what is in a file, if that can be a network."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise FileFormatError(path, f"{size} bytes are too many for a network")
        return path.read_bytes()
    except OSError as error:
        raise FileFormatError(path, error.strerror or "cannot be read") from None


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]


class _OnnxRuntime:
    """Runs in onnxruntime, on one thread: others are the filter's and the viewer's."""

    def __init__(self, path: Path, data: bytes) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        self._path = path
        try:
            self._session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime's errors have no common class
            reason = f"is no ONNX network ({_first_line(error)})"
            raise FileFormatError(path, reason) from None
        self._input = self._session.get_inputs()[0].name

    def run(self, pictures: Floats) -> Floats:
        try:
            output = self._session.run(None, {self._input: pictures})[0]
        except Exception as error:
            raise _wrong_size(self._path, pictures, error) from None
        return np.asarray(output, dtype=np.float32)


class _OpenCv:
    """Runs in OpenCV's own engine, which needs nothing else."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path = path
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(data, dtype=np.uint8))
        except cv2.error as error:
            reason = f"is no ONNX network ({_first_line(error)})"
            raise FileFormatError(path, reason) from None

    def run(self, pictures: Floats) -> Floats:
        try:
            self._net.setInput(pictures)
            output = self._net.forward()
        except cv2.error as error:
            raise _wrong_size(self._path, pictures, error) from None
        return np.asarray(output, dtype=np.float32)


def _wrong_size(path: Path, pictures: Floats, error: Exception) -> FileFormatError:
    height, width = pictures.shape[2:]
    return FileFormatError(
        path,
        f"does not take a picture of {width} x {height} px; if it takes but one size, "
        f"set detector.input_px ({_first_line(error)})",
    )
