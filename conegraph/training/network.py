"""The network: a small single-stage detector without anchors, at a quarter of the size.

One head at stride 4 sees what a pyramid down to stride 32 knows (Lin et al., "Feature
pyramid networks", 2017), and says of every cell how much the middle of a cone of each
class is there, and where the box's edges are (Tian et al., "FCOS", 2019; Zhou et al.,
"Objects as points", 2019). Small cones need the fine grid more than they need depth.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

STRIDE = 4
SIZE_MULTIPLE = 32
"""Width and height of the input are multiples of this."""
PRIOR = 0.01
"""Share of cells that a new network takes for a cone."""
EDGE_PX = 8.0
"""Distance of an edge from the middle that a new network guesses."""


def _conv(inputs: int, outputs: int, size: int = 3, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )


class _Residual(nn.Module):
    """A bottleneck of half the width around which the input passes."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.squeeze = _conv(width, width // 2, 1)
        self.spread = _conv(width // 2, width)

    def forward(self, x: Tensor) -> Tensor:
        """Return the input plus what the bottleneck adds."""
        added: Tensor = x + self.spread(self.squeeze(x))
        return added


class ConeNet(nn.Module):
    """From pictures (B, 3, H, W) in [0, 1] to boxes and class scores of every cell."""

    def __init__(self, n_classes: int) -> None:
        """Make it with random weights from torch's global generator."""
        super().__init__()
        self.to_4 = nn.Sequential(
            _conv(3, 16, 3, 2), _conv(16, 24, 3, 2), _Residual(24)
        )
        self.to_8 = nn.Sequential(_conv(24, 48, 3, 2), _Residual(48), _Residual(48))
        self.to_16 = nn.Sequential(_conv(48, 96, 3, 2), _Residual(96), _Residual(96))
        self.to_32 = nn.Sequential(_conv(96, 160, 3, 2), _Residual(160), _Residual(160))
        self.wide = nn.MaxPool2d(5, 1, 2)
        self.mix_32 = _conv(3 * 160, 96, 1)
        self.mix_16 = _Residual(96)
        self.thin_16 = _conv(96, 48, 1)
        self.mix_8 = _Residual(48)
        self.thin_8 = _conv(48, 24, 1)
        self.mix_4 = _conv(24, 32)
        self.classes = nn.Conv2d(32, n_classes, 1)
        self.edges = nn.Conv2d(32, 4, 1)
        prior = torch.tensor(PRIOR)
        assert self.classes.bias is not None
        nn.init.constant_(self.classes.bias, float(torch.logit(prior)))

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Return class logits (B, C, h, w) and edge distances (B, 4, h, w) in px.

        Distances are left, top, right and bottom of the cell's middle; h and w are
        those of the picture over `STRIDE`.
        """
        at_4 = self.to_4(picture)
        at_8 = self.to_8(at_4)
        at_16 = self.to_16(at_8)
        at_32 = self.to_32(at_16)
        wider = self.wide(at_32)
        deep = self.mix_32(torch.cat([at_32, wider, self.wide(wider)], 1))
        at_16 = self.mix_16(at_16 + _doubled(deep))
        at_8 = self.mix_8(at_8 + _doubled(self.thin_16(at_16)))
        at_4 = self.mix_4(at_4 + _doubled(self.thin_8(at_8)))
        distance = EDGE_PX * torch.exp(self.edges(at_4).float().clamp(-5.0, 5.0))
        return self.classes(at_4).float(), distance


def _doubled(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")


def cell_middles(like: Tensor) -> Tensor:
    """Return the pixel coordinates (1, 2, h, w) u and v of the cells of a map.

    Counted up with `cumsum`, so that an exported graph takes any size.
    """
    one = torch.ones_like(like[:1, :1])
    u = torch.cumsum(one, 3) * STRIDE
    v = torch.cumsum(one, 2) * STRIDE
    return torch.cat([u, v], 1) - STRIDE / 2


class YoloLayout(nn.Module):
    """The network with the output of YOLO v8: (B, 4 + C, N), boxes before scores."""

    def __init__(self, net: ConeNet) -> None:
        """Wrap a trained network."""
        super().__init__()
        self.net = net

    def forward(self, picture: Tensor) -> Tensor:
        """Return middle, width and height in px, then the scores in [0, 1]."""
        logits, distance = self.net(picture)
        low, high = distance[:, :2], distance[:, 2:]
        middle = cell_middles(logits) + (high - low) / 2
        found = torch.cat([middle, low + high, torch.sigmoid(logits)], 1)
        return found.flatten(2)
