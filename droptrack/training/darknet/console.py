"""What Darknet prints while it trains -> typed events, for both living forks.

AlexeyAB/darknet clears the screen and sets the window's title before each iteration's line;
hank-ai/darknet writes ``iteration: key=value, ...``. Whatever is not understood is no event.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, kw_only=True)
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
    """A mAP was measured on the validation images, 0 to 1."""

    value: float


@dataclass(frozen=True)
class Rewritten:
    """The share, 0 to 1, of ground truths whose cell and anchor another took, since the start."""

    share: float


@dataclass(frozen=True)
class Saving:
    """Weights are about to be written to a file."""

    path: str


@dataclass(frozen=True)
class Question:
    """Darknet asks on stdin whether it really is to train on a CPU: ``yes``."""


Event: TypeAlias = Iteration | NextMap | MeanAp | Rewritten | Saving | Question

VALUE = r"[-+\w.]+"
NUMBER = f"({VALUE})"
ESCAPES = re.compile(r"\x1b\][^\x07]*\x07|\x1b\[[0-9;?]*[A-Za-z]")
ALEXEY_LINE = re.compile(
    rf"\s*(?P<iteration>\d+): (?P<loss>{VALUE}), (?P<average>{VALUE}) avg(?: loss)?, "
    rf"(?P<rate>{VALUE}) rate, {VALUE} seconds, (?P<images>\d+) images"
)
HANK_LINE = re.compile(
    rf"\s*(?P<iteration>\d+): loss=(?P<loss>{VALUE}), avg loss=(?P<average>{VALUE}), .*?"
    rf"(?:mAP|next)=(?P<next_map>\w+), rate=(?P<rate>{VALUE}), .*?(?P<images>\d+) images"
)
NEXT_MAP = re.compile(r"next mAP calculation at (\d+) iterations")
MEAN_AP = re.compile(rf"mean average precision \(mAP@[\d.]+\)\s*=\s*{NUMBER}(%?)")
REWRITTEN = re.compile(rf"rewritten_bbox = {NUMBER} %")
SAVING = re.compile(r"Saving weights to (.+)")
QUESTION = re.compile('Type "yes" to begin training')


def parse_line(line: str) -> Event | None:
    """The event that a line of the console tells, if any."""
    text = ESCAPES.sub("", line)
    try:
        if found := ALEXEY_LINE.match(text) or HANK_LINE.match(text):
            return _iteration(found.groupdict())
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


def _iteration(groups: Mapping[str, str]) -> Iteration:
    next_map = groups.get("next_map", "")
    return Iteration(
        iteration=int(groups["iteration"]),
        loss=float(groups["loss"]),
        average_loss=float(groups["average"]),
        learning_rate=float(groups["rate"]),
        images=int(groups["images"]),
        next_map=int(next_map) if next_map.isdigit() else 0,
    )


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
