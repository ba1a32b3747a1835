"""``conegraph train-detector``: pictures that are made up, a network, its figures."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.errors import ConegraphError, MissingDependencyError
from conegraph.eval.words import counted

if TYPE_CHECKING:
    from rich.table import Table

    from conegraph.training.report import Precisions
    from conegraph.training.sample import Sample

CHECKPOINT, MODEL = "checkpoint.pt", "cones.onnx"
BATCH, SIDE_PX = 16, 320
UNSEEN_SCENES = 4
UNSEEN_SEED = 1_000_000
"""Added to the seed for the pictures that are tested with."""


def train_detector(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="DIR", help=f"Where {MODEL} goes.", file_okay=False
        ),
    ],
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            exists=True,
            file_okay=False,
            help="Your own pictures with YOLO labels, in place of the renders. One of "
            "ten, told by its name, is not learned but tested with.",
        ),
    ] = None,
    steps: Annotated[
        int, typer.Option(min=1, help="Batches to learn, in rounds of 24.")
    ] = 20_000,
    seed: Annotated[int, typer.Option(min=0, help="Makes everything random.")] = 7,
    scenes: Annotated[
        int, typer.Option(min=0, help="Scenes to render, of 24 pictures each.")
    ] = 12,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what DIR holds.")
    ] = False,
    jobs: Annotated[
        int, typer.Option(min=0, help="Processes that make pictures meanwhile.")
    ] = 1,
    threads: Annotated[
        int, typer.Option(min=1, help="Threads that learn; results depend on it.")
    ] = 1,
    half: Annotated[
        bool,
        typer.Option(
            "--bfloat16", help="Half precision: twice as fast on processors with AMX."
        ),
    ] = False,
) -> None:
    """Train the learned detector, on a GPU if possible.

    Four of five pictures are made-up photographs, one is a render or your own.
    """
    if find_spec("torch") is None or find_spec("onnx") is None:
        raise MissingDependencyError(
            "training needs PyTorch and onnx: pip install 'conegraph[train]'"
        )
    import torch

    from conegraph.training.batches import Crops
    from conegraph.training.export import as_onnx
    from conegraph.training.train import Plan, train

    checkpoint = out / CHECKPOINT
    _ask_for_resume(checkpoint, resume)
    out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(threads)
    _say_rounded(steps)
    kept, unseen = _own(data) if data else (_render(seed, scenes, jobs), [])
    crops = Crops(seed, BATCH, SIDE_PX, kept, jobs)
    plan = Plan(steps, half, "cuda" if torch.cuda.is_available() else "cpu")
    net = train(plan, crops, checkpoint, _say)
    model = out / MODEL
    model.write_bytes(as_onnx(net))
    typer.echo(f"{model}: {model.stat().st_size} bytes")
    renders = _render(seed + UNSEEN_SEED, UNSEEN_SCENES, jobs)
    _print_precisions(model, renders, "unseen renders")
    if unseen:
        title = f"{counted(len(unseen), 'picture')} of {data}, held out"
        _print_precisions(model, unseen, title)


def _say_rounded(steps: int) -> None:
    from conegraph.training.batches import STEPS_A_ROUND

    rounds = -(-steps // STEPS_A_ROUND)
    if rounds * STEPS_A_ROUND != steps:
        whole = f"rounds of {STEPS_A_ROUND} are learned"
        typer.echo(f"{rounds * STEPS_A_ROUND} steps in place of {steps}: {whole}")


def _own(data: Path) -> tuple[list[Sample], list[Sample]]:
    """Return the user's pictures to learn from and to test with; say how many."""
    from conegraph.training.folder import HELD_OUT_OF, read_folder, split

    learn, test = split(read_folder(data))
    said = (
        f"{data}: {counted(len(learn), 'picture')} to learn from, {len(test)} held out"
    )
    few = "" if test else f" (too few pictures: one of {HELD_OUT_OF} would be)"
    typer.echo(f"{said}{few}")
    return learn, test


def _ask_for_resume(checkpoint: Path, resume: bool) -> None:
    """Refuse to go on with, or to start, what the user did not ask for.

    Raises:
        ConegraphError: there is a checkpoint and no ``--resume``, or none with it.
    """
    if checkpoint.is_file() and not resume:
        raise ConegraphError(
            f"{checkpoint}: is there already; go on with it by --resume"
        )
    if resume and not checkpoint.is_file():
        raise ConegraphError(f"{checkpoint}: no such file to --resume")


def _render(seed: int, scenes: int, jobs: int) -> list[Sample]:
    from conegraph.cli.progress import progress_bar
    from conegraph.training.rendered import render_scenes

    with progress_bar("rendering", scenes) as advance:
        return render_scenes(seed, scenes, jobs, advance)


def _say(step: int, loss: float) -> None:
    typer.echo(f"step {step}: loss {loss:.3f}")


def _print_precisions(model: Path, unseen: list[Sample], what: str) -> None:
    from rich.table import Table

    from conegraph.cli.progress import progress_bar
    from conegraph.cli.tables import console
    from conegraph.config import YoloConfig
    from conegraph.training.report import precisions

    with progress_bar(f"looking at {what}", len(unseen)) as advance:
        found = precisions(YoloConfig(model=str(model)), unseen, advance)
    console().print(_table(found, Table(title=f"AP50 on {what}")))


def _table(found: Precisions, table: Table) -> Table:
    from conegraph.training.collage import CLASSES
    from conegraph.training.report import SIZES_PX

    heights = [f"{low:g} to {high:g} px" for low, high in SIZES_PX]
    for heading in ("class", "all", *heights):
        table.add_column(heading)
    for row, cone in enumerate(CLASSES):
        sizes = [f"{size[row]:.3f}" for size in found.by_size]
        table.add_row(cone.label, f"{found.by_class[row]:.3f}", *sizes)
    table.add_row("mean", f"{found.mean:.3f}")
    return table
