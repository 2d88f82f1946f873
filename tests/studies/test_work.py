"""What a worker does with a video, in this process; and workers that die of one."""

import errno
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from droptrack.data.trajectories import read_trajectories
from droptrack.errors import DroptrackError
from droptrack.pipeline import open_detector
from droptrack.pipeline.run import run
from droptrack.studies import local, work
from droptrack.studies import run as study_run
from droptrack.studies.at_address import Place
from droptrack.studies.jobs import LOG, Job, job_of, left_to_do, read_kept
from droptrack.studies.local import LocalWorkers, fitting_workers
from droptrack.studies.options import Given
from droptrack.studies.outcome import Outcome
from droptrack.studies.run import Study, plan
from droptrack.studies.sources import find_videos
from droptrack.studies.summary import summarise
from droptrack.studies.work import do_video
from droptrack.studies.workers import Deaths, Note, Told
from tests.studies.options import OPTIONS
from tests.studies.test_batch import Clips

FAST: dict[str, Given] = {"size": ("480x256",), "backend": ("opencv",), "no_video": True}


def job(video: Path | str, out: Path, name: str = "a") -> Job:
    return job_of(name, out / name, OPTIONS.config(str(video), FAST), {})


def silent(*_: int) -> None:
    pass


def test_videos_at_addresses_are_copied_done_and_the_copies_deleted(
    clips: Clips, tmp_path: Path
) -> None:
    fsspec = pytest.importorskip("fsspec")
    path = clips(tmp_path / "a.avi", 0, 4)
    memory = fsspec.filesystem("memory")
    memory.pipe("/lab/a.avi", path.read_bytes())
    memory.pipe("/lab/b.txt", b"")
    entries = find_videos(["memory://lab/*"], OPTIONS, print)
    assert [entry.video for entry in entries] == ["memory:///lab/a.avi"]
    ours, theirs = job(path, tmp_path / "here"), job(entries[0].video, tmp_path / "there")
    for one in (ours, theirs):
        assert do_video(one, silent).reason == ""
    here, there = (read_trajectories(one.folder / "trajectories.csv")[0] for one in (ours, theirs))
    assert here.x.tolist() == there.x.tolist()
    assert not list(theirs.folder.glob("*.avi"))
    assert left_to_do(job(entries[0].video, tmp_path / "there")) == ""
    memory.pipe("/lab/a.avi", path.read_bytes() + b"0")
    assert "changed: bytes" in left_to_do(job(entries[0].video, tmp_path / "there"))
    gone = do_video(job("memory://lab/none.avi", tmp_path / "gone"), silent)
    assert gone.reason == "memory://lab/none.avi: no such file"


