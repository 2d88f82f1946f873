"""The files of a PyTorch training: weights, and checkpoints to resume from."""

import os
from pathlib import Path

import torch

from droptrack.data.files import replacing
from droptrack.errors import DroptrackError
from droptrack.network.darknet_weights import WEIGHTS_VERSION, Weights, write_weights
from droptrack.network.torch_network import DarknetNetwork, dump_values


def save_weights(path: Path, network: DarknetNetwork, images_seen: int) -> None:
    """Write a ``.weights`` file of a network that was trained on so many images."""
    write_weights(path, Weights(WEIGHTS_VERSION, images_seen, dump_values(network)))


def save_checkpoint(
    path: Path, network: DarknetNetwork, optimizer: torch.optim.Optimizer, iteration: int
) -> None:
    """Write what `restore` reads: all that an interrupted training needs to resume."""
    state = {
        "network": network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "iteration": iteration,
    }
    with replacing(path) as partial, partial.open("wb") as file:
        try:
            torch.save(state, file)
        except RuntimeError:  # what it makes of the system's error, of which it tells nothing
            file.flush()
            os.fsync(file.fileno())
            raise OSError("is the disk full?") from None


def restore(path: Path, network: DarknetNetwork, optimizer: torch.optim.Optimizer) -> int:
    """Fill a network and its optimizer from a checkpoint; returns its iteration.

    Raises DroptrackError for a checkpoint that is missing, damaged, or of another network.
    """
    if not path.exists():
        raise DroptrackError(f"{path}: no checkpoint to resume from; start again, in another --out")
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
    except (RuntimeError, KeyError, ValueError, EOFError) as error:
        reason = str(error).splitlines()[0]
        raise DroptrackError(f"{path}: is no checkpoint of this network: {reason}") from None
    return int(state["iteration"])
