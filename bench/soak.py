"""What must be survived: damaged files, random bytes, runs that are killed. ``make soak``.

Prints, of each case, how often it was tried, how often survived, and what was lost.
"""

import faulthandler
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
import numpy as np
import tifffile
import typer

from bench.soak_kills import killables, killed
from bench.soak_videos import KINDS, damage, write_numbers, wrong_frame
from droptrack.data.darknet_dataset import read_data_file, read_labels
from droptrack.data.mot_files import open_detections
from droptrack.data.trajectories import read_trajectories
from droptrack.data.video import Video, VideoInfo, VideoWriter
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import parse_cfg, read_cfg
from droptrack.network.darknet_weights import read_weights

app = typer.Typer(add_completion=False)
MAX_S = 20.0  # of one reading: more is a hang
MAX_GB = 6  # of memory: more is taken for unbounded
CFG = Path(__file__).parents[1] / "darknet_cfg" / "yolov3-tiny.cfg"
SMALL_CFG = """[net]
width=32
height=32
[convolutional]
filters=6
size=1
stride=1
activation=linear
[yolo]
mask=0
anchors=8,8
classes=1
num=1
"""


@dataclass
class Case:
    """How often something was tried and survived, and what was lost."""

    name: str
    tried: int = 0
    survived: int = 0
    lost: str = ""

    def count(self, problem: str | None) -> None:
        """Count one attempt; `problem` is None where it was survived."""
        self.tried += 1
        if problem is None:
            self.survived += 1
        elif not self.lost:
            self.lost = problem


def damaged_videos(rng: np.random.Generator, n: int) -> Case:
    """Frames that show their number: each that is read should have its own."""
    case = Case("damaged videos")
    with TemporaryDirectory() as folder:
        for i in range(n):
            name, fourcc, alone = KINDS[i % len(KINDS)]
            path = Path(folder) / name
            write_numbers(path, fourcc)
            damage(path, rng)
            problem = wrong_frame(path, alone=alone)
            case.count(problem and f"{name} {fourcc}, number {i}: {problem}")
    return case


def readers(folder: Path) -> dict[str, tuple[Path, Callable[[Path], object]]]:
    """A good file of each kind, and what reads it."""
    small = parse_cfg(SMALL_CFG, Path("small.cfg"))
    values = np.arange(24, dtype="<f4").tobytes()
    files: dict[str, tuple[bytes, Callable[[Path], object]]] = {
        "n.cfg": (CFG.read_bytes(), read_cfg),
        "n.weights": (
            bytes([0, 0, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0]) + bytes(8) + values,
            lambda path: read_weights(path, small),
        ),
        "a.txt": (b"0 0.5 0.5 0.1 0.1\n0 0.25 0.5 0.125 0.1\n", read_labels),
        "obj.data": (b"classes = 1\ntrain = list.txt\nnames = obj.names\n", read_data_file),
        "rows.csv": (
            b"# made by: x\nframe,track_id,x,y,w,h,score,observed\n0,1,1.5,2.5,3,4,0.9,1\n",
            read_trajectories,
        ),
        "det.txt": (b"1,-1,10,20,30,40,0.9\n2,-1,11,20,30,40,0.9\n", _all_detections),
    }
    (folder / "list.txt").write_text("a.jpg\n")
    (folder / "obj.names").write_text("droplet\n")
    stack = np.arange(3 * 20 * 30, dtype=np.uint16).reshape(3, 20, 30)
    tifffile.imwrite(folder / "plain.tif", stack, photometric="minisblack")
    tifffile.imwrite(folder / "imagej.tif", stack, imagej=True)
    tifffile.imwrite(folder / "z.ome.tif", stack, ome=True, compression="zlib")
    tifffile.imwrite(folder / "zip.tif", stack, compression="zlib", photometric="minisblack")
    cv2.imwrite(str(folder / "image.png"), stack[0])
    cv2.imwrite(str(folder / "image.jpg"), stack[0].astype(np.uint8))
    write_numbers(folder / "v.avi", "MJPG")
    write_numbers(folder / "v.mp4", "mp4v")
    (folder / "v.mraw").write_bytes(stack.tobytes())
    (folder / "v.cih").write_text(
        "Total Frame : 3\nImage Width : 30\nImage Height : 20\nColor Bit : 16\n"
    )
    (folder / "v.cine").write_bytes(cine(stack))
    for name, (content, _) in files.items():
        (folder / name).write_bytes(content)
    names = (
        *("plain.tif", "zip.tif", "imagej.tif", "z.ome.tif", "image.png", "image.jpg"),
        *("v.avi", "v.mp4", "v.cine", "v.cih"),
    )
    return {
        **{name: (folder / name, read) for name, (_, read) in files.items()},
        **{name: (folder / name, _all_frames) for name in names},
    }


