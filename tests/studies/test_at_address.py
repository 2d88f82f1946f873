"""Results at addresses: what is sent, what is fetched, and that both ends agree."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from droptrack.errors import DroptrackError
from droptrack.studies.at_address import Place, place_of, send_video
from droptrack.studies.jobs import STATE, Kept, left_to_do
from droptrack.studies.work import do_video
from tests.studies.test_batch import Clips, batch, rows, summary
from tests.studies.test_work import job, silent

fsspec = pytest.importorskip("fsspec")
DONE = Kept(state="done", identity="/lab/a.avi", made_from={"bytes": 3}, tracked=True)


@pytest.fixture
def address() -> str:
    """An empty place in memory."""
    memory = fsspec.filesystem("memory")
    if memory.exists("/lab/study"):
        memory.rm("/lab/study", recursive=True)
    return "memory://lab/study"


def results(folder: Path, rows: str, kept: Kept = DONE) -> Path:
    """A folder as a video leaves it."""
    (folder / "analysis").mkdir(parents=True, exist_ok=True)
    (folder / "trajectories.csv").write_text(rows)
    (folder / "analysis" / "size.json").write_text("{}")
    (folder / "tracked.mp4").write_bytes(b"film")
    (folder / "detections.part").write_bytes(b"begun")
    kept.write(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_another_machine_finds_what_was_sent_but_for_films(address: str, tmp_path: Path) -> None:
    sent = results(tmp_path / "here" / "a", "1,2")
    send_video(sent, f"{address}/a")
    memory = fsspec.filesystem("memory")
    assert memory.exists("/lab/study/a/tracked.mp4")
    assert not memory.exists("/lab/study/a/detections.part")
    other = Place(tmp_path / "there", address)
    other.fetch()
    expected = contents(sent)
    del expected["tracked.mp4"], expected["detections.part"]
    assert contents(other.folder / "a") == expected


def test_only_what_is_new_is_fetched_and_what_was_begun_here_stays(
    address: str, tmp_path: Path
) -> None:
    place = Place(tmp_path / "there", address)
    send_video(results(tmp_path / "a", "old"), f"{address}/a")
    place.fetch()
    (place.folder / "a" / "trajectories.csv").write_text("mine")
    place.fetch()
    assert (place.folder / "a" / "trajectories.csv").read_text() == "mine"
    (tmp_path / "a" / "analysis" / "size.json").unlink()
    send_video(results(tmp_path / "a", "new", replace(DONE, seconds=2.0)), f"{address}/a")
    place.fetch()
    assert (place.folder / "a" / "trajectories.csv").read_text() == "new"
    results(place.folder / "a", "begun", replace(DONE, state="running"))
    place.fetch()
    assert (place.folder / "a" / "trajectories.csv").read_text() == "begun"


def test_results_that_are_no_more_are_removed_there(address: str, tmp_path: Path) -> None:
    folder = results(tmp_path / "a", "1")
    send_video(folder, f"{address}/a")
    (folder / "analysis" / "size.json").unlink()
    send_video(folder, f"{address}/a")
    memory = fsspec.filesystem("memory")
    assert not memory.exists("/lab/study/a/analysis/size.json")
    assert memory.exists("/lab/study/a/trajectories.csv")


def test_tables_are_sent_when_they_are_new(address: str, tmp_path: Path) -> None:
    place = Place(tmp_path, address)
    part = tmp_path / "trajectories" / "video=a" / "rows.parquet"
    part.parent.mkdir(parents=True)
    part.write_bytes(b"1")
    (tmp_path / "summary.csv").write_text("a")
    place.send_tables()
    memory = fsspec.filesystem("memory")
    target = "/lab/study/trajectories/video=a/rows.parquet"
    assert memory.cat_file(target) == b"1"
    first = memory.created(target)
    place.send_tables()
    assert memory.created(target) == first
    part.write_bytes(b"2")  # of the same length
    place.send_tables()
    assert memory.cat_file(target) == b"2"
    part.unlink()
    place.send_tables()
    assert not memory.exists(target)
    assert memory.cat_file("/lab/study/summary.csv") == b"a"


def test_a_video_whose_results_cannot_be_sent_has_failed_and_is_not_tracked_again(
    address: str, clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = replace(job(clips(tmp_path / "a.avi", 0, 2), tmp_path), address=f"{address}/a")
    memory = type(fsspec.filesystem("memory"))

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as broken:
        broken.setattr(memory, "put_file", refuse)
        outcome = do_video(one, silent)
    assert outcome.reason == f"{address}/a: Permission denied"
    assert left_to_do(one) == f"failed: {outcome.reason}"
    before = (one.folder / "trajectories.csv").stat().st_mtime_ns
    assert do_video(one, silent).reason == ""
    assert (one.folder / "trajectories.csv").stat().st_mtime_ns == before
    stored = fsspec.filesystem("memory").cat_file("/lab/study/a/trajectories.csv")
    assert stored == (one.folder / "trajectories.csv").read_bytes()


def test_a_study_at_an_address_is_the_one_in_a_folder(
    clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "one machine"))
    clips(tmp_path / "a.avi", 0, 4)
    clips(tmp_path / "b.avi", 4, 4)
    address = (tmp_path / "there").as_uri()
    batch(tmp_path / "*.avi", "--out", tmp_path / "here")
    batch(tmp_path / "*.avi", "--out", address)
    here, there = tmp_path / "here", tmp_path / "there"
    assert set(contents(there)) == set(contents(here))
    for name in "ab":
        assert rows(there / name) == rows(here / name)
    shown = [{**row, "seconds": ""} for out in (here, there) for row in summary(out).values()]
    assert shown[:2] == shown[2:]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another machine"))
    digest = hashlib.sha256((there / "a" / STATE).read_bytes()).digest()
    assert "2 videos: all are there" in batch(tmp_path / "*.avi", "--out", address)
    assert hashlib.sha256((there / "a" / STATE).read_bytes()).digest() == digest


def test_an_address_that_cannot_be_is_said_in_one_line() -> None:
    with pytest.raises(DroptrackError, match="no-such://lab/study: Protocol not known"):
        place_of("no-such://lab/study/")
    with pytest.raises(DroptrackError, match="is live"):
        place_of("rtsp://camera/1")
