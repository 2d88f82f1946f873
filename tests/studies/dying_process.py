"""A worker that does nothing, and dies at a video called bad."""

import os
import pickle
import signal
import sys
from typing import Any

from droptrack.studies.outcome import Outcome

if __name__ == "__main__":
    answers = sys.stdout.buffer

    def answer(message: Any) -> None:
        pickle.dump(message, answers)
        answers.flush()

    answer("ready")
    while True:
        try:
            job = pickle.load(sys.stdin.buffer)
        except EOFError:
            break
        answer((3, 9))
        if job.name == "bad":
            os.kill(os.getpid(), signal.SIGKILL)
        answer(Outcome(name=job.name))
