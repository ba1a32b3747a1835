"""What the network is asked for, and how wrong it is."""

from __future__ import annotations

import torch
from torch import Tensor

from conegraph.training.network import STRIDE, cell_middles
from conegraph.training.sample import IGNORED

SPREAD = 0.12
"""Sigma of the blob around a cone's middle, in widths and heights of its box."""
LEAST_SPREAD_PX = 1.5
BOX_SHARE = 0.4
"""Cells at which the blob is higher than this tell the box too."""
BOX_WEIGHT = 2.0


def detection_loss(
    logits: Tensor, distance: Tensor, box_px: list[Tensor], kind: list[Tensor]
) -> Tensor:
    """Return the loss of a batch, a number per cone.

    Class maps (B, C, h, w) are asked for a blob of height 1 at every cone's middle,
    by the penalty-reduced focal loss of Law and Deng ("CornerNet", 2018); around the
    middle the box's error is ``1 - IoU + |c - c'|^2 / d^2`` (Zheng et al., "Distance-
    IoU loss", 2020). What lies in the box of an ignored cone is not counted.

    Args:
        logits: (B, C, h, w) class scores before the sigmoid.
        distance: (B, 4, h, w) left, top, right, bottom of the cell's middle, in px.
        box_px: for each picture (N, 4) boxes.
        kind: for each picture (N,) classes, or `IGNORED`.
    """
    middle = cell_middles(logits)[0]
    total = logits.new_zeros(())
    count = 0
    for row in range(len(logits)):
        wanted, weight, owner = _targets(logits[row], middle, box_px[row], kind[row])
        total = total + _focal(logits[row], wanted, weight)
        blob = wanted.amax(0)
        at = (blob > BOX_SHARE).nonzero(as_tuple=True)
        count += int((kind[row] != IGNORED).sum())
        if len(at[0]):
            low = middle[:, at[0], at[1]] - distance[row, :2, at[0], at[1]]
            high = middle[:, at[0], at[1]] + distance[row, 2:, at[0], at[1]]
            real = box_px[row][owner[at]].T
            wrong = _box_error(torch.cat([low, high]), real)
            share = blob[at]
            cones = len(torch.unique(owner[at]))
            total = total + BOX_WEIGHT * cones * (wrong * share).sum() / share.sum()
    return total / max(count, 1)


def _targets(
    like: Tensor, middle: Tensor, box_px: Tensor, kind: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return class maps (C, h, w), what counts (h, w), and the box of each cell."""
    wanted = torch.zeros_like(like)
    weight = torch.ones_like(like[0])
    owner = torch.zeros_like(like[0], dtype=torch.long)
    if not len(box_px):
        return wanted, weight, owner
    u, v = middle
    left, top, right, low = box_px.T[:, :, None, None]
    inside = (u > left - STRIDE) & (u < right + STRIDE)
    inside &= (v > top - STRIDE) & (v < low + STRIDE)
    skip = kind == IGNORED
    weight[inside[skip].any(0)] = 0.0
    spread_u = (SPREAD * (right - left)).clamp_min(LEAST_SPREAD_PX)
    spread_v = (SPREAD * (low - top)).clamp_min(LEAST_SPREAD_PX)
    off_u, off_v = u - 0.5 * (left + right), v - 0.5 * (top + low)
    blob = torch.exp(-0.5 * ((off_u / spread_u) ** 2 + (off_v / spread_v) ** 2))
    blob = blob / blob.flatten(1).amax(1).clamp_min(1e-9)[:, None, None]
    blob = blob * inside
    blob[skip] = 0.0
    owner = blob.argmax(0)
    for number in range(len(wanted)):
        of_class = blob[kind == number]
        if len(of_class):
            wanted[number] = of_class.amax(0)
    weight[wanted.amax(0) > 0.01] = 1.0
    return wanted, weight, owner


def _focal(logits: Tensor, wanted: Tensor, weight: Tensor) -> Tensor:
    score = torch.sigmoid(logits).clamp(1e-4, 1 - 1e-4)
    here = wanted > 0.999
    found = (1 - score) ** 2 * torch.log(score)
    empty = (1 - wanted) ** 4 * score**2 * torch.log(1 - score)
    return -(weight * torch.where(here, found, empty)).sum()


def _box_error(box: Tensor, real: Tensor) -> Tensor:
    """Return 1 - DIoU (K,) of boxes (4, K)."""
    low, high = torch.maximum(box[:2], real[:2]), torch.minimum(box[2:], real[2:])
    common = (high - low).clamp_min(0).prod(0)
    area = (box[2:] - box[:2]).prod(0) + (real[2:] - real[:2]).prod(0)
    overlap = common / (area - common).clamp_min(1e-6)
    around = torch.maximum(box[2:], real[2:]) - torch.minimum(box[:2], real[:2])
    apart = 0.5 * (box[:2] + box[2:] - real[:2] - real[2:])
    gap = (apart**2).sum(0) / (around**2).sum(0).clamp_min(1e-6)
    return 1 - overlap + gap
