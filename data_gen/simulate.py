"""Command: videos of moving droplets with their ground truth, ``python -m data_gen.simulate``."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from data_gen.lattice_boltzmann import constriction as constrictions
from data_gen.lattice_boltzmann import shear as shears
from data_gen.lattice_boltzmann.camera import Camera
from data_gen.lattice_boltzmann.recording import Recording, record
from data_gen.lattice_boltzmann.settings import Device
from data_gen.videos.motion_kinds import Kind, Motion
from data_gen.videos.motion_paths import PAIRS
from data_gen.videos.motions import write_motion
from data_gen.videos.sine import SineVideo, write_sine_video
from droptrack.command_line import new_app, one_line_errors

Size = Literal["small", "paper"]
Seed = Annotated[int, typer.Option(min=0, help="Seed; the same one gives the same bytes.")]
Fps = Annotated[int, typer.Option(min=1, help="Frames per second of the video.")]
Scale = Annotated[int, typer.Option(help="Pixels per lattice node, 1 to 16.")]
Blur = Annotated[float, typer.Option(help="Standard deviation of the camera's blur, px.")]
Noise = Annotated[float, typer.Option(help="Standard deviation of its noise, grey levels.")]
Uneven = Annotated[float, typer.Option(help="Share by which the darkest corner is darker, 0..1.")]
ComputedOn = Annotated[Device, typer.Option(help="What computes; auto: a GPU where one works.")]
Threads = Annotated[int, typer.Option(min=0, help="Threads of the CPU; 0: all.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Resume an interrupted run from its checkpoint.")
]
SimulationFolder = Annotated[
    Path, typer.Option(help="Folder for the video, the ground truth and all other files.")
]

app = new_app()


@app.callback()
def main() -> None:
    """Write video.avi and truth.csv of droplets whose paths are known exactly."""


@app.command()
@one_line_errors
def sine(
    out: Annotated[Path, typer.Option(help="Folder for video.avi and truth.csv.")],
    droplets: Annotated[int, typer.Option(min=1, help="Number of droplets.")] = SineVideo.droplets,
    frames: Annotated[int, typer.Option(min=1, help="Number of frames.")] = SineVideo.frames,
    width: Annotated[int, typer.Option(min=32, help="Width of a frame, px.")] = SineVideo.width,
    height: Annotated[int, typer.Option(min=32, help="Height of a frame, px.")] = SineVideo.height,
    radius: Annotated[
        tuple[float, float], typer.Option(help="Minimum and maximum radius, px.")
    ] = SineVideo.radius,
    a: Annotated[float, typer.Option("-A", help="Step in x, px per frame.")] = SineVideo.a,
    b: Annotated[float, typer.Option("-B", help="Maximum step in y, px per frame.")] = SineVideo.b,
    k: Annotated[float, typer.Option("-k", help="Wave number, radians per px.")] = SineVideo.k,
    fps: Fps = SineVideo.fps,
    seed: Seed = SineVideo.seed,
) -> None:
    """Droplets on the predefined paths of the paper's test video (Eq. D1)."""
    video = SineVideo(
        droplets=droplets, frames=frames, width=width, height=height, radius=radius, a=a, b=b, k=k,
        fps=fps, seed=seed,
    )  # fmt: skip
    write_sine_video(out, video)
    typer.echo(
        f"{out / 'video.avi'}: {droplets} droplets, {frames} frames; ground truth in truth.csv"
    )


