"""Many videos: ``python -m bench.batch``, or one of its commands.

Times are those of whole commands, as a user waits for them, and are compared within one run.
"""

import csv
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.console import Console

from bench.drawn import write_video
from droptrack.command_line import new_app, one_line_errors
from droptrack.studies.jobs import read_kept

app = new_app()
console = Console()
ROOT = Path(__file__).parents[1]
FOLDER = "a folder for videos and results; default: a temporary one"


@contextmanager
def _folder() -> Iterator[Path]:
    with TemporaryDirectory(prefix="droptrack-bench-") as name:
        yield Path(name)


def _command(*words: object) -> list[str]:
    return [sys.executable, "-m", "droptrack", *map(str, words)]


def _seconds(*words: object) -> float:
    """How long a command takes; raises CalledProcessError where it fails."""
    return _run(*words)[0]


def _run(*words: object) -> tuple[float, float]:
    """How long a command takes, and its processor time, s."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(_command(*words), cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        console.print(done.stderr, markup=False)
    done.check_returncode()
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, used


def _print_load() -> None:
    """How busy the machine is; what is measured on a busy one is the processor time."""
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    console.print(f"{cores} cores, load of the last minute {load:.1f}")


def _copies(video: Path, folder: Path, n: int) -> Path:
    """Many names of one video."""
    folder.mkdir()
    for k in range(n):
        os.link(video, folder / f"{k:04d}.avi")
    return folder


def _workers_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for path in children for child in path.read_text().split()]


def _mb(pid: int) -> float:
    """Memory that a process has now, MB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return 0.0


@app.command()
@one_line_errors
def throughput(
    videos: Annotated[int, typer.Option(min=1, help="Short videos.")] = 64,
    frames: Annotated[int, typer.Option(min=2, help="Frames of each.")] = 150,
    workers: Annotated[str, typer.Option(help="Numbers of workers, 0: the default.")] = "1,2",
    repeats: Annotated[int, typer.Option(min=1, help="Of everything, in turn.")] = 1,
) -> None:
    """Many short videos against the same frames in one long video through ``droptrack track``."""
    with _folder() as folder:
        write_video(folder / "short.avi", frames)
        write_video(folder / "long.avi", frames * videos)
        shorts = _copies(folder / "short.avi", folder / "shorts", videos)
        total = frames * videos
        for _ in range(repeats):
            long_s, long_used = _run("track", folder / "long.avi", "--out", folder / "long")
            console.print(f"one video of {total} frames: {total / long_s:.1f} frames/s")
            for n in workers.split(","):
                out = folder / f"by {n}"
                short_s, used = _run("batch", shorts, "--out", out, "--workers", n)
                console.print(
                    f"{videos} videos of {frames} frames, --workers {n}: "
                    f"{total / short_s:.1f} frames/s, {long_s / short_s:.3f} of that; by "
                    f"processor time {long_used / used:.3f}"
                )
                shutil.rmtree(out)
            shutil.rmtree(folder / "long")


@app.command()
@one_line_errors
def listing(
    videos: Annotated[int, typer.Option(min=1, help="Videos in the list.")] = 500,
) -> None:
    """Seconds to list and check many videos: new ones, and those that are done."""
    with _folder() as folder:
        write_video(folder / "short.avi", 2)
        shorts = _copies(folder / "short.avi", folder / "shorts", videos)
        lines = [f"{path},{k % 7 + 1},{k}" for k, path in enumerate(sorted(shorts.iterdir()))]
        table = folder / "list.csv"
        table.write_text("\n".join(["video,um_per_px,sample", *lines]))
        out = folder / "out"
        new_s = _seconds("batch", table, "--out", out, "--dry-run")
        _seconds("batch", table, "--out", out, "--no-video")
        done_s = _seconds("batch", table, "--out", out, "--dry-run")
        again_s = _seconds("batch", table, "--out", out, "--no-video")
    console.print(f"{videos} new videos listed and checked in {new_s:.1f} s")
    console.print(f"{videos} videos that are done listed and checked in {done_s:.1f} s")
    console.print(f"a second batch of these, with tables and page: {again_s:.1f} s")


