import numpy as np
import pytest

from droptrack.deepsort import Update
from droptrack.recorder import Recorder
from droptrack.trajectories import Trajectories


def add(
    recorder: Recorder,
    frame: int,
    where: dict[int, float],
    confirmed: tuple[int, ...] = (),
    ended: tuple[int, ...] = (),
) -> None:
    """Droplets by identity at x = y = where, boxes of 10 px."""
    ids = np.array(list(where), np.int64)
    centres = np.array([[v, v] for v in where.values()]).reshape(-1, 2)
    boxes = np.hstack([centres, np.full_like(centres, 10)])
    recorder.add(frame, centres, boxes, np.full(len(ids), 0.9), Update(ids, confirmed, ended))


def table(rows: Trajectories) -> list[tuple[int, int, float, bool]]:
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
    recorder = Recorder(max_age=30)
    for frame in range(3):
        add(recorder, frame, {1: frame}, confirmed=(1,) if frame == 2 else ())
    assert table(recorder.take_rest(unconfirmed=False)) == [(t, 1, t, True) for t in range(3)]


def test_a_track_that_is_never_confirmed_leaves_no_rows() -> None:
    recorder = Recorder(max_age=30)
    add(recorder, 0, {1: 5})
    add(recorder, 1, {}, ended=(1,))
    assert len(recorder.take_rest(unconfirmed=True)) == 0


def test_a_gap_is_bridged_on_a_straight_line_and_said_to_be() -> None:
    recorder = Recorder(max_age=30)
    add(recorder, 0, {1: 10.0}, confirmed=(1,))
    for frame in (1, 2):
        add(recorder, frame, {})
    add(recorder, 3, {1: 16.0})
    rows = recorder.take_rest(unconfirmed=False)
    assert table(rows) == [(0, 1, 10, True), (1, 1, 12, False), (2, 1, 14, False), (3, 1, 16, True)]
    assert rows.scores.tolist() == [0.9, 0, 0, 0.9]


def test_rows_are_final_once_no_gap_can_reach_back_and_given_once() -> None:
    recorder = Recorder(max_age=2)
    given = []
    for frame in range(6):
        add(recorder, frame, {1: frame}, confirmed=(1,) if frame == 0 else ())
        given.append(table(recorder.take_final(frame)))
    assert [len(rows) for rows in given] == [0, 0, 0, 1, 1, 1]
    assert given[3] == [(0, 1, 0, True)]
    assert [t for t, *_ in table(recorder.take_rest(unconfirmed=False))] == [3, 4, 5]


def test_the_rows_of_a_frame_can_be_seen_before_they_are_final() -> None:
    recorder = Recorder(max_age=30)
    add(recorder, 0, {1: 1.0})
    assert recorder.rows_of(0) == []
    add(recorder, 1, {1: 2.0}, confirmed=(1,))
    assert [row.track_id for row in recorder.rows_of(0)] == [1]
    assert recorder.rows_of(0)[0].values[0] == pytest.approx(1)