@app.command()
@one_line_errors
def shear(
    out: SimulationFolder,
    cores: Annotated[int, typer.Option(min=1, max=4, help="Number of cores in the shell.")] = 4,
    size: Annotated[Size, typer.Option(help="Half a turn, or a whole one as in the paper.")] = (
        "small"
    ),
    steps: Annotated[
        int | None, typer.Option(min=1, help="Steps of shear, after the rest; default: by --size.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Steps per frame.")] = 500,
    scale: Scale = Camera.scale,
    blur: Blur = Camera.blur_px,
    noise: Noise = Camera.noise,
    uneven: Uneven = Camera.uneven,
    fps: Fps = 25,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    device: ComputedOn = "auto",
    threads: Threads = 0,
    resume: Resume = False,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a parameter, such as viscosity=1.2; repeat for more."),
    ] = None,
) -> None:
    """Cores in a shell in shear: white cores in a black shell, turning clockwise."""
    params = shears.shear_parameters(cores, change or [])
    recording = Recording(
        first=params.rest_steps,
        last=params.rest_steps + (steps or shears.STEPS[size]),
        every=every,
        fps=fps,
        camera=Camera(scale=scale, blur_px=blur, noise=noise, uneven=uneven, seed=seed),
    )
    summary = record(
        shears.Shear, params, out, recording, device=device, threads=threads, resume=resume,
        say=_warn,
    )  # fmt: skip
    typer.echo(summary)


@app.command()
@one_line_errors
def constriction(
    out: SimulationFolder,
    droplets: Annotated[
        int | None,
        typer.Option(min=1, help="Number of droplets; default: 19 in small, 49 in paper."),
    ] = None,
    size: Annotated[Size, typer.Option(help="About 390 x 205 nodes, or 1,200 x 600.")] = "small",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the droplets' places and noise.")] = 0,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help="Maximum steps, after the rest; default: by --size."),
    ] = None,
    every: Annotated[
        int | None, typer.Option(min=1, help="Steps per frame; default: by --size.")
    ] = None,
    scale: Scale = Camera.scale,
    blur: Blur = Camera.blur_px,
    noise: Noise = Camera.noise,
    uneven: Uneven = Camera.uneven,
    fps: Fps = 25,
    device: ComputedOn = "auto",
    threads: Threads = 0,
    resume: Resume = False,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a parameter, such as sigma=0.04; repeat for more."),
    ] = None,
) -> None:
    """Droplets in a dense emulsion that squeezes through a constriction: white on black."""
    params = constrictions.constriction_parameters(size, droplets, seed, change or [])
    recording = Recording(
        first=params.rest_steps,
        last=params.rest_steps + (steps or constrictions.STEPS[size]),
        every=every or constrictions.EVERY[size],
        fps=fps,
        camera=Camera(scale=scale, blur_px=blur, noise=noise, uneven=uneven, seed=seed),
    )
    summary = record(
        constrictions.Constriction, params, out, recording, device=device, threads=threads,
        resume=resume, say=_warn,
    )  # fmt: skip
    typer.echo(summary)


@app.command()
@one_line_errors
def motions(
    out: Annotated[Path, typer.Option(help="Folder for detections.txt and truth.csv.")],
    kind: Annotated[Kind, typer.Option(help="What the droplets do.")] = Kind.vortices,
    speed: Annotated[float, typer.Option(min=0, help="Maximum, diameters per frame.")] = 0.3,
    droplets: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of droplets in the image; default: 300; 200 if they coalesce or break up.",
        ),
    ] = None,
    diameter: Annotated[float, typer.Option(min=1, help="Diameter of a droplet, px.")] = 20.0,
    frames: Annotated[int, typer.Option(min=1, help="Number of frames.")] = 100,
    missing: Annotated[
        float, typer.Option(min=0, max=1, help="Share of droplets that are not detected.")
    ] = 0.0,
    false: Annotated[
        float, typer.Option(min=0, max=1, help="Share of detections without a droplet.")
    ] = 0.0,
    jitter: Annotated[
        float, typer.Option(min=0, help="Standard deviation of a box, in diameters.")
    ] = 0.0,
    seed: Seed = 0,
) -> None:
    """Detections of droplets that are hard to track, without a video, and their ground truth."""
    droplets = droplets or (200 if kind in PAIRS else 300)  # four an event
    motion = Motion(
        kind, speed=speed, droplets=droplets, diameter=diameter, frames=frames, missing=missing,
        false=false, jitter=jitter,
    )  # fmt: skip
    n = write_motion(out, motion, seed)
    typer.echo(
        f"{out / 'detections.txt'}: {n} droplets, {frames} frames; ground truth in truth.csv"
    )


def _warn(text: str) -> None:
    typer.echo(text, err=True)


if __name__ == "__main__":
    app()
