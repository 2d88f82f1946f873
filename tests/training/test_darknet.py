"""The wrapper around Darknet, driving a fake one that replays what real ones printed."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.scenes.dataset import Recipe, make_dataset
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import convolutions, read_cfg
from droptrack.network.darknet_weights import WEIGHTS_VERSION, Weights, read_weights, write_weights
from droptrack.train import app
from droptrack.training.darknet.binary import find_darknet, furthest_weights, identify
from droptrack.training.darknet.console import (
    Console,
    Event,
    Iteration,
    MeanAp,
    NextMap,
    Question,
    Saving,
)
from droptrack.training.log import Step, TrainingLog, read_log

RECORDS = Path(__file__).parents[1] / "reference"
FORKS = ["alexeyab", "hank_ai"]
CFG = RECORDS / "mini.cfg"
# read off the records by eye
MEAN_APS = {
    "alexeyab": {100: 0.363668, 200: 0.686799, 300: 0.685801, 310: 0.667309},
    "hank_ai": {100: 0.3162, 200: 0.6580, 300: 0.6405, 310: 0.6522},
}
LOSSES = {"alexeyab": {1: 273.446, 310: 9.2102}, "hank_ai": {1: 332.961, 310: 8.816}}


def events(record: str, size: int) -> list[Event]:
    """The events of a record that comes in chunks of some bytes."""
    data, console = (RECORDS / f"darknet_{record}.log").read_bytes(), Console()
    chunks = [data[i : i + size] for i in range(0, len(data), size)]
    return [event for chunk in chunks for event in console.feed(chunk)]


@pytest.mark.parametrize("fork", FORKS)
def test_a_console_is_understood_however_it_is_cut(fork: str) -> None:
    whole = events(fork, 1_000_000)
    assert events(fork, 7) == whole
    steps = {e.iteration: e for e in whole if isinstance(e, Iteration)}
    assert {n: steps[n].loss for n in LOSSES[fork]} == pytest.approx(LOSSES[fork], rel=1e-5)
    assert steps[100].images == 800
    assert steps[100].learning_rate == 0.001
    found = [e.value for e in whole if isinstance(e, MeanAp)]
    assert found == pytest.approx(list(MEAN_APS[fork].values()))
    announced = {e.iteration for e in whole if isinstance(e, NextMap)}
    announced |= {e.next_map for e in steps.values() if e.next_map}
    assert announced == {100, 200, 300, 400}
    saved = [Path(e.path).name for e in whole if isinstance(e, Saving)]
    assert saved[-1] == "mini_final.weights"
    assert saved.count("mini_last.weights") == 3
    assert sum(isinstance(e, Question) for e in whole) == (fork == "hank_ai")


def test_garbage_is_no_event() -> None:
    console = Console()
    assert (
        console.feed(b"12: 3.x4, nan, \xff\n 7: loss=, avg loss=1, mAP=1, rate=1, 3 images\n") == []
    )
    assert console.feed(b"mean average precision (mAP@0.50) = -.-\n" + b"x" * 100_000) == []
    assert console.feed(b"\n 8: nan, -nan avg loss, 0.1 rate, 0.2 seconds, 64 images\n") != []


class FakeDarknet:
    """A program that replays a record; `trouble` is what goes wrong."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.path, self.template = folder / "darknet", folder / "template.weights"
        script = Path(__file__).parent / "fake_darknet.py"
        self.path.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
        self.path.chmod(0o755)
        cfg = read_cfg(CFG)
        values = np.random.default_rng(1).normal(
            0, 0.05, sum(c.n_values for c in convolutions(cfg))
        )
        write_weights(self.template, Weights(WEIGHTS_VERSION, 0, np.abs(values).astype(np.float32)))
        self._monkeypatch = monkeypatch

    def will(self, record: str, trouble: str = "") -> None:
        """Replay a record."""
        parts = [str(RECORDS / f"darknet_{record}.log"), str(self.template), "8", trouble]
        self._monkeypatch.setenv("FAKE_DARKNET", os.pathsep.join(parts))


@pytest.fixture
def darknet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeDarknet:
    monkeypatch.delenv("DARKNET", raising=False)
    return FakeDarknet(tmp_path, monkeypatch)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("a folder") / "data"
    for _ in make_dataset(folder, Recipe(scene="a", images=16, valid=4, seed=2), 1):
        pass
    return folder / "obj.data"


# a suite that runs in the background, where shells ignore Ctrl-C, must not hand that down
WITH_CTRL_C = """
import runpy, signal
signal.signal(signal.SIGINT, signal.default_int_handler)
runpy.run_module("droptrack.train", run_name="__main__")
"""


