"""Studies on Dask clusters: workers that come, go, and are of another version."""

import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from droptrack.errors import DroptrackError
from droptrack.studies import dask_workers
from droptrack.studies.choice import WorkersConfig
from droptrack.studies.dask_workers import job_cluster
from droptrack.studies.jobs import LOG
from tests.studies.test_batch import (
    Clips,
    batch,
    is_longer,
    needs_proc,
    rows,
    started,
    wait_for,
)

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")  # Dask's own, of sockets and loops


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers, in processes of their own."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        yield cluster


def test_a_cluster_gives_the_rows_of_this_machine(
    cluster: Any, clips: Clips, tmp_path: Path
) -> None:
    for k in range(3):
        clips(tmp_path / f"{k}.avi", 10 * k, 6)
    (tmp_path / "broken.avi").write_bytes(bytes(100))
    batch(tmp_path / "*.avi", "--out", tmp_path / "here", code=1)
    address = cluster.scheduler_address
    said = batch(
        tmp_path / "*.avi", "--out", tmp_path / "there", "--scheduler", address, code=1
    ).splitlines()
    assert said[0].startswith("Dask's dashboard: http")
    assert said[1] == f"4 videos to do; the Dask cluster at {address}"
    assert any(line.startswith("broken: failed: ") for line in said)
    assert "1 of 4 videos failed" in said[-1]
    for k in range(3):
        assert rows(tmp_path / "there" / str(k)) == rows(tmp_path / "here" / str(k))


@needs_proc
def test_the_video_of_a_dead_worker_is_done_by_another(clips: Clips, tmp_path: Path) -> None:
    clips(tmp_path / "a.avi", 0, 40)
    batch(tmp_path / "a.avi", "--out", tmp_path / "whole")
    out = tmp_path / "out"
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        process = started(
            tmp_path / "a.avi", "--out", out, "--scheduler", cluster.scheduler_address
        )
        log = out / "a" / "detections.part"
        wait_for(partial(is_longer, log, 5_000))
        (worker,) = cluster.workers.values()
        os.kill(worker.pid, signal.SIGKILL)  # its nanny starts another one
        _, said = process.communicate(timeout=600)
    assert process.returncode == 0, said
    assert rows(out / "a") == rows(tmp_path / "whole" / "a")
    assert "resumed after" in (out / "a" / LOG).read_text()


def test_a_scheduler_that_nobody_reaches_is_said_in_one_line(
    clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_workers, "CONNECT_S", 1)
    video = clips(tmp_path / "a.avi", 0, 2)
    words = (video, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1")
    lines = batch(*words, code=1).splitlines()
    assert len(lines) == 1
    assert "--scheduler tcp://127.0.0.1:1: cannot be reached" in lines[0]


def test_workers_of_another_version_are_refused(
    cluster: Any, clips: Clips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_workers, "__version__", "99.0")
    video = clips(tmp_path / "a.avi", 0, 2)
    words = (video, "--out", tmp_path / "out", "--scheduler", cluster.scheduler_address)
    lines = batch(*words, code=1).splitlines()
    assert len(lines) == 1
    assert "this is 99.0: install one version everywhere" in lines[0]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("slurm", ("#SBATCH --cpus-per-task=8", "#SBATCH -p fast", "#SBATCH -t 02:00:00")),
        ("pbs", ("ncpus=8", "#PBS -q fast", "walltime=02:00:00")),
    ],
)
def test_jobs_ask_for_what_the_options_say(
    kind: Any, expected: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("dask_jobqueue")
    monkeypatch.setattr(dask_workers, "SUBMITS", dict.fromkeys(("slurm", "pbs"), "sh"))
    config = WorkersConfig(
        cluster=kind, job_cores=8, job_memory="6GB", walltime="02:00:00", queue="fast"
    )
    cluster = job_cluster(config)
    try:
        script = cluster.job_script()
    finally:
        cluster.close()
    for line in expected:
        assert line in script
    assert "--nthreads 1" in script
    assert "OMP_NUM_THREADS=8" in script


@pytest.fixture
def submit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Puts a command `sbatch` before all others: what it does, in the shell's language."""
    pytest.importorskip("dask_jobqueue")
    folder = tmp_path / "bin"
    folder.mkdir()

    def put(does: str) -> None:
        for name, text in (("sbatch", does), ("scancel", "kill $1")):
            (folder / name).write_text(f"#!/bin/sh\n{text}\n")
            (folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    return put


JOBS = ("--slurm", "--jobs", 1, "--job-cores", 1, "--job-memory", "2GB")


@needs_proc
def test_jobs_of_slurm_do_a_study(
    submit: Callable[[str], None], clips: Clips, tmp_path: Path
) -> None:
    """With a SLURM whose jobs are processes of this machine."""
    job = tmp_path / "job.sh"  # Dask deletes its own
    submit(f'cp "$1" {job}\nsh {job} >/dev/null 2>&1 & echo "Submitted batch job $!"')
    for k in range(2):
        clips(tmp_path / f"{k}.avi", 10 * k, 4)
    batch(tmp_path / "*.avi", "--out", tmp_path / "here")
    batch(tmp_path / "*.avi", "--out", tmp_path / "there", *JOBS)
    for k in range(2):
        assert rows(tmp_path / "there" / str(k)) == rows(tmp_path / "here" / str(k))


def test_a_job_that_is_refused_is_said_in_one_line(
    submit: Callable[[str], None], clips: Clips, tmp_path: Path
) -> None:
    submit("echo 'sbatch: error: invalid partition specified: fast' >&2; exit 1")
    video = clips(tmp_path / "a.avi", 0, 2)
    lines = batch(video, "--out", tmp_path / "out", *JOBS, "--queue", "fast", code=1).splitlines()
    assert lines[-1] == (
        "droptrack: --slurm: no job could be submitted: sbatch: error: invalid partition "
        "specified: fast; what was done stays"
    )
    told = ("Dask's dashboard: ", "1 video to do; ", "no worker is there: waiting")
    assert all(line.startswith(told) for line in lines[:-1])


def test_a_machine_without_slurm_is_said_in_one_line(clips: Clips, tmp_path: Path) -> None:
    video = clips(tmp_path / "a.avi", 0, 2)
    lines = batch(video, "--out", tmp_path / "out", *JOBS, code=1).splitlines()
    assert lines == [
        "droptrack: --slurm: there is no sbatch here: run it where jobs can be submitted"
    ]


def test_only_one_way_to_compute_is_taken() -> None:
    with pytest.raises(DroptrackError, match="give one of them"):
        WorkersConfig(n=2, cluster="slurm")
