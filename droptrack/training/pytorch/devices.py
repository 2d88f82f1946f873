"""The devices that PyTorch trains on, and one process for each."""

import datetime
import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, distributed

from droptrack.errors import DroptrackError

T = TypeVar("T")


def machine() -> dict[str, str]:
    """The trainer and its device, for the run file."""
    device = torch.cuda.get_device_name() if torch.cuda.is_available() else "the CPU"
    return {"trainer": f"PyTorch {torch.__version__} on {device}"}


def computes_faster_in_bf16() -> bool:
    """Whether there is a GPU, or a CPU with instructions for bf16; others imitate it, slowly."""
    if torch.cuda.is_available():
        return bool(torch.cuda.is_bf16_supported())
    known = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    return bool(known is not None and known())


def choose_devices(gpus: str, batch: int, subdivisions: int) -> tuple[str, ...]:
    """``0,1`` -> cuda:0, cuda:1; without a choice the first GPU, or the CPU where there is none.

    Raises DroptrackError for GPUs that are not there, or that cannot share a batch evenly.
    """
    there = torch.cuda.device_count()
    if not gpus:
        return ("cuda:0",) if there else ("cpu",)
    names = [name.strip() for name in gpus.split(",")]
    if not all(name.isdigit() and int(name) < there for name in names) or len(set(names)) < len(
        names
    ):
        raise DroptrackError(f"--gpus {gpus}: PyTorch finds {there}, numbered from 0")
    if batch % (len(names) * subdivisions):
        raise DroptrackError(
            f"--gpus {gpus}: batch={batch} should be a multiple of {len(names)} GPUs times "
            f"subdivisions={subdivisions}"
        )
    return tuple(f"cuda:{int(name)}" for name in names)


@contextmanager
def other_ranks(
    devices: Sequence[str], workers: int, run: Callable[[T, int], None], job: T
) -> Iterator[None]:
    """Processes that `run` a job with their rank, for all devices but the first.

    This process becomes rank 0. When it leaves, the others are ended.
    """
    if len(devices) == 1:
        yield
        return
    with tempfile.TemporaryDirectory() as folder:
        meeting = Path(folder) / "ranks"
        context = torch.multiprocessing.get_context("spawn")
        others = [
            context.Process(
                target=_be_rank,
                args=(rank, devices, meeting, run, job),
                daemon=not workers,  # a daemon may have no workers of its own
            )
            for rank in range(1, len(devices))
        ]
        for process in others:
            process.start()
        try:
            _join(0, devices, meeting)
            yield
        finally:
            for process in others:
                process.join(5)
                process.kill()
                process.join()
            distributed.destroy_process_group()


def leave_signals_to_the_first_process() -> None:
    """Ignore what ends a training: all its processes get the signal, the first ends the others."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def leave_open_files_to_no_other() -> None:
    """Have no program that this process starts inherit its files, a pipe of its parent among them.

    PyTorch starts one that shares memory between processes. It lives longer than a worker, whose
    end the parent sees by that pipe: it would wait for 5 s for each.
    """
    for name in os.listdir("/dev/fd"):
        with suppress(OSError):  # that of the listing itself is closed
            if int(name) > 2:
                os.set_inheritable(int(name), False)


def _be_rank(
    rank: int, devices: Sequence[str], meeting: Path, run: Callable[[T, int], None], job: T
) -> None:
    leave_signals_to_the_first_process()
    _join(rank, devices, meeting)
    run(job, rank)
    distributed.destroy_process_group()


def _join(rank: int, devices: Sequence[str], meeting: Path) -> None:
    distributed.init_process_group(
        "nccl" if devices[rank].startswith("cuda") else "gloo",
        init_method=meeting.as_uri(),
        rank=rank,
        world_size=len(devices),
        timeout=datetime.timedelta(hours=2),  # rank 0 measures the mAP alone
    )


def mean_over_ranks(terms: Tensor) -> list[float]:
    """Numbers (N,), averaged over the devices."""
    if distributed.is_initialized():
        distributed.all_reduce(terms)
        terms /= distributed.get_world_size()
    return [float(term) for term in terms.tolist()]