def cine(stack: np.ndarray) -> bytes:
    """A small file of a Phantom camera."""
    setup = bytearray(1000)
    setup[142:144] = (1000).to_bytes(2, "little")
    info = b"".join(
        n.to_bytes(size, "little")
        for n, size in ((40, 4), (30, 4), (20, 4), (1, 2), (16, 2), (0, 4), (1200, 4))
    )
    info += bytes(40 - len(info))
    table = 44 + 40 + len(setup)
    head = b"CI" + b"".join(
        n.to_bytes(size, "little")
        for n, size in ((44, 2), (0, 2), (1, 2), (0, 4), (3, 4), (0, 4), (3, 4), (44, 4), (84, 4))
    )
    head += table.to_bytes(4, "little") + bytes(8)
    starts = [table + 24 + i * 1208 for i in range(3)]
    offsets = b"".join(start.to_bytes(8, "little") for start in starts)
    blocks = b"".join(
        b"\x08\0\0\0" + (1200).to_bytes(4, "little") + image[::-1].astype("<u2").tobytes()
        for image in stack
    )
    return head + info + bytes(setup) + offsets + blocks


def _all_detections(path: Path) -> int:
    return sum(len(found) for found, _ in open_detections(path))


def _all_frames(path: Path) -> int:
    return sum(1 for _ in Video(str(path)))


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with bytes changed, cut, doubled, or with an absurd number in it."""
    new = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        place = int(rng.integers(len(new) + 1))
        kind = rng.integers(6)
        if kind == 0 and new:
            new[min(place, len(new) - 1)] = int(rng.integers(256))
        elif kind == 1:
            del new[place : place + int(rng.integers(1, 40))]
        elif kind == 2:
            new[place:place] = new[place : place + int(rng.integers(1, 200))]
        elif kind == 3:
            new[place:place] = rng.choice([b"9" * 19, b"-1", b"nan", b"1e300", b"\xff" * 8, b"\0"])
        elif kind == 4:
            new[place : place + 4] = rng.bytes(4)
        else:
            new[place : place + 8] = rng.choice([b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\0" * 8])
    return bytes(new)


def fuzz(
    name: str, path: Path, read: Callable[[Path], object], rng: np.random.Generator, seconds: float
) -> Case:
    """Only DroptrackError may come of any bytes, soon and in bounded memory."""
    case = Case(f"random bytes: {name}")
    good = path.read_bytes()
    read(path)
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        bad = mutated(good, rng)
        path.write_bytes(bad)
        began, problem = time.perf_counter(), None
        try:
            read(path)
        except DroptrackError:
            pass
        except Exception as error:  # noqa: BLE001  that is what is looked for
            problem = f"{type(error).__name__}: {error}"
        if time.perf_counter() - began > MAX_S:
            problem = f"took {time.perf_counter() - began:.0f} s"
        if problem is not None and not case.lost:
            kept = Path(f"soak-{name}")
            kept.write_bytes(bad)
            problem += f" (kept in {kept})"
        case.count(problem)
    path.write_bytes(good)
    return case


def killed_runs(rng: np.random.Generator, n: int, n_frames: int) -> Case:
    """A run that is killed again and again, and resumed: its rows are those of a whole run."""
    case = Case("kill -9 and --resume")
    with TemporaryDirectory() as name:
        folder = Path(name)
        _droplets(folder / "v.avi", n_frames)
        command = [sys.executable, "-m", "droptrack", "track", str(folder / "v.avi"), "--no-video"]
        command += ["--size", "320x160", "--backend", "opencv", "--out"]
        subprocess.run([*command, str(folder / "whole")], check=True, capture_output=True)
        log = folder / "killed" / "detections.part"
        for _ in range(n):
            process = subprocess.Popen(
                [*command, str(folder / "killed"), "--resume"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            wanted = (log.stat().st_size if log.exists() else 0) + int(rng.integers(1, 9000))
            while process.poll() is None and not (log.exists() and log.stat().st_size > wanted):
                time.sleep(0.01)
            ended = process.poll() is not None
            process.send_signal(signal.SIGKILL)
            process.wait()
            case.count("ended before it was killed" if ended and not case.lost else None)
            if ended:
                break
        done = subprocess.run(
            [*command, str(folder / "killed"), "--resume"], check=False, capture_output=True
        )
        rows = [(folder / one / "trajectories.csv").read_text() for one in ("whole", "killed")]
        if rows[0] != rows[1]:
            case.lost = f"rows differ; {done.stderr.decode()}"
            case.survived = 0
    return case


def killed_commands(rng: np.random.Generator, n: int) -> list[Case]:
    """The commands that go on, or begin anew: each is killed, and ends with the same result."""
    cases = []
    with TemporaryDirectory() as folder:
        for one in killables(Path(folder)):
            cases.append(Case(f"kill -9 of {one.name}"))
            (Path(folder) / one.name).mkdir()
            for problem in killed(one, Path(folder) / one.name, rng, n):
                cases[-1].count(problem)
    return cases


def _droplets(path: Path, n_frames: int) -> None:
    """Five discs that move on."""
    with VideoWriter(path, VideoInfo(320, 160, 25, n_frames), "MJPG") as video:
        for t in range(n_frames):
            image = np.zeros((160, 320, 3), np.uint8)
            for i in range(5):
                x = int(30 + 60 * i + 20 * np.sin(t / 30 + i))
                cv2.circle(image, (x, 80), 16, (255, 255, 255), -1, cv2.LINE_AA)
            video.write(image)


@app.command()
def main(
    seed: Annotated[int, typer.Option(help="Of everything that is at random.")] = 0,
    videos: Annotated[int, typer.Option(help="Damaged videos.")] = 200,
    seconds: Annotated[float, typer.Option(help="Of random bytes for each reader.")] = 40,
    kills: Annotated[int, typer.Option(help="Times that a run of track is killed.")] = 50,
    frames: Annotated[int, typer.Option(help="Of the run that is killed.")] = 2000,
    others: Annotated[int, typer.Option(help="Times that each other command is killed.")] = 10,
) -> None:
    """Damage files, feed readers with random bytes, kill runs; print what was lost."""
    faulthandler.enable()
    _limit_memory()
    rng = np.random.default_rng(seed)
    cases = []
    if videos:
        cases.append(damaged_videos(rng, videos))
    with TemporaryDirectory() as folder:
        for name, (path, read) in readers(Path(folder)).items() if seconds else ():
            cases.append(fuzz(name, path, read, rng, seconds))
    if kills:
        cases.append(killed_runs(rng, kills, frames))
    cases += killed_commands(rng, others) if others else []
    typer.echo(f"{'case':28} {'tried':>8} {'survived':>8}  lost")
    for case in cases:
        typer.echo(f"{case.name:28} {case.tried:8} {case.survived:8}  {case.lost or 'nothing'}")
    raise typer.Exit(any(case.survived < case.tried for case in cases))


def _limit_memory() -> None:
    """Let more than MAX_GB fail; where the system has such limits."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (MAX_GB << 30, MAX_GB << 30))


if __name__ == "__main__":
    app()