def arguments(darknet: FakeDarknet, data: Path, out: Path, *more: str) -> list[str]:
    paths = ["--cfg", str(CFG), "--data", str(data), "--out", str(out)]
    return [*paths, "--darknet", str(darknet.path), *more]


def train(darknet: FakeDarknet, data: Path, out: Path, *more: str) -> tuple[int, str]:
    """Exit code and output of the command."""
    result = CliRunner().invoke(app, arguments(darknet, data, out, *more))
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def mean_aps(steps: list[Step]) -> dict[int, float]:
    return {step.iteration: step.mean_ap for step in steps if not math.isnan(step.mean_ap)}


@pytest.mark.parametrize("fork", FORKS)
def test_a_training_is_driven_to_its_end(
    fork: str, darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will(fork)
    out = tmp_path / "a run"
    code, output = train(darknet, data, out)
    assert code == 0, output
    steps = read_log(out / "training.csv")
    assert [s.iteration for s in steps if s.iteration > 308] == [309, 310]
    assert mean_aps(steps) == pytest.approx(MEAN_APS[fork], abs=1e-5)
    assert f"best mAP@0.50 {max(MEAN_APS[fork].values()):.4f}" in output
    (entry,) = json.loads((out / "run.json").read_text())
    assert {"alexeyab": "AlexeyAB", "hank_ai": "v5.1-104"}[fork] in entry["trainer"]
    final = read_weights(out / "mini_final.weights", read_cfg(out / "mini.cfg"))
    assert final.images_seen == 310 * 8
    assert len((out / "train.txt").read_text().splitlines()) == 16
    assert (out / "training.png").stat().st_size > 10_000
    assert b"Detection layer" in (out / "darknet.log").read_bytes()
    assert train(darknet, data, out)[1].endswith("--resume\n")  # never overwritten


@pytest.mark.parametrize("fork", FORKS)
def test_a_darknet_that_dies_is_resumed_from_its_last_snapshot(
    fork: str, darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    darknet.will(fork, "killed")
    assert "run: does not exist; start without --resume" in train(darknet, data, out, "--resume")[1]
    code, output = train(darknet, data, out)
    assert code == 1
    assert "ended with code 1 after iteration 201 of 310; its last words: 'CUDA Error" in output
    assert "--resume resumes from iteration 200" in output
    darknet.will(fork)
    assert train(darknet, data, out, "--resume")[0] == 0
    steps = read_log(out / "training.csv")
    numbers = [step.iteration for step in steps]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] == 310
    assert mean_aps(steps) == pytest.approx(MEAN_APS[fork], abs=1e-5)
    assert "is at iteration 310 already" in train(darknet, data, out, "--resume")[1]


def test_a_torn_snapshot_is_not_resumed_from(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("hank_ai", "torn")
    code, output = train(darknet, data, tmp_path / "run")
    assert code == 1
    assert "there is no snapshot to resume from" in output
    assert "has no complete snapshot" in train(darknet, data, tmp_path / "run", "--resume")[1]
    assert furthest_weights(tmp_path / "run", read_cfg(CFG)) is None


@pytest.mark.parametrize("fork", FORKS)
def test_death_at_the_first_map_is_met_by_scoring_the_snapshots_here(
    fork: str, darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will(fork, "map")
    out = tmp_path / "run"
    code, output = train(darknet, data, out, "--map-every", "50", "--map-images", "2")
    assert code == 0, output
    steps = read_log(out / "training.csv")
    assert [step.iteration for step in steps][-1] == 310
    assert 310 in mean_aps(steps)
    assert set(mean_aps(steps)) <= {100, 200, 300, 310}
    commands = [
        line for line in (out / "darknet.log").read_text().splitlines() if line.startswith("# [")
    ]
    assert ["-map" in command for command in commands] == [True, False]
    assert (out / "mini_best.weights").exists()
    assert not (out / "mini_scored.weights").exists()


def test_death_at_the_last_map_is_met_so_too(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("hank_ai", "last map")  # AlexeyAB's writes the final weights before it
    code, output = train(darknet, data, tmp_path / "run", "--map-every", "50", "--map-images", "2")
    assert code == 0, output
    assert 310 in mean_aps(read_log(tmp_path / "run" / "training.csv"))
    assert (tmp_path / "run" / "mini_final.weights").exists()


def test_death_after_the_end_is_none(darknet: FakeDarknet, data: Path, tmp_path: Path) -> None:
    darknet.will("alexeyab", "end")
    assert train(darknet, data, tmp_path / "run")[0] == 0


def test_a_loss_that_diverges_stops_darknet_and_is_placed(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("alexeyab_nan", "slow")
    code, output = train(darknet, data, tmp_path / "run")
    assert code == 1
    assert "NaN or infinite at iteration 25, at a rate of 0.003" in output
    assert read_log(tmp_path / "run" / "training.csv")[-1].iteration == 25


def test_a_darknet_that_prints_nothing_is_stopped(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("alexeyab", "hang")
    began = time.monotonic()
    code, output = train(darknet, data, tmp_path / "run", "--hang-minutes", "0.02")
    assert code == 1
    assert "has printed nothing for 1 s" in output
    assert "--resume resumes from iteration 200" in output
    assert time.monotonic() - began < 30


def test_an_unanswered_question_is_a_hang_and_garbage_does_no_harm(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("hank_ai", "garbage")
    assert train(darknet, data, tmp_path / "run")[0] == 0
    assert mean_aps(read_log(tmp_path / "run" / "training.csv")) == pytest.approx(
        MEAN_APS["hank_ai"]
    )


def test_training_stops_when_the_map_gets_no_better(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    """The best is at 200; 300 is the first without a new one."""
    darknet.will("hank_ai", "slow")
    assert train(darknet, data, tmp_path / "run", "--patience", "1")[0] == 0
    assert read_log(tmp_path / "run" / "training.csv")[-1].iteration == 300


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_stops_darknet_and_leaves_a_run_to_resume(
    number: signal.Signals, darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("alexeyab", "hang")
    out = tmp_path / "run"
    command = [sys.executable, "-c", WITH_CTRL_C, *arguments(darknet, data, out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            steps = read_log(out / "training.csv")
            if steps and steps[-1].iteration == 201:
                break
            time.sleep(0.05)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "interrupted; --resume resumes from iteration 200" in errors
    with pytest.raises(ProcessLookupError):
        os.kill(int((out / "pid").read_text()), 0)
    darknet.will("alexeyab")
    assert train(darknet, data, out, "--resume")[0] == 0


def test_weights_given_begin_at_iteration_one(
    darknet: FakeDarknet, data: Path, tmp_path: Path
) -> None:
    darknet.will("hank_ai")
    given = tmp_path / "given.weights"
    whole = read_weights(darknet.template, read_cfg(CFG))
    write_weights(given, Weights(WEIGHTS_VERSION, 9999, whole.values))
    assert train(darknet, data, tmp_path / "run", "--weights", str(given))[0] == 0
    assert read_log(tmp_path / "run" / "training.csv")[0].iteration == 1


def test_the_binary_is_the_one_given_then_that_of_the_environment_then_of_the_path(
    darknet: FakeDarknet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "bin" / "darknet"
    other.parent.mkdir()
    other.write_text("#!/bin/sh\necho hello\n")
    other.chmod(0o755)
    monkeypatch.setenv("PATH", "/nowhere")
    assert find_darknet(None) is None
    monkeypatch.setenv("PATH", str(other.parent))
    assert find_darknet(None) == other
    monkeypatch.setenv("DARKNET", str(darknet.path))
    assert find_darknet(None) == darknet.path
    assert find_darknet(other) == other
    with pytest.raises(DroptrackError, match=r"--darknet .*missing: is no program"):
        find_darknet(tmp_path / "missing")
    with pytest.raises(DroptrackError, match="is no Darknet: `version` answers 'hello"):
        identify(other)
    other.write_text("#!/bin/sh\necho 'CUDA status Error: file: ./src/cuda.c : () : line: 59'\n")
    with pytest.raises(DroptrackError, match="is built for a GPU and finds none that works: 'CUDA"):
        identify(other)


def step_of(n: int, mean_ap: float) -> Step:
    return Step(
        iteration=n,
        loss=n,
        average_loss=n,
        regression=0,
        objectness=0,
        classes=0,
        rewritten=0,
        learning_rate=0.1,
        seconds=0.1,
        images=n,
        mean_ap=mean_ap,
    )


def test_the_log_of_a_run_that_goes_back_is_cut(tmp_path: Path) -> None:
    with TrainingLog(tmp_path, 0) as log:
        for n in range(1, 6):
            log.append(step_of(n, mean_ap=0.1 * n if n in (2, 4) else math.nan))
        log.set_mean_ap(5, 0.3)
        assert log.is_stale(1)
        assert not log.is_stale(2)
    with TrainingLog(tmp_path, 3) as log:
        assert log.mean_aps == [0.2]
        assert log.average_loss == 3
    assert [s.iteration for s in read_log(tmp_path / "training.csv")] == [1, 2, 3]