@app.command()
@one_line_errors
def kills(
    videos: Annotated[int, typer.Option(min=1, help="Videos.")] = 64,
    frames: Annotated[int, typer.Option(min=2, help="Frames of each.")] = 150,
    every: Annotated[float, typer.Option(min=1, help="Seconds between two kills.")] = 20.0,
    workers: Annotated[int, typer.Option(min=0, help="Workers, 0: the default.")] = 2,
    seed: Annotated[int, typer.Option(help="Of which worker is killed.")] = 0,
) -> None:
    """Kill a worker at random now and then; compare rows with those of an undisturbed run."""
    choice = random.Random(seed)
    with _folder() as folder:
        for k in range(min(videos, 4)):
            write_video(folder / f"short {k}.avi", frames + k)
        shorts = folder / "shorts"
        shorts.mkdir()
        for k in range(videos):
            os.link(folder / f"short {k % 4}.avi", shorts / f"{k:04d}.avi")
        options = ("--no-video", "--workers", workers)
        undisturbed_s = _seconds("batch", shorts, "--out", folder / "whole", *options)
        command = _command("batch", shorts, "--out", folder / "killed", *options)
        began, n_kills = time.perf_counter(), 0
        with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as batch:
            while batch.poll() is None:
                try:
                    batch.wait(every)
                except subprocess.TimeoutExpired:
                    if alive := _workers_of(batch.pid):
                        os.kill(choice.choice(alive), signal.SIGKILL)
                        n_kills += 1
        killed_s = time.perf_counter() - began
        same = _same_rows(folder / "whole", folder / "killed")
        reasons = _reasons(folder / "killed")
    console.print(
        f"{n_kills} kills: exit {batch.returncode}, {len(same)} of {videos} videos complete, rows "
        f"of {sum(same)} identical; {killed_s:.0f} s, undisturbed {undisturbed_s:.0f} s"
    )
    for reason in reasons:
        console.print(reason, markup=False)


def _reasons(study: Path) -> list[str]:
    """Why videos of a study are not done."""
    with (study / "summary.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [f"{row['name']}: {row['reason']}" for row in rows if row["state"] != "done"]


def _same_rows(expected: Path, found: Path) -> Sequence[bool]:
    """Of each video that is done, whether its rows are those expected."""
    return [
        (expected / path.parent.name / path.name).read_bytes() == path.read_bytes()
        for path in sorted(found.glob("*/trajectories.csv"))
        if (kept := read_kept(path.parent)) is not None and kept.state == "done"
    ]


@app.command()
@one_line_errors
def memory(
    videos: Annotated[int, typer.Option(min=4, help="Videos.")] = 500,
    frames: Annotated[int, typer.Option(min=2, help="Frames of each.")] = 10,
) -> None:
    """Memory of the worker and of the batch itself, from one video to the next."""
    with _folder() as folder:
        write_video(folder / "short.avi", frames)
        shorts = _copies(folder / "short.avi", folder / "shorts", videos)
        command = _command("batch", shorts, "--out", folder / "out", "--workers", 1)
        seen: dict[int, tuple[float, float]] = {}
        with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as batch:
            while batch.poll() is None:
                n_done = sum(1 for _ in folder.glob("out/*/report.json"))
                if n_done and n_done not in seen and (workers := _workers_of(batch.pid)):
                    try:
                        seen[n_done] = _mb(workers[0]), _mb(batch.pid)
                    except OSError:  # it has just ended
                        continue
                time.sleep(0.1)
    for n_done in [min(seen, key=lambda n, at=at: abs(n - at)) for at in _steps(videos)]:  # type: ignore[misc]
        worker, parent = seen[n_done]
        console.print(f"after {n_done} videos: worker {worker:.0f} MB, batch {parent:.0f} MB")


def _steps(n: int) -> list[int]:
    return [n // 10, n // 4, n // 2, 3 * n // 4, n]


@app.command()
@one_line_errors
def start(repeats: Annotated[int, typer.Option(min=1, help="Measurements.")] = 7) -> None:
    """Seconds of ``droptrack track`` on a video of two frames; the first fills the caches."""
    with _folder() as folder:
        if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):  # users have what Python compiled
            os.environ["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
        write_video(folder / "two.avi", 2)
        track = ("track", folder / "two.avi", "--out", folder / "out", "--overwrite")
        for words in (track, ("track", "--help"), ("--help",)):
            (first, _), *others = [_run(*words) for _ in range(repeats + 1)]
            seconds, used = (sorted(one) for one in zip(*others, strict=True))
            console.print(
                f"start of {'two frames' if words is track else ' '.join(map(str, words))}: "
                f"{median(seconds):.2f} s (fastest {seconds[0]:.2f} s), processor time "
                f"{median(used):.2f} s; the first one, which fills the caches, {first:.2f} s"
            )


@app.callback(invoke_without_command=True)
def main(context: typer.Context) -> None:
    """Without a command: throughput, listing, kills, memory and start."""
    _print_load()
    if context.invoked_subcommand is None:
        start()
        listing()
        throughput()
        kills()
        memory()


if __name__ == "__main__":
    app()
