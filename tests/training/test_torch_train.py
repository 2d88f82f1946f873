"""The PyTorch trainer and its images, against each other and against hand counts."""

import gc
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch", reason="needs the extra [train]")

from bench.random_network import random_weights
from data_gen.scenes.dataset import Recipe, image_source, make_dataset
from droptrack.data.darknet_dataset import DataSet, read_data_file, read_image
from droptrack.errors import DroptrackError
from droptrack.evaluation.network_scores import darknet_detector
from droptrack.network.darknet_cfg import parse_cfg, read_cfg
from droptrack.network.darknet_weights import read_weights, write_weights
from droptrack.network.torch_network import DarknetNetwork, load_values
from droptrack.training.log import read_log
from droptrack.training.pytorch import training as torch_train
from droptrack.training.pytorch.devices import choose_devices
from droptrack.training.pytorch.optimisation import gradient_step, learning_rate
from droptrack.training.pytorch.settings import Job, TorchSettings
from droptrack.training.pytorch.training import train
from droptrack.training.pytorch.validation import validation_detect

SMALL = Path(__file__).parents[1] / "reference/small-yolov3.cfg"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    folder = tmp_path_factory.mktemp("data") / "a"
    for _ in make_dataset(folder, Recipe(scene="a", images=24, valid=8, seed=2), 1):
        pass
    return read_data_file(folder / "obj.data")


def settings(**changes: object) -> TorchSettings:
    options: dict[str, object] = {
        "iterations": 30,
        "batch": 4,
        "subdivisions": 1,
        "optimizer": "adamw",
        "learning_rate": 0.003,
        "window": None,
        "sizes": None,
        "seed": 5,
        "workers": 0,
        "save_every": 10,
        "map_every": 1000,
        "map_images": 4,
        "patience": 0,
        "devices": ("cpu",),
        "bf16": True,
    }
    return TorchSettings(**{**options, **changes})  # type: ignore[arg-type]


def job(data: DataSet, out: Path, how: TorchSettings | None = None, **more: Any) -> Job:
    return Job(cfg=read_cfg(SMALL), data=data, out=out, settings=how or settings(), **more)


def test_training_lowers_the_loss_and_leaves_weights_that_load(
    data: DataSet, tmp_path: Path
) -> None:
    cfg = read_cfg(SMALL)
    steps = list(train(job(data, tmp_path, settings(iterations=60))))
    losses = [step.loss for step in steps]
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:5])
    assert read_weights(tmp_path / "small-yolov3_final.weights", cfg).images_seen == 60 * 4
    rows = (tmp_path / "training.csv").read_text().splitlines()
    assert len(rows) == 61
    assert rows[1].startswith("1,")


def test_an_interrupted_training_resumes_as_if_it_had_not_been(
    data: DataSet, tmp_path: Path
) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    cfg = read_cfg(SMALL)
    whole = list(train(job(data, tmp_path / "whole")))
    training = train(job(data, tmp_path / "cut"))
    for _ in range(12):
        next(training)
    training.close()  # as Ctrl-C does
    rest = list(train(job(data, tmp_path / "cut", resume=True)))
    assert [step.iteration for step in rest] == list(range(13, 31))
    np.testing.assert_allclose([s.loss for s in rest], [s.loss for s in whole[12:]], rtol=1e-3)
    end, other = (
        read_weights(tmp_path / n / "small-yolov3_final.weights", cfg) for n in ("whole", "cut")
    )
    np.testing.assert_allclose(end.values, other.values, rtol=1e-2, atol=1e-3)


