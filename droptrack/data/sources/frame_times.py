"""When the frames of a video file are shown, as its container says, and their numbers by that.

FFmpeg leaves out frames that it cannot decode, and those that are not in the file, and counts on.
Where frames come at a steady rate, their times tell how many are missing between two of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MAX_ODD = 0.5  # of a step, that one may be longer or shorter
MAX_OFF = 0.05  # of a step, that frames at a steady rate may be early or late
MAX_DRIFT = 0.01  # of a step, that all of them may be longer or shorter on average
MAX_AWAY = 2  # steps, that a frame may come too early or too late beside that
ROUNDED_MS = 1.0  # some containers count milliseconds
MIN_ROUNDED = 2.5  # of these in a step that can be told from a longer one
MIN_APART = 0.9  # share of the frames that have a time of their own
MIN_STEPS = 4  # to tell whether they are steady
MIN_STEADY = 0.95  # share of the steps that are whole numbers of the usual one
MIN_USUAL = 0.5  # share of the steps that are the usual one
FOLLOWED = 0.2  # of what a frame comes too late is taken for a change of the clock
MAX_GAP_S = 86_400.0  # longer ones are no times
SPARSE = (
    "{n} of its frames are missing, and it has the times of some frames only: where they are "
    "missing is not certain, so that numbers of frames before these places may be wrong"
)
BEYOND = (
    "its last frame has the time {last:.4g} s, but it claims to be {length:.4g} s long: numbers "
    "may be wrong where frames seem to be missing"
)


def steady_step(times_ms: Sequence[float], rounded_ms: float = ROUNDED_MS) -> float:
    """The step, ms, from frame to frame at a steady rate, with gaps between some; 0 if it is not.

    `times_ms`: those of many frames, in any order, which the file rounds to `rounded_ms`.

    >>> steady_step([0, 40, 80, 200, 240, 160, 320])
    40.0
    >>> steady_step([0, 40, 95, 120, 190, 240])
    0.0
    """
    steps = np.diff(np.unique(times_ms))
    if len(steps) < max(MIN_STEPS, MIN_APART * (len(times_ms) - 1)):
        return 0.0
    median = np.median(steps)
    step = float(steps[np.abs(steps - median) <= MAX_ODD * median].mean())
    n = np.maximum(1, np.round(steps / step))
    steady = np.abs(steps - n * step) <= MAX_OFF * step + rounded_ms
    if step < MIN_ROUNDED * rounded_ms or steady.mean() < MIN_STEADY or (n == 1).mean() < MIN_USUAL:
        return 0.0
    return step


@dataclass
class FrameTimes:
    """Numbers of frames by their times, and whether these are those of the rate a file claims.

    `step_ms`: see `steady_step`; 0: frames are counted one by one. `sparse`: the file has the times
    of some frames only, as MPEG program streams have. `rounded_ms`: of its times. `shown`: False
    where times are not of when frames are shown, as in AVI files, which store some before their
    turn. `length_ms`: that it claims, 0 unknown.

    >>> times = FrameTimes(25, 40)
    >>> [times.add(t) for t in (0, 40, 80, 280, 320)]
    [0, 1, 2, 7, 8]
    >>> times.n_odd, times.n_left_out
    (0, 4)
    """

    rate: float  # frames a second; 0 where the file does not say
    step_ms: float = 0.0
    sparse: bool = False
    rounded_ms: float = ROUNDED_MS
    shown: bool = True
    length_ms: float = 0.0
    all_black: str = ""  # what is to be said where all frames were so
    n_steps: int = 0
    n_odd: int = 0
    n_left_out: int = 0
    _earliest: float = 0.0
    _first: float = 0.0
    _last: float | None = None
    _clock: float = 0.0
    _away: float = 0.0  # steps
    _number: int = -1

    def look_ahead(self, times_ms: Sequence[float]) -> str:
        """Learn from times of many frames, in any order, whether they are steady, and the rate.

        Returns what is to be said where that is not the rate which the file claims: some count
        frames that are missing in, or the ticks of a clock.
        """
        self._earliest = min(times_ms, default=0.0)
        step = steady_step(times_ms, self.rounded_ms) if self.rate else 0.0
        self.step_ms = step if self.shown else 0.0
        rounding = 2 * self.rounded_ms / max(1, len(times_ms))
        if not step or abs(step * self.rate / 1000 - 1) * step <= MAX_DRIFT * step + rounding:
            return ""
        claimed, self.rate = self.rate, 1000 / step
        return (
            f"claims {claimed:.5g} frames/s, but most of its frames come every {step:.4g} ms: "
            f"{self.rate:.5g} frames/s are believed"
        )

    def add(self, time_ms: float, n_failed: int = 0) -> int:
        """A frame's time -> its number; 0 ms after the first frame means that there is none.

        `n_failed`: attempts to decode one before it, by which frames without times are counted.
        """
        counted = self._number + 1 + n_failed
        if not self.rate or (self._last is not None and time_ms <= 0):
            self._number = counted if not self.step_ms else self._number + 1
            self._clock += self.step_ms
            return self._number
        if self._last is None:
            self._first = time_ms
            self._number = self._begin(time_ms) if self.step_ms else counted
            self._clock = time_ms
        else:
            n = self._steps_since(time_ms) if self.step_ms else 1
            self.n_steps += n
            wanted = 1000 / self.rate
            late = abs(time_ms - self._last - n * wanted)
            self.n_odd += late > MAX_ODD * wanted + self.rounded_ms
            self._number = self._number + n if self.step_ms else counted
            self.n_left_out += n - 1
            away = abs(time_ms - self._first - self.n_steps * wanted) / wanted
            self._away = max(self._away, away - MAX_DRIFT * self.n_steps)
        self._last = time_ms
        return self._number

    def _begin(self, time_ms: float) -> int:
        """The number of the first frame that can be decoded."""
        n = max(0, round((time_ms - self._earliest) / self.step_ms))
        self.n_left_out += n
        return n

    def _steps_since(self, time_ms: float) -> int:
        """How many steps after the last frame one comes, by a clock that follows the times."""
        late = time_ms - self._clock
        n = max(1, round(late / self.step_ms))
        if late > 1000 * MAX_GAP_S:
            n = 1
        off = late - n * self.step_ms
        slow = abs(off) <= self.step_ms  # else it jumps
        self._clock = self._clock + n * self.step_ms + FOLLOWED * off if slow else time_ms
        return n

    def doubt(self) -> str:
        """What is to be said of them; empty where all is well."""
        if self.all_black:
            return self.all_black
        if not self.n_steps or self._last is None:
            return ""
        wanted, all_steps = 1000 / self.rate, self._last - self._first
        drift = abs(all_steps / self.n_steps - wanted) * self.n_steps
        if self.sparse and self.n_left_out:
            return SPARSE.format(n=self.n_left_out)
        if self.n_left_out and 0 < self.length_ms < self._last - wanted:
            return BEYOND.format(last=self._last / 1000, length=self.length_ms / 1000)
        drifts = drift > MAX_DRIFT * self.n_steps * wanted + 2 * self.rounded_ms
        wanders = self._away * wanted > MAX_AWAY * wanted + 2 * self.rounded_ms
        if not (self.n_odd or drifts or wanders):
            return ""
        mean = all_steps / self.n_steps / 1000
        which = f"{self.n_odd} of the {self.n_steps} steps from frame to frame are not"
        if not self.n_odd and not drifts:
            which = f"frames come up to {self._away:.1f} steps early or late, if a step is"
        elif not self.n_odd:
            which = f"the steps from frame to frame are {mean:.4g} s on average, not"
        return (
            f"{which} 1/{self.rate:g} s: the video has no steady rate, so that velocities are "
            "wrong there, or frames are missing; with steady steps: ffmpeg -i IN -fps_mode cfr "
            "OUT.avi"
        )
