"""How far something is: plain lines where nobody looks at a terminal."""

import re
import time

import pytest

from droptrack import progress
from droptrack.progress import in_words, progress_bar, with_progress


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line each 50 ms, as otherwise each half minute."""
    monkeypatch.setattr(progress, "LINE_S", 0.05)


def lines_of(capsys: pytest.CaptureFixture[str], n: int) -> list[str]:
    """The first lines on stderr, once there are so many."""
    text = ""
    for _ in range(1000):
        text += capsys.readouterr().err
        if text.count("\n") >= n:
            break
        time.sleep(0.01)
    return text.splitlines()[:n]


@pytest.mark.usefixtures("often")
def test_a_log_gets_what_is_done_the_rate_and_the_time_left(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress_bar("frames") as bars:
        task = bars.add_task("tracking", total=1000, completed=100, note="")
        bars.update(task, completed=150)  # of a resumed one, the past does not count
        lines = lines_of(capsys, 2)
    found = [
        re.fullmatch(r"tracking: 150 of 1000 frames, ([\d.]+) frames/s, (.*) left", line)
        for line in lines
    ]
    first, second = (float(one[1]) for one in found if one)
    assert second < first <= 1000  # 50 frames in 50 ms or more


@pytest.mark.usefixtures("often")
def test_a_note_with_a_rate_of_its_own_is_printed_instead(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress_bar("frames") as bars:
        task = bars.add_task("shear", total=None, note="")
        bars.update(task, completed=3, note="120 steps/s")
        assert lines_of(capsys, 1) == ["shear: 3 frames, 120 steps/s"]


@pytest.mark.usefixtures("often")
def test_items_are_counted_in_a_log_too(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in with_progress(range(4), 4, "scoring", "images"):
        time.sleep(0.1)
    said = capsys.readouterr().err
    assert re.search(r"scoring: [123] of 4 images, .* left", said)


@pytest.mark.usefixtures("often")
def test_what_is_not_to_be_shown_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("frames", shown=False) as bars:
        bars.add_task("tracking", total=10)
        time.sleep(0.12)
    with progress_bar("frames") as bars:  # ended before its first line
        bars.add_task("tracking", total=10)
    time.sleep(0.08)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_times_are_said_as_one_says_them() -> None:
    assert [in_words(s) for s in (0.2, 59.6, 3599, 3600, 90061)] == [
        "0 s",
        "1 min 0 s",
        "59 min 59 s",
        "1 h 0 min",
        "25 h 1 min",
    ]
