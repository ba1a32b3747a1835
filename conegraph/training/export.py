"""From a trained network to an ONNX file that takes pictures of any size."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import torch
from torch import Tensor

from conegraph.training.network import SIZE_MULTIPLE, ConeNet, YoloLayout

OPSET = 17


def as_onnx(net: ConeNet) -> bytes:
    """Return the network with the output of YOLO v8, (1, 4 + C, N), as an ONNX file.

    Width and height are any multiples of `SIZE_MULTIPLE`.
    """
    example = torch.zeros(1, 3, 2 * SIZE_MULTIPLE, 4 * SIZE_MULTIPLE)
    with tempfile.TemporaryDirectory(prefix="conegraph-onnx-") as folder:
        path = Path(folder) / "net.onnx"
        _export(net, example, path)
        return path.read_bytes()


def _export(net: ConeNet, example: Tensor, path: Path) -> None:
    with warnings.catch_warnings():
        # The other exporter needs a package more and fixes the size.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            YoloLayout(net).eval(),
            (example,),
            path,
            input_names=["images"],
            output_names=["boxes"],
            dynamic_axes={"images": {2: "height", 3: "width"}, "boxes": {2: "cells"}},
            opset_version=OPSET,
            dynamo=False,
        )