def test_a_defect_is_one_line_with_the_rest_in_the_log(
    clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise IndexError("list index\nout of range")

    one = job(clips(tmp_path / "a.avi", 0, 2), tmp_path)
    monkeypatch.setattr(work, "run", broken)
    outcome = do_video(one, silent)
    assert outcome.reason == f"IndexError: list index out of range; see {one.folder / LOG}"
    assert "Traceback" in (one.folder / LOG).read_text()
    assert left_to_do(one) == f"failed: {outcome.reason}"


def test_a_full_disk_ends_the_study_and_keeps_what_was_done(
    clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "abc":
        clips(tmp_path / f"{name}.avi", 0, 2)
    study = Study(sources=(str(tmp_path / "*.avi"),), place=Place(tmp_path / "out"), options=FAST)
    planned = plan(study, OPTIONS, print)

    def full(config: object, *rest: object, **options: object) -> object:
        if "/b" in str(config.out):  # type: ignore[attr-defined]
            raise OSError(errno.ENOSPC, "No space left on device", "out/b/trajectories.csv")
        return run(config, *rest, **options)  # type: ignore[arg-type]

    class Here:
        described = "here"

        def work(self, jobs: Sequence[Job]) -> Generator[Told]:
            for one in jobs:
                yield do_video(one, silent)

    monkeypatch.setattr(work, "run", full)
    said: list[str] = []
    outcomes: list[Outcome] = []
    with pytest.raises(DroptrackError, match="the disk is full after 2 of 3 videos; what was done"):
        study_run._do(study, planned.to_do, Here(), outcomes, said.append)
    assert said == ["b: failed: out/b/trajectories.csv: No space left on device"]
    reasons = plan(study, OPTIONS, print).reasons
    assert reasons[0] == ""
    assert reasons[1].startswith("failed: out/b")
    assert reasons[2] == "new"


def test_a_worker_of_another_version_does_nothing(clips: Clips, tmp_path: Path) -> None:
    one = replace(job(clips(tmp_path / "a.avi", 0, 2), tmp_path), version="99.0")
    outcome = do_video(one, silent)
    assert "the batch 99.0: install one version everywhere" in outcome.reason
    assert outcome.other_version
    assert not one.folder.exists()


def test_a_worker_of_another_version_that_comes_later_ends_the_study(
    clips: Clips, tmp_path: Path
) -> None:
    """It would take one video after the other, and do none."""
    for name in "abc":
        clips(tmp_path / f"{name}.avi", 0, 2)
    study = Study(sources=(str(tmp_path / "*.avi"),), place=Place(tmp_path / "out"), options=FAST)
    planned = plan(study, OPTIONS, print)
    outcomes: list[Outcome] = []

    class Two:
        described = "one of this version, and one of another"

        def work(self, jobs: Sequence[Job]) -> Generator[Told]:
            yield do_video(jobs[0], silent)
            yield do_video(replace(jobs[1], version="99.0"), silent)
            raise AssertionError

    with pytest.raises(DroptrackError, match=r"99\.0: install .* after 1 of 3 videos; what was"):
        study_run._do(study, planned.to_do, Two(), outcomes, print)
    assert plan(study, OPTIONS, print).reasons == ("", "new", "new")


def test_what_was_chosen_for_a_video_makes_it_no_doubtful_one(
    clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of all that a laboratory films: the model, the scale, the pixel that the file says."""
    monkeypatch.setattr(open_detector, "MIN_AGREEMENT", 2.0)  # no video is for the other model
    for name, options in (("a", ()), ("b", ("--weights", "simulations"))):
        video = clips(tmp_path / f"{name}.avi", 0, 3)
        config = OPTIONS.configured(
            [*options, "--backend", "opencv", "--no-video", "--", str(video)]
        )
        one = job_of(name, tmp_path / "out" / name, config, {})
        assert do_video(one, silent).reason == ""
        kept = read_kept(one.folder)
        assert kept is not None
        chosen = [line for line in kept.said if "as laboratories film them" in line]
        assert len(chosen) == (name == "a")
        assert summarise(one)["warnings"] == ""


def test_results_of_another_video_are_never_replaced(clips: Clips, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert do_video(job(clips(tmp_path / "a.avi", 0, 3), out), silent).reason == ""
    table = (out / "a" / "trajectories.csv").read_bytes()
    other = job(clips(tmp_path / "b.avi", 9, 3), out)
    assert "would be overwritten; it has results of" in do_video(other, silent).reason
    assert (out / "a" / "trajectories.csv").read_bytes() == table
    kept = read_kept(out / "a")
    assert kept is not None
    assert kept.state == "failed"


def test_a_video_that_kills_its_workers_is_given_up_and_others_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a worker that dies at the video "bad", as OpenCV may at a damaged file."""
    monkeypatch.setattr(local, "MODULE", "tests.studies.dying_process")
    jobs = [job(tmp_path / f"{name}.avi", tmp_path, name) for name in ("a", "bad", "b")]
    told = list(LocalWorkers(1).work(jobs))
    outcomes = {one.name: one.reason for one in told if isinstance(one, Outcome)}
    assert outcomes["a"] == outcomes["b"] == ""
    assert "was killed by signal 9 (for want of memory?), again and again" in outcomes["bad"]
    assert sum(isinstance(one, Note) for one in told) == 2  # tried again twice


def test_a_worker_that_is_killed_while_it_starts_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "MODULE", "tests.studies.process_killed_at_start")
    monkeypatch.setenv("KILLED_BEFORE", str(tmp_path / "killed"))
    told = list(LocalWorkers(1).work([job(tmp_path / "a.avi", tmp_path)]))
    assert [one.reason for one in told if isinstance(one, Outcome)] == [""]
    (note,) = (one.text for one in told if isinstance(one, Note))
    assert "was killed by signal 9 (for want of memory?) while it started" in note


def test_a_worker_that_cannot_start_is_said_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(local, "MODULE", "tests.studies.no_such_module")
    with pytest.raises(DroptrackError, match="a worker ended with 1 while it started"):
        list(LocalWorkers(1).work([job(tmp_path / "a.avi", tmp_path)]))
    assert "no_such_module" in capfd.readouterr().err


def test_deaths_count_only_where_a_video_does_not_get_on() -> None:
    deaths = Deaths()
    for frame in range(10):  # nodes that go, one after the other
        deaths.advanced("long", 100 * frame)
        assert deaths.died("long")
    for again in (True, True, False):
        deaths.advanced("bad", 7)
        assert deaths.died("bad") is again


def test_workers_that_are_killed_anywhere_say_little_of_the_video() -> None:
    """As where something kills a worker every few seconds, and starting takes as long."""
    deaths = Deaths()
    assert all(deaths.died("a") for _ in range(9))  # before a first frame
    for frame in (150, 20, 90, 30, 149, 60, 10, 80, 140):  # done, and its last files not written
        deaths.advanced("a", frame)
        assert deaths.died("a")
    assert not deaths.died("a")  # the tenth since it came to frame 150


def test_workers_fit_cores_and_memory() -> None:
    assert fitting_workers(1, 0) == 1
    assert fitting_workers(2, 16 * 2**30) == 1
    assert fitting_workers(64, 16 * 2**30) == 11
    assert fitting_workers(64, 100) == 1
