"""Command: track the droplets of many videos, ``python -m droptrack.batch``."""

import copy
import functools
import inspect
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from droptrack.command_line import new_app, one_line_errors, refuse_given
from droptrack.data.sources.opencv_names import printable
from droptrack.errors import DroptrackError
from droptrack.pipeline.config import TrackingConfig
from droptrack.studies.at_address import place_of
from droptrack.studies.choice import WorkersConfig
from droptrack.studies.options import VideoOptions
from droptrack.studies.run import Planned, Study, do_study, parse_part, plan
from droptrack.track import configured

if TYPE_CHECKING:  # it takes longer to import than all else here
    from droptrack.analysis.choice import Asked

app = new_app()
# options of `droptrack track` that are of live videos, of boxes, or that a batch decides
NOT_OF_VIDEOS = (
    *("video", "detections", "frames", "descriptors", "live", "reconnect"),
    *("out", "overwrite", "resume"),
)
PANEL = "Of each video, as droptrack track has them"
AnalyseOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME [OPTION...]",
        help="Analyse the trajectories, as droptrack analyse does: size,motion or all, or one with "
        "options, such as 'flow --line 90,0,90,400'; repeat for more.",
    ),
]


def _with_options_of_track(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of ``droptrack track`` in place of its `**of_videos`."""
    parameters = list(inspect.signature(command, eval_str=True).parameters.values())
    for one in inspect.signature(configured, eval_str=True).parameters.values():
        if one.name in NOT_OF_VIDEOS or one.annotation is typer.Context:
            continue
        kind, option = get_args(one.annotation)
        option = copy.copy(option)
        option.rich_help_panel = PANEL
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters.insert(-1, one.replace(annotation=Annotated[kind, option], kind=keyword))
    del parameters[-1]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    return command


@app.command()
@one_line_errors
@_with_options_of_track
def main(
    context: typer.Context,
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="PATTERN|FOLDER|LIST.csv...",
            help="Videos and folders of images, patterns of them in quotes, folders of them, or "
            "lists with a column 'video', options of single videos, and columns of your own.",
        ),
    ],
    out: Annotated[
        str,
        typer.Option(
            metavar="FOLDER",
            help="For the results: a folder a video, and tables; or an address such as "
            "s3://bucket/study.",
        ),
    ],
    redo: Annotated[bool, typer.Option("--redo", help="Do again what was done already.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only tell what would be done, and why.")
    ] = False,
    workers: Annotated[
        int, typer.Option(min=0, help="Videos at a time on this machine; 0: as many as suit it.")
    ] = 0,
    part: Annotated[
        str | None,
        typer.Option(metavar="I/N", help="Only every Nth video, from the Ith on: for job arrays."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Use the workers of a Dask cluster."),
    ] = None,
    slurm: Annotated[bool, typer.Option("--slurm", help="Start workers as jobs of SLURM.")] = False,
    pbs: Annotated[bool, typer.Option("--pbs", help="Start workers as jobs of PBS.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Jobs of SLURM or PBS, a worker each.")] = 4,
    job_cores: Annotated[int, typer.Option(min=1, help="Cores of a job.")] = 4,
    job_memory: Annotated[str, typer.Option(help="Memory of a job.")] = "4GB",
    walltime: Annotated[
        str, typer.Option(metavar="HH:MM:SS", help="Time of a job; videos outlive it.")
    ] = "04:00:00",
    queue: Annotated[str | None, typer.Option(help="Queue, or partition, of the jobs.")] = None,
    analyse: AnalyseOption = None,
    **of_videos: Any,
) -> None:
    """Track many videos: a folder a video, summary.csv, trajectories/ and index.html.

    Run again, it does what is missing, failed, or has changed.
    """
    say = functools.partial(typer.echo, err=True)
    options = options_of_videos()
    place = place_of(out)
    asked = Study(sources=tuple(sources), place=place, options=options.given(context))
    hands = WorkersConfig(
        n=workers,
        scheduler=scheduler,
        cluster=_cluster(slurm=slurm, pbs=pbs),
        jobs=jobs,
        job_cores=job_cores,
        job_memory=job_memory,
        walltime=walltime,
        queue=queue,
    )
    if hands.cluster is None:
        of_jobs = ("jobs", "job_cores", "job_memory", "walltime", "queue")
        refuse_given(context, of_jobs, "is of --slurm and --pbs")
    share = None if part is None else parse_part(part)
    planned = plan(asked, options, say, redo=redo)
    if share is not None:
        planned = planned.part(*share)
    if dry_run:
        _print(planned)
        return
    n_failed = do_study(asked, planned, options, hands, say, whole=share is None)
    if n_failed:
        raise DroptrackError(
            f"{n_failed} of {len(planned.jobs)} videos failed: {place}/summary.csv"
        )
    typer.echo(f"results in {place}")


def options_of_videos() -> VideoOptions:
    """The options of ``droptrack track`` that each video of a study may have."""
    return VideoOptions(_of_videos(), _configured, _asked_for, NOT_OF_VIDEOS)


@functools.cache
def _of_videos() -> Any:
    """A command with all options that a video may have; only its options count."""
    of_analyses = new_app()

    @of_analyses.command()
    def command(analyse: AnalyseOption = None) -> None:
        pass

    both: Any = copy.copy(_of_track())
    both.params = [*both.params, *typer.main.get_command(of_analyses).params]
    return both


def _asked_for(texts: Sequence[str]) -> "tuple[Asked, ...]":
    """The analyses that are asked for, for any folder to work in; raises DroptrackError."""
    from droptrack.analyse import asked_for
    from droptrack.analysis.structure.report import StructureConfig

    asked = []
    for one in asked_for(texts):
        config = one.config
        if isinstance(config, StructureConfig):
            region = config.region
            if region and os.path.isfile(region):  # noqa: PTH113  any text may come
                config = replace(config, region=os.path.abspath(region))  # noqa: PTH100
        asked.append(replace(one, config=config))
    return tuple(asked)


@functools.cache
def _of_track() -> Any:
    """The command ``droptrack track`` with all its options, to parse those of a video."""
    parser = new_app()
    parser.command()(configured)
    return typer.main.get_command(parser)


def _configured(words: list[str]) -> TrackingConfig:
    """What a command line of ``droptrack track`` asks for; raises DroptrackError."""
    command = _of_track()
    try:
        with command.make_context("track", words) as context:
            config = command.invoke(context)
    except typer.BadParameter as error:
        raise DroptrackError(" ".join(error.format_message().split())) from None
    assert isinstance(config, TrackingConfig)
    return config


def _cluster(*, slurm: bool, pbs: bool) -> Literal["slurm", "pbs"] | None:
    if slurm and pbs:
        raise DroptrackError("give --slurm or --pbs, not both")
    return "slurm" if slurm else "pbs" if pbs else None


def _print(planned: Planned) -> None:
    """Tell what would be done, and why."""
    for job, reason in zip(planned.jobs, planned.reasons, strict=True):
        typer.echo(f"{printable(job.name)}: {reason or 'is there'}: {printable(job.video)}")
    typer.echo(f"{len(planned.to_do)} of {len(planned.jobs)} videos would be done")


if __name__ == "__main__":
    app()
