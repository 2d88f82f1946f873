import numpy as np
import pytest

from droptrack.data.detections import Detections
from droptrack.tracking.recorder import Recorded, Recorder
from droptrack.tracking.tracker import Resumption, Unseen, Update


def add(
    recorder: Recorder,
    frame: int,
    where: dict[int, float],
    confirmed: tuple[int, ...] = (),
    terminated: tuple[int, ...] = (),
    merged: tuple[tuple[int, int], ...] = (),
    resumed: tuple[Resumption, ...] = (),
    unseen: tuple[Unseen, ...] = (),
    again: tuple[Update, ...] = (),
) -> None:
    """Droplets by identity at x = y = where, boxes of 10 px."""
    ids = np.array(list(where), np.int64)
    centres = np.array([[v, v] for v in where.values()]).reshape(-1, 2)
    boxes = np.hstack([centres, np.full_like(centres, 10)])
    found = Detections(boxes, np.full(len(ids), 0.9), np.zeros(len(ids), np.int64))
    update = Update(
        track_ids=ids,
        confirmed=confirmed,
        terminated=terminated,
        merged=merged,
        resumed=resumed,
        unseen=unseen,
        again=again,
    )
    recorder.add(frame, found, centres, np.ones(len(ids), bool), update)


def table(recorded: Recorded) -> list[tuple[int, int, float, bool]]:
    rows = recorded.rows
    return list(
        zip(
            rows.frame.tolist(),
            rows.track_id.tolist(),
            rows.x.tolist(),
            rows.observed.tolist(),
            strict=True,
        )
    )


def test_frames_before_confirmation_are_filled_in() -> None:
    recorder = Recorder(hold=30)
    for frame in range(3):
        add(recorder, frame, {1: frame}, confirmed=(1,) if frame == 2 else ())
    assert table(recorder.take_rest(unconfirmed=False)) == [(t, 1, t, True) for t in range(3)]


def test_a_track_that_is_never_confirmed_leaves_no_rows() -> None:
    recorder = Recorder(hold=30)
    add(recorder, 0, {1: 5})
    add(recorder, 1, {}, terminated=(1,))
    assert table(recorder.take_rest(unconfirmed=True)) == []


def test_a_gap_is_bridged_on_a_straight_line_and_said_to_be() -> None:
    recorder = Recorder(hold=30)
    add(recorder, 0, {1: 10.0}, confirmed=(1,))
    for frame in (1, 2):
        add(recorder, frame, {})
    add(recorder, 3, {1: 16.0})
    rows = recorder.take_rest(unconfirmed=False)
    assert table(rows) == [(0, 1, 10, True), (1, 1, 12, False), (2, 1, 14, False), (3, 1, 16, True)]
    assert rows.rows.scores.tolist() == [0.9, 0, 0, 0.9]
    assert rows.measured.tolist() == [True, False, False, True]


@pytest.mark.parametrize("confirmed_at", [2, 3])
def test_a_gap_before_confirmation_is_bridged_too(confirmed_at: int) -> None:
    recorder = Recorder(hold=30)
    for frame, where in enumerate([{1: 10.0}, {}, {1: 14.0}, {1: 16.0}]):
        add(recorder, frame, where, confirmed=(1,) if frame == confirmed_at else ())
    rows = table(recorder.take_rest(unconfirmed=False))
    assert rows == [(0, 1, 10, True), (1, 1, 12, False), (2, 1, 14, True), (3, 1, 16, True)]


def test_a_droplet_in_view_but_not_seen_has_rows_that_say_so() -> None:
    """Boxes in frames 3 to 5; it was there in 1 and 2, and known in frame 7 to have been in 6."""
    recorder = Recorder(hold=30)
    for frame in range(8):
        where = {1: 10.0 * frame} if 3 <= frame <= 5 else {}
        before, after = Unseen(1, 2, -1, 2, (10.0, 10.0)), Unseen(1, 2, 1, 1, (10.0, 10.0))
        unseen = {5: (before,), 7: (after,)}.get(frame, ())
        add(recorder, frame, where, confirmed=(1,) if frame == 5 else (), unseen=unseen)
    rows = recorder.take_rest(unconfirmed=False)
    assert table(rows) == [(t, 1, 10.0 * t, 3 <= t <= 5) for t in range(1, 7)]
    assert rows.rows.boxes[:, 0].tolist() == [10.0 * t for t in range(1, 7)]
    assert rows.rows.scores.tolist() == [0, 0, 0.9, 0.9, 0.9, 0]
    assert not rows.measured[[0, 1, -1]].any()


