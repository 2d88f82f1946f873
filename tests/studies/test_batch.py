"""Many videos with one command: what it leaves, what it does again, and what it survives."""

import csv
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from droptrack.__main__ import app
from droptrack.data.trajectories import read_trajectories
from droptrack.errors import DroptrackError
from droptrack.studies.jobs import LOG, STATE
from droptrack.studies.run import parse_part

ROOT = Path(__file__).parents[2]
FAST = ("--size", "480x256", "--backend", "opencv", "--no-video")
Clips = Callable[[Path, int, int], Path]


def batch(*words: object, code: int = 0) -> str:
    """Run ``droptrack batch`` and return what it says on stderr."""
    result = CliRunner().invoke(app, ["batch", *map(str, words), *FAST])
    assert "Traceback" not in result.output
    assert result.exit_code == code, result.output
    lines = result.stderr.splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith("videos: "))  # of slow machines


def rows(folder: Path) -> str:
    return (folder / "trajectories.csv").read_text()


def summary(out: Path) -> dict[str, dict[str, str]]:
    with (out / "summary.csv").open(encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def times(out: Path) -> dict[str, int]:
    """When each video was done last."""
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob(f"*/{STATE}")}


def redone(out: Path, before: dict[str, int]) -> set[str]:
    return {name for name, when in times(out).items() if when != before.get(name)}


AS_ROOT = ("unshare", "--map-root-user", "--mount", "sh", "-c")


def can_mount() -> bool:
    """Whether tests may mount a file system that only they see."""
    if shutil.which("unshare") is None:
        return False
    tried = subprocess.run([*AS_ROOT, "mount -t tmpfs none /tmp"], capture_output=True, check=False)
    return tried.returncode == 0


def is_done(folder: Path) -> bool:
    state = folder / STATE
    return state.is_file() and json.loads(state.read_text())["state"] == "done"


