"""Networks that keep their caller waiting, in threads of their own."""

from abc import ABC, abstractmethod
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from time import perf_counter
from typing import Any

from droptrack.detection.detector import Computed


class InThread(ABC):
    """Starts `run` in a thread, for as many inputs at once as `parallel` says."""

    parallel = 1

    @abstractmethod
    def run(self, prepared: Any) -> Any:
        """The network's outputs."""

    def start(self, prepared: Any) -> Future[Computed]:
        """Compute an input after those started before it."""
        return self._threads.submit(self._timed, prepared)

    @cached_property
    def _threads(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.parallel, thread_name_prefix="network")

    def _timed(self, prepared: Any) -> Computed:
        start = perf_counter()
        outputs = self.run(prepared)
        return Computed(outputs, perf_counter() - start)
