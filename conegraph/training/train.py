"""The training: from a seed to weights, in steps that can be taken up again."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from conegraph.errors import FileFormatError
from conegraph.training.batches import STEPS_A_ROUND, Crops
from conegraph.training.collage import CLASSES
from conegraph.training.loss import detection_loss
from conegraph.training.network import ConeNet
from conegraph.training.sample import Sample

RATE, DECAY = 2e-3, 0.02
WARM_STEPS = 200
LAST_SHARE = 0.01
"""What is left of the rate at the end, which it reaches on a cosine."""
MEMORY_STEPS = 500.0
"""Over how many steps the weights are averaged that are kept."""
MAX_NORM = 10.0
UNREADABLE = (
    EOFError,
    KeyError,
    RuntimeError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)
"""What torch raises for files that are no checkpoints."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How to learn.

    Attributes:
        steps: batches to learn; whole rounds of `STEPS_A_ROUND` are learned.
        half: compute in bfloat16, which processors with AMX do twice as fast.
        device: where, as torch names it.
    """

    steps: int
    half: bool = False
    device: str = "cpu"


@dataclass(slots=True)
class _State:
    """What is learned so far."""

    net: ConeNet
    mean: ConeNet
    optimizer: torch.optim.Optimizer
    round: int


def train(
    plan: Plan,
    crops: Crops,
    checkpoint: Path,
    learned: Callable[[int, float], None],
) -> ConeNet:
    """Learn from pictures and return the network with averaged weights.

    On a processor, not on a GPU, the same plan and pictures give the same weights,
    however often it is interrupted.

    Args:
        plan: how long and how.
        crops: the pictures; their seed makes the first weights too.
        checkpoint: file that is written after every round, and read if it is there.
        learned: is told the step and its mean loss after every round.

    Raises:
        FileFormatError: the checkpoint is none, or of another seed.
    """
    state = _started(checkpoint, crops.seed, plan.device)
    total = -(-plan.steps // STEPS_A_ROUND)
    rounds = crops.rounds(state.round)
    while state.round < total:
        losses = [
            _learn(state, batch, state.round * STEPS_A_ROUND + k, plan)
            for k, batch in enumerate(next(rounds))
        ]
        state.round += 1
        _keep(state, crops.seed, checkpoint)
        learned(state.round * STEPS_A_ROUND, float(np.mean(losses)))
    return state.mean.eval().cpu()


def _started(checkpoint: Path, seed: int, device: str) -> _State:
    torch.manual_seed(seed)
    net = ConeNet(len(CLASSES)).to(device)
    optimizer = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=DECAY)
    state = _State(net, copy.deepcopy(net), optimizer, 0)
    if not checkpoint.is_file():
        return state
    try:
        saved = torch.load(checkpoint, weights_only=True, map_location=device)
        if saved["seed"] != seed:
            raise FileFormatError(checkpoint, f"is of --seed {saved['seed']}")
        net.load_state_dict(saved["net"])
        state.mean.load_state_dict(saved["mean"])
        optimizer.load_state_dict(saved["optimizer"])
        state.round = saved["round"]
    except UNREADABLE as error:
        reason = f"is no checkpoint ({type(error).__name__})"
        raise FileFormatError(checkpoint, reason) from None
    return state


def _keep(state: _State, seed: int, checkpoint: Path) -> None:
    saved = {
        "seed": seed,
        "net": state.net.state_dict(),
        "mean": state.mean.state_dict(),
        "optimizer": state.optimizer.state_dict(),
        "round": state.round,
    }
    fresh = checkpoint.with_suffix(".new")
    torch.save(saved, fresh)
    fresh.replace(checkpoint)


def _learn(state: _State, batch: list[Sample], step: int, plan: Plan) -> float:
    done = step / max(plan.steps, 1)
    fall = 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))
    share = LAST_SHARE + (1 - LAST_SHARE) * fall
    for group in state.optimizer.param_groups:
        group["lr"] = RATE * share * min((step + 1) / WARM_STEPS, 1.0)
    state.net.train()
    pictures = as_input([s.picture for s in batch]).to(plan.device)
    with torch.autocast(plan.device, torch.bfloat16, enabled=plan.half):
        logits, distance = state.net(pictures)
    boxes = [torch.from_numpy(s.box_px).float().to(plan.device) for s in batch]
    kinds = [torch.from_numpy(s.kind).to(plan.device) for s in batch]
    loss = detection_loss(logits, distance, boxes, kinds)
    state.optimizer.zero_grad()
    torch.autograd.backward(loss)
    torch.nn.utils.clip_grad_norm_(state.net.parameters(), MAX_NORM)
    state.optimizer.step()
    _average(state, step)
    return float(loss.detach())


def _average(state: _State, step: int) -> None:
    """Move the kept weights towards the learned ones."""
    share = 1.0 / min(MEMORY_STEPS, 1.0 + step / 4)
    learned = state.net.state_dict()
    with torch.no_grad():
        for name, value in state.mean.state_dict().items():
            if value.dtype.is_floating_point:
                value.lerp_(learned[name], share)
            else:
                value.copy_(learned[name])


def as_input(pictures: list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]) -> Tensor:
    """Return pictures (H, W, 3) as a batch (B, 3, H, W) in [0, 1]."""
    batch = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)
    return (batch.float() / 255).contiguous(memory_format=torch.channels_last)
