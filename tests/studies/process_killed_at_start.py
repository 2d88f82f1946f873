"""A worker that is killed while it starts, once, and does nothing after that."""

import os
import runpy
import signal
from pathlib import Path

if __name__ == "__main__":
    killed = Path(os.environ["KILLED_BEFORE"])
    if not killed.exists():
        killed.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    runpy.run_module("tests.studies.dying_process", run_name="__main__")
