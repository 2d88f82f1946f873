"""When the frames of a video file are shown, as its container says."""

from dataclasses import dataclass

MAX_ODD = 0.5  # of a step, that one may be longer or shorter
MAX_DRIFT = 0.01  # of a step, that all of them may be longer or shorter on average
ROUNDED_MS = 1.0  # some containers count milliseconds


@dataclass
class FrameTimes:
    """Whether the steps from frame to frame are those of the rate that a file claims.

    >>> times = FrameTimes(25)
    >>> for t in (0, 40, 80, 280, 320):
    ...     times.add(t)
    >>> times.n_odd, times.n_steps
    (1, 4)
    """

    rate: float  # frames a second; 0 where the file does not say
    n_steps: int = 0
    n_odd: int = 0
    _first: float = 0.0
    _last: float | None = None

    def add(self, time_ms: float) -> None:
        """A frame's time; 0 after the first frame means that there is none."""
        if not self.rate or (self._last is not None and time_ms <= 0):
            return
        if self._last is None:
            self._first = time_ms
        else:
            self.n_steps += 1
            wanted = 1000 / self.rate
            self.n_odd += abs(time_ms - self._last - wanted) > MAX_ODD * wanted + ROUNDED_MS
        self._last = time_ms

    def doubt(self) -> str:
        """What is to be said of them; empty where all is well."""
        if not self.n_steps or self._last is None:
            return ""
        wanted, all_steps = 1000 / self.rate, self._last - self._first
        drift = abs(all_steps / self.n_steps - wanted) * self.n_steps
        if not self.n_odd and drift <= MAX_DRIFT * self.n_steps * wanted + 2 * ROUNDED_MS:
            return ""
        mean = all_steps / self.n_steps / 1000
        which = f"{self.n_odd} of the {self.n_steps} steps from frame to frame are not"
        if not self.n_odd:
            which = f"the steps from frame to frame are {mean:.4g} s on average, not"
        return (
            f"{which} 1/{self.rate:g} s: the video has no steady rate, so that velocities are "
            "wrong there, or frames are missing; with steady steps: ffmpeg -i IN -fps_mode cfr "
            "OUT.avi"
        )
