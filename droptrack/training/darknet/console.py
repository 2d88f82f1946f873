"""What Darknet prints while it trains -> typed events, for both living forks.

AlexeyAB/darknet clears the screen and sets the window's title before each iteration's line;
hank-ai/darknet writes ``iteration: key=value, ...``. Whatever is not understood is no event.
"""

import re
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class Iteration:
    """One iteration is done; `next_map` is the iteration of the next mAP, 0 if not in this line."""

    iteration: int
    loss: float
    average_loss: float
    learning_rate: float
    images: int
    next_map: int


@dataclass(frozen=True)
class NextMap:
    """AlexeyAB's announcement of the next mAP, before the line of each iteration."""

    iteration: int


@dataclass(frozen=True)
class MeanAp:
    """A mAP was measured on the validation pictures, 0 to 1."""

    value: float


@dataclass(frozen=True)
class Rewritten:
    """The share, 0 to 1, of truths whose cell and anchor another truth took, since the start."""

    share: float


@dataclass(frozen=True)
class Saving:
    """Weights are about to be written to a file."""

    path: str


@dataclass(frozen=True)
class Question:
    """Darknet asks on stdin whether it really is to train on a CPU: ``yes``."""


Event: TypeAlias = Iteration | NextMap | MeanAp | Rewritten | Saving | Question

NUMBER = r"([-+\w.]+)"
ESCAPES = re.compile(r"\x1b\][^\x07]*\x07|\x1b\[[0-9;?]*[A-Za-z]")
ALEXEY_LINE = re.compile(
    rf"\s*(\d+): {NUMBER}, {NUMBER} avg(?: loss)?, {NUMBER} rate, {NUMBER} seconds, (\d+) images"
)
HANK_LINE = re.compile(
    rf"\s*(\d+): loss={NUMBER}, avg loss={NUMBER}, .*?"
    rf"(?:mAP|next)=(\w+), rate={NUMBER}, .*?(\d+) images"
)
NEXT_MAP = re.compile(r"next mAP calculation at (\d+) iterations")
MEAN_AP = re.compile(rf"mean average precision \(mAP@[\d.]+\)\s*=\s*{NUMBER}(%?)")
REWRITTEN = re.compile(rf"rewritten_bbox = {NUMBER} %")
SAVING = re.compile(r"Saving weights to (.+)")
QUESTION = re.compile('Type "yes" to begin training')


def parse_line(line: str) -> Event | None:
    """The event that a line of the console stands for, if any."""
    text = ESCAPES.sub("", line)
    try:
        if found := ALEXEY_LINE.match(text):
            iteration, loss, average, rate, _, images = found.groups()
            return Iteration(
                int(iteration), float(loss), float(average), float(rate), int(images), 0
            )
        if found := HANK_LINE.match(text):
            iteration, loss, average, after, rate, images = found.groups()
            next_map = int(after) if after.isdigit() else 0
            return Iteration(
                int(iteration), float(loss), float(average), float(rate), int(images), next_map
            )
        if found := NEXT_MAP.search(text):
            return NextMap(int(found[1]))
        if found := MEAN_AP.search(text):
            return MeanAp(float(found[1]) / (100 if found[2] else 1))
        if found := REWRITTEN.search(text):
            return Rewritten(float(found[1]) / 100)
    except ValueError:  # two threads wrote at once
        return None
    if found := SAVING.search(text):
        return Saving(found[1].strip())
    return Question() if QUESTION.search(text) else None


class Console:
    """Bytes of one stream of Darknet, as they come, -> events."""

    def __init__(self) -> None:
        self._rest = ""

    def feed(self, chunk: bytes) -> list[Event]:
        """The events that are complete with this chunk. A question ends no line."""
        # a window's title ends in BEL, a progress count in CR
        *lines, self._rest = re.split(
            r"[\n\r\x07]", self._rest + chunk.decode("utf-8", errors="replace")
        )
        if QUESTION.search(self._rest):
            lines.append(self._rest)
            self._rest = ""
        self._rest = self._rest[-4096:]  # garbage without an end
        return [event for line in lines if (event := parse_line(line)) is not None]