@pytest.fixture(scope="module")
def study(clips: Clips, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two videos of one name, a damaged one, and a list of them, done."""
    folder = tmp_path_factory.mktemp("study")
    clips(folder / "mon" / "a.avi", 0, 8)
    clips(folder / "tue" / "a.avi", 8, 6)
    (folder / "damaged.avi").write_bytes(b"RIFF" + bytes(500))
    (folder / "list.csv").write_text(
        "\ufeffvideo;um_per_px;sample;pressure;batch no\n"
        "mon/a.avi;0,5;oil é;1,5;007\ntue/a.avi;;water;2;008\ndamaged.avi;;;;\n",
        encoding="utf-8",
    )
    said = batch(folder / "list.csv", "--out", folder / "out", code=1)
    lines = said.splitlines()
    listed = folder / "list.csv"
    assert lines[0] == f"{listed}: columns of your own: sample, pressure, batch no"
    assert lines[1] == "2 videos are called a.avi; their folders: mon_a, tue_a"
    assert lines[2].startswith("3 videos to do; ")
    assert lines[3].startswith("damaged: failed: ")
    assert lines[4] == f"droptrack: 1 of 3 videos failed: {folder / 'out' / 'summary.csv'}"
    assert len(lines) == 5
    return folder


def test_each_video_has_the_rows_that_track_gives_it_alone(study: Path, tmp_path: Path) -> None:
    for day, options in (("mon", ["--um-per-px", "0.5"]), ("tue", [])):
        alone = tmp_path / day
        words = ["track", str(study / day / "a.avi"), "--out", str(alone), *options, *FAST]
        assert CliRunner().invoke(app, words).exit_code == 0
        assert rows(study / "out" / f"{day}_a") == rows(alone)
        assert len(read_trajectories(alone / "trajectories.csv")[0]) > 60


def test_the_summary_has_a_row_a_video_with_the_users_columns(study: Path) -> None:
    table = summary(study / "out")
    assert list(table) == ["mon_a", "tue_a", "damaged"]
    one = table["mon_a"]
    assert (one["sample"], one["pressure"], one["batch no"]) == ("oil é", "1.5", "007")
    assert (one["state"], one["n_frames"], one["fps"], one["um_per_px"]) == (
        "done",
        "8",
        "25",
        "0.5",
    )
    found, _ = read_trajectories(study / "out" / "mon_a" / "trajectories.csv")
    diameters = [
        np.nanmean(found.columns["diameter_px"][found.track_id == k])
        for k in np.unique(found.track_id)
    ]
    assert int(one["n_droplets"]) == len(diameters)
    assert float(one["diameter_px"]) == pytest.approx(np.mean(diameters), rel=1e-4)
    assert float(one["diameter_um"]) == pytest.approx(np.mean(diameters) / 2, rel=1e-4)
    spread = np.std(diameters) / np.mean(diameters)
    assert float(one["polydispersity"]) == pytest.approx(spread, rel=1e-3)
    # Eq. D1: all droplets go 5 px a frame in x, and up and down meanwhile
    assert 5 < float(one["speed_px_per_frame"]) < 8
    in_um = float(one["speed_px_per_frame"]) * 0.5 * 25
    assert float(one["speed_um_per_s"]) == pytest.approx(in_um)
    assert table["tue_a"]["diameter_um"] == ""
    failed = table["damaged"]
    assert (failed["state"], failed["n_droplets"]) == ("failed", "")
    assert "damaged.avi" in failed["reason"]
    assert "\n" not in failed["reason"]


def test_all_trajectories_are_one_data_set(study: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    polars = pytest.importorskip("polars")
    folder = study / "out" / "trajectories"
    whole = pandas.read_parquet(folder)
    assert sorted(whole["video"].unique()) == ["mon_a", "tue_a"]
    for name, group in whole.groupby("video", observed=True):
        expected, _ = read_trajectories(study / "out" / name / "trajectories.csv")
        np.testing.assert_array_equal(group["frame"], expected.frame)
        np.testing.assert_array_equal(group["x"], expected.x)
        np.testing.assert_array_equal(group["observed"], expected.observed)
    of_day = whole.set_index("video")
    assert of_day.loc["tue_a", "x_um"].isna().all()
    assert of_day.loc["mon_a", "x_um"].notna().all()
    assert set(of_day.loc["mon_a", "pressure"]) == {1.5}
    assert set(of_day.loc["tue_a", "batch no"]) == {"008"}
    lazy = polars.scan_parquet(folder, hive_partitioning=True)
    counts = dict(lazy.group_by("video").len().collect().iter_rows())
    assert counts == whole["video"].value_counts().to_dict()
    rows_of_summary = pandas.read_parquet(study / "out" / "summary.parquet")
    assert rows_of_summary["n_frames"].tolist()[:2] == [8, 6]


def test_dask_reads_the_data_set_whole(study: Path) -> None:
    dataframe = pytest.importorskip("dask.dataframe")
    whole = dataframe.read_parquet(study / "out" / "trajectories")
    n_rows = [len(read_trajectories(path)[0]) for path in study.glob("out/*/trajectories.csv")]
    assert len(whole) == sum(n_rows)


def test_the_page_shows_what_failed_first_and_links_to_each(study: Path) -> None:
    page = (study / "out" / "index.html").read_text(encoding="utf-8")
    order = [page.index(f">{name}</a></h2>") for name in ("damaged", "mon_a", "tue_a")]
    assert order == sorted(order)
    for link in ("mon_a/trajectories.csv", f"damaged/{LOG}", "tue_a/paths.png"):
        assert f'href="{link}"' in page
        assert (study / "out" / link).is_file()
    assert "oil é" in page


def test_batch_json_says_what_made_the_results(study: Path) -> None:
    about = json.loads((study / "out" / "batch.json").read_text(encoding="utf-8"))
    assert about["versions"]["droptrack"]
    assert about["options"][:4] == ["--size", "480x256", "--backend", "opencv"] or about["options"]
    one = about["videos"][0]
    assert one["video"] == str(study / "mon" / "a.avi")
    assert one["made_from"]["bytes"] == (study / "mon" / "a.avi").stat().st_size
    assert len(one["made_from"]["weights sha256"]) == 64
    assert one["made_from"]["um_per_px"] == 0.5


def test_a_second_run_does_only_what_is_missing_failed_or_changed(
    clips: Clips, tmp_path: Path
) -> None:
    for k, name in enumerate("abc"):
        clips(tmp_path / f"{name}.avi", k, 4)
    table = tmp_path / "list.csv"
    out = tmp_path / "out"

    def run(scores: str, code: int = 0, *words: object) -> str:
        lines = [f"{name}.avi,{score}" for name, score in zip("abcd", scores.split(), strict=False)]
        table.write_text("\n".join(["video,score", *lines]))
        return batch(table, "--out", out, *words, code=code)

    run("0.4 0.4 0.4")
    first = times(out)
    assert set(first) == set("abc")
    assert "3 videos: all are there" in run("0.4 0.4 0.4")
    assert times(out) == first
    dry = CliRunner().invoke(app, ["batch", str(table), "--out", str(out), *FAST, "--dry-run"])
    assert dry.stdout.splitlines()[-1] == "0 of 3 videos would be done"
    run("0.4 0.5 0.4")  # an option
    assert redone(out, first) == {"b"}
    second = times(out)
    os.utime(tmp_path / "a.avi", (1, 1))  # the video
    (out / "c" / "trajectories.csv").unlink()  # results
    said = run("0.4 0.5 0.4 0.4", 1)  # a new video, which is not there
    assert "2 are there" not in said
    assert redone(out, second) == {"a", "c", "d"}
    third = times(out)
    clips(tmp_path / "d.avi", 3, 4)
    assert "1 video to do, 3 are there" in run("0.4 0.5 0.4 0.4")
    assert redone(out, third) == {"d"}
    fourth = times(out)
    run("0.4 0.5 0.4 0.4", 0, "--redo")
    assert redone(out, fourth) == set("abcd")


def test_a_dry_run_says_what_would_be_done_and_writes_nothing(clips: Clips, tmp_path: Path) -> None:
    clips(tmp_path / "a.avi", 0, 2)
    words = ["batch", str(tmp_path), "--out", str(tmp_path / "out"), "--dry-run"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [
        f"a: new: {tmp_path / 'a.avi'}",
        "1 of 1 videos would be done",
    ]
    assert not (tmp_path / "out").exists()


def test_parts_together_do_every_video_once(clips: Clips, tmp_path: Path) -> None:
    for k in range(3):
        clips(tmp_path / f"{k}.avi", k, 2)
    out = tmp_path / "out"
    batch(tmp_path / "*.avi", "--out", out, "--part", "2/2")
    assert set(times(out)) == {"1"}
    first = times(out)
    batch(tmp_path / "*.avi", "--out", out, "--part", "1/2")
    assert redone(out, first) == {"0", "2"}
    assert not (out / "summary.csv").exists()
    assert "all are there" in batch(tmp_path / "*.avi", "--out", out)
    assert list(summary(out)) == ["0", "1", "2"]
    assert parse_part("8/8") == (8, 8)
    for wrong in ("0/2", "3/2", "2", "1/0"):
        with pytest.raises(DroptrackError, match="should be I/N"):
            parse_part(wrong)


def started(*words: object) -> "subprocess.Popen[str]":
    """A batch as a process of its own."""
    command = [sys.executable, "-m", "droptrack.batch", *map(str, words), *FAST]
    return subprocess.Popen(command, cwd=ROOT, text=True, stderr=subprocess.PIPE)


def workers_of(process: "subprocess.Popen[str]") -> list[int]:
    children = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(pid) for path in children for pid in path.read_text().split()]


def wait_for(happened: Callable[[], object], seconds: float = 300) -> None:
    for _ in range(int(seconds / 0.01)):
        if happened():
            return
        time.sleep(0.01)
    raise AssertionError("it did not happen")


def is_longer(path: Path, n_bytes: int) -> bool:
    return path.exists() and path.stat().st_size > n_bytes


needs_proc = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")


@needs_proc
def test_a_killed_worker_costs_nothing_but_time(clips: Clips, tmp_path: Path) -> None:
    """Killed twice in the middle of a video: another one goes on, to the rows of no kill."""
    clips(tmp_path / "a.avi", 0, 40)
    clips(tmp_path / "b.avi", 5, 20)
    batch(tmp_path, "--out", tmp_path / "whole")
    out = tmp_path / "out"
    process = started(tmp_path / "*.avi", "--out", out, "--workers", "1")
    for n_bytes in (6_000, 9_000):
        log = out / "a" / "detections.part"
        wait_for(partial(is_longer, log, n_bytes))
        (worker,) = workers_of(process)
        os.kill(worker, signal.SIGKILL)
    _, said = process.communicate(timeout=600)
    assert process.returncode == 0, said
    assert said.count("was killed by signal 9") == 2
    for name in "ab":
        assert rows(out / name) == rows(tmp_path / "whole" / name)
    assert "resumed after" in (out / "a" / LOG).read_text()


@needs_proc
def test_an_ended_batch_leaves_no_worker_and_goes_on(clips: Clips, tmp_path: Path) -> None:
    clips(tmp_path / "a.avi", 0, 40)
    clips(tmp_path / "b.avi", 5, 5)
    out = tmp_path / "out"
    process = started(tmp_path / "*.avi", "--out", out)
    log = out / "a" / "detections.part"
    wait_for(partial(is_longer, log, 6_000))
    workers = workers_of(process)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=600)
    assert process.returncode == 1
    assert "interrupted after 0 of 2 videos; what was done stays" in said.splitlines()[-1]
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
    assert log.exists()
    assert summary(out)["a"]["reason"] == "was ended before it was done"
    batch(tmp_path / "*.avi", "--out", out)
    assert "resumed after" in (out / "a" / LOG).read_text()
    assert {row["state"] for row in summary(out).values()} == {"done"}


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_rows_are_the_same_on_any_number_of_workers(clips: Clips, tmp_path: Path) -> None:
    for k in range(3):
        clips(tmp_path / f"{k}.avi", 10 * k, 5)
    for n in (1, 2):
        batch(tmp_path / "*.avi", "--out", tmp_path / f"by {n}", "--workers", n)
    for k in range(3):
        assert rows(tmp_path / "by 1" / str(k)) == rows(tmp_path / "by 2" / str(k))


def test_what_is_wrong_is_said_in_one_line_before_anything_is_done(
    clips: Clips, tmp_path: Path
) -> None:
    video, out = clips(tmp_path / "a.avi", 0, 2), tmp_path / "out"
    for words, said in (
        ((tmp_path / "*.mov",), "matches no video"),
        ((video, "--weights", "none.weights"), "none.weights"),
        ((video, "--part", "3"), "should be I/N"),
        ((video, "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"), "give one of them"),
        ((video, "--jobs", "3"), "--jobs is of --slurm and --pbs"),
        ((video, "--nn-budget", "3"), "is of --tracker deepsort"),
        ((video, "--um-per-px", "-1"), "should be above 0"),
        ((video, "--analyse", "sizes"), "'sizes' is none of"),
        ((video, "--plots", "passages"), "--plots passages: should be all, or some of sizes"),
    ):
        lines = batch(*words, "--out", out, code=1).splitlines()
        assert said in lines[-1]
        assert len(lines) == 1
        assert not out.exists()
    assert batch(video, "--out", video, code=1) == (
        f"droptrack: {video}: is a file; --out is a folder for results\n"
    )


@pytest.mark.skipif(not can_mount(), reason="needs leave to mount a file system")
def test_a_disk_that_is_full_in_the_middle_ends_all_and_costs_nothing(
    clips: Clips, tmp_path: Path
) -> None:
    """On a disk of the size that results of two videos of four have."""
    first = clips(tmp_path / "in" / "0.avi", 0, 6)
    for k in range(1, 4):
        os.link(first, tmp_path / "in" / f"{k}.avi")
    words = ["batch", tmp_path / "in", "--workers", "1", *FAST, "--out"]
    disk, whole = tmp_path / "disk", tmp_path / "whole"
    disk.mkdir()
    command = " ".join(map(shlex.quote, map(str, [sys.executable, "-m", "droptrack", *words])))
    subprocess.run(f"{command} {whole}", shell=True, cwd=ROOT, check=True, capture_output=True)
    n_kb = sum(path.stat().st_size for path in whole.glob("[01]/*")) // 1024 + 40
    script = (
        f"mount -t tmpfs -o size={n_kb}k disk {disk} && cd {ROOT}; {command} {disk}/out; "
        f"echo ends with $?; mkdir {tmp_path}/full && cp -r {disk}/out {tmp_path}/full; "
        f"mount -o remount,size=90m {disk}; {command} {disk}/out; echo ends with $?; "
        f"cp -r {disk}/out {tmp_path}/after"
    )
    done = subprocess.run([*AS_ROOT, script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[0] == "ends with 1"
    assert done.stdout.splitlines()[-1] == "ends with 0"
    lines = [line for line in done.stderr.splitlines() if "disk is full" in line]
    assert len(lines) == 1
    assert lines[0].startswith(f"droptrack: {disk}/out: the disk is full after ")
    assert "Traceback" not in done.stderr
    kept = [n for n in range(4) if is_done(tmp_path / "full" / "out" / str(n))]
    assert 0 in kept
    assert len(kept) < 4
    for n in kept:
        assert rows(tmp_path / "full" / "out" / str(n)) == rows(whole / str(n))
    assert f"{4 - len(kept)} video" in done.stderr.split("disk is full")[1]
    for n in range(4):
        assert rows(tmp_path / "after" / str(n)) == rows(whole / str(n))