def test_rows_are_final_once_no_gap_can_reach_back_and_given_once() -> None:
    recorder = Recorder(hold=2)
    given = []
    for frame in range(6):
        add(recorder, frame, {1: frame}, confirmed=(1,) if frame == 0 else ())
        given.append(table(recorder.take_final()))
    assert [len(rows) for rows in given] == [0, 0, 0, 1, 1, 1]
    assert given[3] == [(0, 1, 0, True)]
    assert [t for t, *_ in table(recorder.take_rest(unconfirmed=False))] == [3, 4, 5]


def test_rows_stay_in_order_where_a_live_source_leaves_frames_out() -> None:
    """One droplet is missed in two of the frames that were looked at, 0, 10, 20 and so on."""
    recorder = Recorder(hold=3)
    rows = []
    for frame in range(0, 100, 10):
        where = {1: 1.0 * frame}
        if frame not in {20, 30}:
            where[2] = 2.0 * frame
        add(recorder, frame, where, confirmed=(1, 2) if frame == 0 else ())
        rows += table(recorder.take_final())
    rows += table(recorder.take_rest(unconfirmed=False))
    assert [row[:2] for row in rows] == [(t, one) for t in range(91) for one in (1, 2)]
    assert [x for _, _, x, _ in rows] == pytest.approx([one * t for t, one, *_ in rows])
    seen = [t for t, one, _, observed in rows if one == 2 and observed]
    assert seen == [0, 10, *range(40, 100, 10)]


def test_the_rows_of_a_frame_can_be_seen_before_they_are_final() -> None:
    recorder = Recorder(hold=30)
    add(recorder, 0, {1: 1.0})
    assert recorder.rows_of(0) == []
    add(recorder, 1, {1: 2.0}, confirmed=(1,))
    assert [row.track_id for row in recorder.rows_of(0)] == [1]
    assert recorder.rows_of(0)[0].values[0] == pytest.approx(1)


def test_a_new_track_that_continues_an_old_one_gets_its_identity_and_the_gap_is_bridged() -> None:
    recorder = Recorder(hold=30)
    add(recorder, 0, {1: 10.0}, confirmed=(1,))
    add(recorder, 1, {})
    add(recorder, 2, {2: 14.0})
    add(recorder, 3, {1: 16.0}, merged=((2, 1),))
    assert table(recorder.take_rest(unconfirmed=False)) == [
        (0, 1, 10, True),
        (1, 1, 12, False),
        (2, 1, 14, True),
        (3, 1, 16, True),
    ]


def test_of_two_boxes_of_one_droplet_the_larger_counts() -> None:
    """Two tracks side by side that turn out to be one: never two rows of it in a frame."""
    recorder = Recorder(hold=30)
    add(recorder, 0, {1: 10.0}, confirmed=(1,))
    boxes = np.array([[11.0, 11, 8, 8], [13.0, 13, 9, 9]])
    found = Detections(boxes, np.ones(2), np.zeros(2, np.int64))
    update = Update(track_ids=np.array([1, 2]))
    recorder.add(1, found, boxes[:, :2], np.ones(2, bool), update)
    add(recorder, 2, {1: 14.0}, merged=((2, 1),))
    assert table(recorder.take_rest(unconfirmed=False)) == [
        (0, 1, 10, True),
        (1, 1, 13, True),
        (2, 1, 14, True),
    ]


def test_long_gaps_are_listed_with_what_the_tracker_knows_of_them() -> None:
    """Three frames are no long gap; of the second one nobody knows how sure it is."""
    recorder = Recorder(hold=40)
    add(recorder, 0, {1: 0.0}, confirmed=(1,))
    add(recorder, 4, {1: 4.0})
    sure = Resumption(1, confidence=0.9, against_flow=True)
    add(recorder, 9, {1: 1.0}, resumed=(sure,))
    add(recorder, 16, {1: 1.0})
    first, second = recorder.gaps
    assert first[:3] == (1, 5, 4)
    assert first.distance_px == pytest.approx(3 * 2**0.5)
    assert first[4:] == (0.9, True)
    assert second[:4] == (1, 10, 6, 0)
    assert np.isnan(second.confidence)


def test_the_first_frames_can_be_tracked_again() -> None:
    """What was said before is forgotten: identities, who is a droplet, and gaps."""
    recorder = Recorder(hold=40)
    add(recorder, 0, {})
    add(recorder, 1, {1: 10.0, 2: 20.0})
    add(recorder, 2, {2: 11.0, 1: 21.0}, confirmed=(1, 2))
    again = (
        Update(track_ids=np.array([5, 6])),
        Update(track_ids=np.array([5, 6]), confirmed=(5,)),
    )
    add(recorder, 3, {5: 12.0}, again=again)
    rows = table(recorder.take_rest(unconfirmed=False))
    assert rows == [(1, 5, 10, True), (2, 5, 11, True), (3, 5, 12, True)]
