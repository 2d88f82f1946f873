"""What a run tells its user beside the results."""

import sys
from collections.abc import Callable

from droptrack.data.video import Video
from droptrack.pipeline.results import Results

MAX_NAMED = 5  # gaps in one line
Say = Callable[[str], object]


def to_stderr(text: str) -> None:
    """Tell it on stderr."""
    print(text, file=sys.stderr)


def say_what_is_missing(name: str, source: Video, n_missing: int, say: Say) -> None:
    """Tell how many frames of a source were lost or damaged."""
    if source.n_lost:
        say(f"{name}: about {source.n_lost} frames lost while the stream was away")
        return
    n_missing -= source.n_absent
    n_left_out = min(n_missing, source.n_left_out)
    if n_left_out > 0:
        say(f"{name}: {left_out(source)}")
    if n_missing > n_left_out:
        claims = f"of the {source.info.n_frames} frames it claims " if source.counted else "frames "
        say(
            f"{name}: {n_missing - n_left_out} {claims}could not be decoded: it is damaged"
            f"{', or ends early' if source.counted else ''}"
        )


def left_out(source: Video) -> str:
    """How many frames are missing between others; empty where none is."""
    if not source.n_left_out:
        return ""
    return (
        f"{source.n_left_out} frames are missing, by the times of those around them: damaged, or "
        "never recorded; the others have their own numbers"
    )


def say_what_is_unsure(source: str, results: Results, say: Say) -> None:
    """Tell which tracks of a source are to be doubted."""
    if results.velocities:
        believed, other = ("{:.3g},{:.3g}".format(*one) for one in results.velocities)
        say(
            f"{source}: velocity_is_ambiguous: droplets may go {believed} or {other} px a frame; "
            f"the first was believed; if it is wrong, give --expect-velocity={other}"
        )
    backwards = [gap for gap in results.gaps if gap.against_flow]
    if backwards:
        where = ", ".join(
            f"{gap.track_id} (frames {gap.first_frame} to {gap.first_frame + gap.n_frames - 1})"
            for gap in backwards[:MAX_NAMED]
        )
        more = f" and {len(backwards) - MAX_NAMED} more" if len(backwards) > MAX_NAMED else ""
        say(
            f"{source}: gaps were bridged against the flow, of droplets {where}{more}: look at them"
        )
