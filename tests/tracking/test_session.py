"""Frames in, final rows out: frames that are left out, and rows that come together and once."""

import numpy as np
import pytest

from droptrack.data.detections import Detections, labels
from droptrack.tracking.deepsort.tracker import DeepSortParameters, DeepSortTracker
from droptrack.tracking.droplet.parameters import DropletParameters
from droptrack.tracking.droplet.tracker import DropletTracker
from droptrack.tracking.recorder import Recorded, concatenated
from droptrack.tracking.session import TrackingSession


def disc(frame: int) -> Detections:
    """One droplet of 20 px that moves 2 px a frame."""
    return labels([[50 + 2 * frame, 40, 20, 20]])


def run(session: TrackingSession, frames: list[int]) -> list[Recorded]:
    """What each frame makes final, and the rest."""
    parts = [session.add_boxes(t, disc(t), np.zeros((1, 0))) for t in frames]
    return [*parts, session.finish()]


def droplets(*, live: bool = False) -> TrackingSession:
    return TrackingSession(DropletTracker(DropletParameters()), live=live)


def test_a_frame_that_is_left_out_is_one_without_detections() -> None:
    frames = [t for t in range(40) if t not in {0, 12, 20, 21, 22}]
    left_out = concatenated(run(droplets(), frames)).rows
    session, parts = droplets(), []
    for t in range(1, 40):
        found = disc(t) if t in frames else labels([])
        parts.append(session.add_boxes(t, found, np.zeros((len(found), 0))))
    empty = concatenated([*parts, session.finish()]).rows
    for name in ("frame", "track_id", "x", "y", "boxes", "scores", "observed"):
        np.testing.assert_array_equal(getattr(left_out, name), getattr(empty, name))
    assert left_out.frame[~left_out.observed].tolist() == [12, 20, 21, 22]
    assert left_out.x.tolist() == pytest.approx([50 + 2 * t for t in range(1, 40)])


def test_a_live_source_may_leave_out_any_number_of_frames() -> None:
    """29 of 30, more than a droplet may be missed: 60 px, three diameters between two frames."""
    frames = list(range(0, 300, 30))
    slow = [labels([[50 + 2 * t / 30, 40, 20, 20]]) for t in frames]
    for live, n_tracks in ((True, 1), (False, 0)):
        session = droplets(live=live)
        parts = [
            session.add_boxes(t, found, np.zeros((1, 0)))
            for t, found in zip(frames, slow, strict=True)
        ]
        rows = concatenated([*parts, session.finish()]).rows
        assert len(np.unique(rows.track_id)) == n_tracks
        assert rows.frame[rows.observed].tolist() == (frames if live else [])


def test_rows_come_with_every_tenth_frame_in_order_and_once() -> None:
    """After 45 frames the first is final: the tracker's delay of 24 and its 20 misses."""
    session = droplets()
    parts = run(session, list(range(70)))
    given = {t: part.rows.frame.tolist() for t, part in enumerate(parts) if len(part.rows)}
    assert given == {
        50: list(range(5)),
        60: list(range(5, 15)),
        70: list(range(15, 70)),
    }


def test_droplets_of_a_video_too_short_to_confirm_any_are_given() -> None:
    for n_frames, n_rows in ((1, 1), (2, 2), (3, 3)):
        session = TrackingSession(DeepSortTracker(DeepSortParameters()))
        parts = [session.add_boxes(t, disc(t), np.ones((1, 1))) for t in range(n_frames)]
        assert len(concatenated([*parts, session.finish()]).rows) == n_rows
    session = TrackingSession(DeepSortTracker(DeepSortParameters()))
    for t in range(2):
        session.add_boxes(t, disc(t), np.ones((1, 1)))
    session.add_boxes(2, labels([]), np.zeros((0, 1)))
    assert len(session.finish().rows) == 0


def test_the_rows_of_a_frame_are_known_after_the_delay() -> None:
    session = droplets()
    for t in range(30):
        session.add_boxes(t, disc(t), np.zeros((1, 0)))
        if t >= session.delay:
            (row,) = session.rows_of(t - session.delay)
            assert (row.track_id, row.values[0]) == (1, 50 + 2 * (t - session.delay))
