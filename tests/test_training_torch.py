"""The network, its loss and its training; skipped where PyTorch is not installed."""

from pathlib import Path

import numpy as np
import pytest

from conegraph.errors import FileFormatError
from conegraph.frontend.yolo_engine import open_engine
from conegraph.frontend.yolo_layout import decoded
from conegraph.training.batches import STEPS_A_ROUND, Crops
from conegraph.training.sample import IGNORED

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

BOX = [20.0, 10.0, 40.0, 50.0]


def loss_of(score: float, shift_px: float, kind: int = 1) -> float:
    """Return the loss where the cell of the box's middle says score and shifted box."""
    from conegraph.training.loss import detection_loss
    from conegraph.training.network import cell_middles

    logits = torch.full((1, 4, 16, 16), -9.0)
    logits[0, 1, 7, 7] = torch.logit(torch.tensor(score))
    middle = cell_middles(logits)[0]
    box = torch.tensor(BOX) + shift_px
    distance = torch.cat([middle - box[:2, None, None], box[2:, None, None] - middle])
    boxes, kinds = [torch.tensor([BOX])], [torch.tensor([kind])]
    return float(detection_loss(logits, distance[None], boxes, kinds))


def test_the_loss_is_least_where_everything_is_right() -> None:
    right = loss_of(0.999, 0.0)
    assert right < 0.05
    assert loss_of(0.5, 0.0) > right + 0.1
    # Moved by a tenth of its width: 1 - IoU + (gap / diagonal)^2, counted twice.
    common, area = 18.0 * 38.0, 800.0
    expected = 1 - common / (2 * area - common) + 8 / (22.0**2 + 42.0**2)
    assert loss_of(0.999, 2.0) - right == pytest.approx(2 * expected, rel=1e-3)


def test_an_ignored_cone_costs_nothing() -> None:
    assert loss_of(0.999, 30.0, kind=IGNORED) < 1e-3
    assert loss_of(0.999, 30.0, kind=0) > 1.0


def test_the_exported_network_says_the_same_at_any_size(tmp_path: Path) -> None:
    from conegraph.training.export import as_onnx
    from conegraph.training.network import ConeNet, YoloLayout

    torch.manual_seed(0)
    net = ConeNet(4).eval()
    path = tmp_path / "net.onnx"
    path.write_bytes(as_onnx(net))
    for height, width in ((64, 128), (96, 96)):
        rng = np.random.default_rng(0)
        picture = rng.random((1, 3, height, width), dtype=np.float32)
        with torch.no_grad():
            expected = YoloLayout(net)(torch.from_numpy(picture)).numpy()
        for engine in ("onnxruntime", "opencv"):
            output = open_engine(path, engine).run(picture)
            np.testing.assert_allclose(output, expected, atol=1e-3)
            assert len(decoded(output, 4)[0]) == height * width // 16


def test_training_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    from conegraph.training.train import Plan, train

    torch.set_num_threads(1)
    crops = Crops(5, 2, 32, [], 0)
    plan = Plan(2 * STEPS_A_ROUND)
    whole = train(plan, crops, tmp_path / "a.pt", lambda step, loss: None)
    interrupted = tmp_path / "b.pt"

    def stop(step: int, loss: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(plan, crops, interrupted, stop)
    again = train(plan, crops, interrupted, lambda step, loss: None)
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])
    with pytest.raises(FileFormatError, match="is of --seed 5"):
        train(plan, Crops(6, 2, 32, [], 0), interrupted, stop)
    for damaged in (b"", b"nothing", interrupted.read_bytes()[:-100]):
        interrupted.write_bytes(damaged)
        with pytest.raises(FileFormatError, match="is no checkpoint"):
            train(plan, crops, interrupted, stop)


def test_the_command_goes_on_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from conegraph.cli import main

    def said(*arguments: str) -> str:
        with pytest.raises(SystemExit) as ended:
            main(["train-detector", "--out", str(tmp_path), *arguments])
        assert ended.value.code == 1
        return capsys.readouterr().err

    assert "no such file to --resume" in said("--resume")
    (tmp_path / "checkpoint.pt").write_bytes(b"")
    assert "go on with it by --resume" in said()
