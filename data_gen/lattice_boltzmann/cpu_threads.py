"""The threads of the CPU that the solvers' compiled loops run on."""

from numba import config, get_num_threads, set_num_threads

from droptrack.errors import DroptrackError

# with TBB, which comes first where it is installed, each launch is slower than the one before
config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]  # type: ignore[attr-defined]


def use_threads(n: int) -> None:
    """Run on n threads, 0 for all; raises DroptrackError where there are fewer."""
    available = int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if n > available:
        raise DroptrackError(f"--threads {n}: this machine has {available}")
    if n:
        set_num_threads(n)


def count_threads() -> int:
    """The number of threads in use."""
    return int(get_num_threads())