def test_an_iteration_that_was_interrupted_is_done_again(
    data: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal comes in the middle of the fifth iteration."""
    calls = count(1)

    def interrupted(*arguments: Any) -> Any:
        if next(calls) == 5:
            raise KeyboardInterrupt
        return gradient_step(*arguments)

    monkeypatch.setattr(torch_train, "gradient_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(train(job(data, tmp_path, settings(iterations=8))))
    list(train(job(data, tmp_path, settings(iterations=8), resume=True)))
    assert [row.iteration for row in read_log(tmp_path / "training.csv")] == list(range(1, 9))


def test_a_job_ended_by_a_cluster_says_how_to_resume(data: DataSet, tmp_path: Path) -> None:
    """SIGTERM for all processes at once, as from a queue whose time is over."""
    out = tmp_path / "run"
    options: dict[str, object] = {
        "--cfg": SMALL,
        "--data": data.train[0].parents[1] / "obj.data",
        "--out": out,
    }
    options |= {"--trainer": "torch", "--workers": 2, "--batch": 4, "--iterations": 100_000}
    command = [sys.executable, "-m", "droptrack.train"]
    command += [str(word) for pair in options.items() for word in pair]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        deadline = time.monotonic() + 120
        while not (out / "training.csv").exists() or len(read_log(out / "training.csv")) < 3:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGTERM)
        said = process.communicate(timeout=60)[1]
    done = read_log(out / "training.csv")[-1].iteration
    assert process.returncode == 1
    assert f"interrupted; --resume resumes from iteration {done}" in " ".join(said.split())
    assert "Traceback" not in said


AFTER_THREADS = """
import sys
from pathlib import Path

import cv2
import numpy as np

from droptrack.data.darknet_dataset import read_data_file
from droptrack.training.pytorch.training import train
from tests.training.test_torch_train import job, settings

if __name__ == "__main__":
    cv2.setNumThreads(4)
    cv2.GaussianBlur(np.zeros((2000, 2000, 3), np.uint8), (0, 0), 9)
    data, out = map(Path, sys.argv[1:])
    how = settings(workers=2, iterations=2)
    print(sum(1 for _ in train(job(read_data_file(data), out, how))), "iterations")
"""


def test_it_trains_in_a_process_that_has_computed_in_threads(data: DataSet, tmp_path: Path) -> None:
    """As where a network was evaluated before: threads hold locks that a fork never gets."""
    script = tmp_path / "script.py"
    script.write_text(AFTER_THREADS)
    said = subprocess.run(
        [sys.executable, script, data.train[0].parents[1] / "obj.data", tmp_path],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True, text=True, check=True, timeout=300,
    ).stdout  # fmt: skip
    assert said == "2 iterations\n"


def test_two_devices_or_two_halves_learn_what_one_does(data: DataSet, tmp_path: Path) -> None:
    """Without batch normalisation, whose statistics are those of what is computed together."""
    text = SMALL.read_text().replace("batch_normalize=1", "batch_normalize=0")
    cfg = parse_cfg(text, SMALL)
    values, losses = [], []
    for n, (devices, subdivisions) in enumerate(((1, 1), (1, 2), (2, 1))):
        out = tmp_path / str(n)
        out.mkdir()
        how = settings(
            iterations=6,
            devices=("cpu",) * devices,
            subdivisions=subdivisions,
            bf16=False,
            optimizer="sgd",
        )
        steps = list(train(replace(job(data, out, how), cfg=cfg)))
        assert len((out / "training.csv").read_text().splitlines()) == 7
        values.append(read_weights(out / "small-yolov3_final.weights", cfg).values)
        losses.append([[step.loss, step.objectness] for step in steps])
    for other in (1, 2):
        np.testing.assert_allclose(values[other], values[0], rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(losses[other], losses[0], rtol=1e-3)


def test_gpus_that_are_not_there_are_named() -> None:
    with pytest.raises(DroptrackError, match=r"--gpus 0,77: PyTorch finds \d+, numbered from 0"):
        choose_devices("0,77", 8, 1)


def test_training_stops_when_the_map_gets_no_better(data: DataSet, tmp_path: Path) -> None:
    """At a rate of nothing the second mAP equals the first."""
    cfg = read_cfg(SMALL)
    idle = settings(learning_rate=0.0, map_every=3, patience=1)
    steps = list(train(job(data, tmp_path, idle)))
    assert steps[-1].iteration == 6
    assert read_weights(tmp_path / "small-yolov3_final.weights", cfg).images_seen == 6 * 4


def test_images_are_drawn_anew_and_the_same_after_a_resume(data: DataSet, tmp_path: Path) -> None:
    drawn: list[NDArray[np.float64]] = []
    source = image_source("tiny")

    def draw(rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        image, boxes = source(rng)
        assert image.shape == (600, 1200, 3)
        drawn.append(boxes)
        return image, boxes

    training = train(job(data, tmp_path, draw=draw))
    for _ in range(4):
        next(training)
    training.close()
    assert len(drawn) == 4 * 4
    assert len({boxes.tobytes() for boxes in drawn}) == 16
    list(train(job(data, tmp_path, settings(iterations=6), resume=True, draw=draw)))
    assert len({boxes.tobytes() for boxes in drawn}) == 24  # none of the first 16 again
    with pytest.raises(DroptrackError, match="no scene nought; there are a, b"):
        image_source("nought")


@pytest.mark.parametrize("bf16", [False, True])
def test_the_map_is_measured_in_the_precision_of_the_training(
    bf16: bool, data: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = []

    def measure(*_: object, bf16: bool) -> float:
        measured.append(bf16)
        return 0.5

    monkeypatch.setattr(torch_train, "mean_average_precision", measure)
    how = settings(iterations=4, map_every=2, bf16=bf16)
    list(train(job(data, tmp_path, how)))
    assert measured == [bf16, bf16]


def test_validation_in_fp32_finds_what_opencv_finds(data: DataSet, tmp_path: Path) -> None:
    """The scores of the same weights; in bf16 they are a little off."""
    cfg, weights = read_cfg(SMALL), tmp_path / "random.weights"
    write_weights(weights, random_weights(cfg, np.random.default_rng(8)))
    network = DarknetNetwork(cfg)
    load_values(network, read_weights(weights, cfg).values)
    image = read_image(data.valid[0])
    (expected,) = darknet_detector(cfg, weights).detect([image])
    exact, rough = (validation_detect(network, bf16=bf16)(image) for bf16 in (False, True))
    assert len(exact) == len(expected) > 20
    np.testing.assert_allclose(exact.scores, expected.scores, atol=1e-4)
    best, other = expected.scores[:10], rough.scores[:10]
    assert 1e-4 < np.abs(other - best).max() < 0.1


def test_training_holds_on_to_no_tensors(data: DataSet, tmp_path: Path) -> None:
    counts = []
    for step in train(job(data, tmp_path, settings(iterations=25))):
        if step.iteration in (5, 25):
            gc.collect()
            counts.append(sum(issubclass(type(item), torch.Tensor) for item in gc.get_objects()))
    assert counts[0] == counts[1] > 10


def test_a_loss_that_diverges_stops_the_training(data: DataSet, tmp_path: Path) -> None:
    wild = settings(optimizer="sgd", learning_rate=1e12)
    with pytest.raises(DroptrackError, match="NaN or infinite at iteration"):
        list(train(job(data, tmp_path, wild)))


def test_a_label_of_a_class_that_is_not_there_is_named(data: DataSet, tmp_path: Path) -> None:
    image = tmp_path / "0.jpg"
    image.write_bytes(data.train[0].read_bytes())
    image.with_suffix(".txt").write_text("1 0.5 0.5 0.1 0.1\n")
    wrong = replace(data, train=(image,))
    with pytest.raises(DroptrackError, match=r"0\.txt: has class 1, but the data set 1 classes"):
        list(train(job(wrong, tmp_path)))


def test_darknets_rate_burns_in_with_the_fourth_power_and_falls_in_steps() -> None:
    cfg, sgd = read_cfg(SMALL), settings(optimizer="sgd", learning_rate=0.01)
    rates = {n: learning_rate(n, cfg, sgd) for n in (1, 5, 10, 100, 101, 151)}
    expected = {1: 1e-6, 5: 0.01 / 16, 10: 0.01, 100: 0.01, 101: 0.001, 151: 0.0005}
    assert rates == pytest.approx(expected)
