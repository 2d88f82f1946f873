"""A training on a disk without room: one line names the file, and what is whole goes on."""

import math
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs the extra [train]")

from droptrack.errors import DroptrackError, UnwritableError
from droptrack.network.darknet_cfg import read_cfg
from droptrack.network.torch_network import DarknetNetwork
from droptrack.training.log import Step, TrainingLog, read_log
from droptrack.training.pytorch.checkpoint import restore, save_checkpoint, save_weights

SMALL = Path(__file__).parents[1] / "reference/small-yolov3.cfg"
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="only Linux has /dev/full")


def step(iteration: int) -> Step:
    return Step(
        iteration=iteration, loss=1.5, average_loss=1.5, regression=math.nan, objectness=math.nan,
        classes=math.nan, rewritten=0, learning_rate=0.1, seconds=1, images=iteration,
        mean_ap=math.nan,
    )  # fmt: skip


@needs_full
def test_a_checkpoint_that_has_no_room_is_named_and_the_one_before_stays(tmp_path: Path) -> None:
    """Of a full disk, torch.save tells neither the file nor the reason."""
    network = DarknetNetwork(read_cfg(SMALL))
    optimizer = torch.optim.SGD(network.parameters(), lr=0.1)
    checkpoint, weights = tmp_path / "checkpoint.pt", tmp_path / "last.weights"
    save_checkpoint(checkpoint, network, optimizer, 7)
    save_weights(weights, network, 7)
    before = weights.read_bytes()
    (tmp_path / "checkpoint.partial.pt").symlink_to(FULL)
    (tmp_path / "last.partial.weights").symlink_to(FULL)
    with pytest.raises(UnwritableError, match=r"checkpoint\.pt: cannot be written"):
        save_checkpoint(checkpoint, network, optimizer, 8)
    with pytest.raises(UnwritableError, match=r"last\.weights: cannot be written: No space left"):
        save_weights(weights, network, 8)
    assert restore(checkpoint, network, optimizer) == 7
    assert weights.read_bytes() == before


@pytest.mark.parametrize("n_lost", [1, 5, 30])
def test_a_row_of_the_log_that_was_cut_off_is_none(tmp_path: Path, n_lost: int) -> None:
    """As a full disk leaves it: the training goes on from the rows before."""
    with TrainingLog(tmp_path, 0) as log:
        for iteration in (1, 2, 3):
            log.append(step(iteration))
    path = tmp_path / "training.csv"
    whole = path.read_bytes()
    path.write_bytes(whole[:-n_lost])
    assert [one.iteration for one in read_log(path)] == [1, 2]
    with TrainingLog(tmp_path, 2) as log:
        log.append(step(3))
    assert path.read_bytes() == whole


@needs_full
def test_a_log_without_room_is_named(tmp_path: Path) -> None:
    log = TrainingLog(tmp_path, 0)
    log.append(step(1))
    log._file.close()
    log._file = FULL.open("ab", buffering=0)
    with pytest.raises(DroptrackError, match=r"training\.csv: cannot be written: No space left"):
        log.append(step(2))
    log._file.close()
    assert [one.iteration for one in read_log(tmp_path / "training.csv")] == [1]
