"""``droptrack adapt`` from a video to weights, in a few iterations; and what it refuses."""

import hashlib
import json
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

torch = pytest.importorskip("torch", reason="needs the extra [train]")

from bench.random_network import random_weights
from droptrack.__main__ import app
from droptrack.adaptation import training_set
from droptrack.data.darknet_dataset import label_text, read_data_file, read_scenes
from droptrack.network.bundled import FOOTAGE, MODELS, find_network
from droptrack.network.darknet_cfg import read_cfg
from droptrack.network.darknet_weights import read_weights
from droptrack.network.torch_network import DarknetNetwork, dump_values, load_values
from droptrack.training.pytorch import training as torch_training
from droptrack.training.pytorch.devices import computes_faster_in_bf16
from droptrack.training.pytorch.optimisation import gradient_step, make_optimizer
from droptrack.training.pytorch.settings import TorchSettings
from tests.adaptation.drawn import boxes_at, channel_image, write_video

QUICK = (
    *("--scale", "1", "--iterations", "3", "--batch", "2", "--learning-rate", "0.0001"),
    *("--backend", "opencv"),
)


@pytest.fixture(autouse=True)
def few_images(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_set, "N_TRAIN", 20)
    monkeypatch.setattr(training_set, "N_VALID", 1)
    monkeypatch.setattr(training_set, "LABELLED_SHARES", {"labelled": 0.5, "drawn": 0.5})
    monkeypatch.setattr(training_set, "SHARES", {"seen": 0.4, "pasted": 0.3, "drawn": 0.3})


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("video") / "droplets.avi", range(20))


def adapt(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["adapt", *map(str, arguments), *QUICK])
    return result.exit_code, result.output


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def adapted(video: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with an adaptation, and what was said."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_set, "N_TRAIN", 20)
        patch.setattr(training_set, "N_VALID", 1)
        patch.setattr(training_set, "SHARES", {"seen": 0.4, "pasted": 0.3, "drawn": 0.3})
        out = tmp_path_factory.mktemp("adapted") / "out"
        bundled = digest(MODELS[FOOTAGE])
        code, said = adapt(video, "--out", out)
        assert code == 0, said
        assert digest(MODELS[FOOTAGE]) == bundled
    return out, said


def test_a_video_gives_weights_that_can_track_it(adapted: tuple[Path, str], video: Path) -> None:
    """The new network has the video's shape, so that no scale need be said."""
    out, said = adapted
    cfg = read_cfg(out / "adapted.cfg")
    assert (cfg.width, cfg.height) == (320, 160)
    weights = read_weights(out / "adapted.weights", cfg)
    before = read_weights(MODELS[FOOTAGE], find_network(Path(FOOTAGE))[0])
    assert (weights.values != before.values).any()
    assert "long and steady tracks in 16 frames; 4 frames are kept back" in " ".join(said.split())
    tracked = CliRunner().invoke(
        app,
        ["track", str(video), "--weights", str(out / "adapted.weights"), "--out", str(out / "run")],
    )
    assert tracked.exit_code == 0, tracked.output
    summary = json.loads((out / "run/report.json").read_text())["summary"]
    assert summary["n_droplets"] >= 5


def test_the_report_compares_frames_that_were_not_used(adapted: tuple[Path, str]) -> None:
    report = json.loads((adapted[0] / "report.json").read_text())
    rows = {row["measure"]: row for row in report["droplets"]}
    assert rows["n_images"] == {"measure": "n_images", "before": 4, "after": 4}
    expected = np.mean([len(boxes_at(frame)) for frame in range(16, 20)])
    assert rows["droplets_per_image"]["before"] == pytest.approx(expected, abs=1)
    summary = report["summary"]
    assert isinstance(summary["helped"], bool)
    assert summary["learned_by"] == "tracks"
    assert summary["median_diameter_px"] == pytest.approx(44, rel=0.06)
    assert (("it helped" in adapted[1]) or ("it did not help" in adapted[1])) is True


def test_what_was_learned_from_can_be_looked_at(adapted: tuple[Path, str]) -> None:
    sheet = cv2.imread(str(adapted[0] / "contact_sheet.png"))
    assert sheet is not None
    assert sheet.shape[1] == 1600
    assert len(np.unique(sheet)) > 50
    data = read_data_file(adapted[0] / "dataset/obj.data")
    kinds = list(read_scenes(data).values())
    assert [kinds.count(kind) for kind in ("seen", "pasted", "drawn")] == [8 + 1, 6, 6]


def test_another_adaptation_never_takes_its_place(adapted: tuple[Path, str], video: Path) -> None:
    out, _ = adapted
    before = digest(out / "adapted.weights")
    code, said = adapt(video, "--out", out)
    assert code == 1
    assert "is not empty; choose another --out, or resume with --resume" in said
    code, said = adapt(video, "--out", out, "--seed", 5, "--resume")
    assert code == 1
    assert "was begun with other seed" in said
    assert digest(out / "adapted.weights") == before


def test_an_interrupted_adaptation_resumes_to_the_same_weights(
    adapted: tuple[Path, str], video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count(1)

    def interrupted(*arguments: Any) -> Any:
        if next(calls) == 3:
            raise KeyboardInterrupt
        return gradient_step(*arguments)

    monkeypatch.setattr(torch_training, "gradient_step", interrupted)
    code, said = adapt(video, "--out", tmp_path / "out")
    assert code == 1
    assert "--resume resumes from iteration 2" in " ".join(said.split())
    assert not (tmp_path / "out/adapted.weights").exists()
    code, said = adapt(video, "--out", tmp_path / "out", "--resume")
    assert code == 0, said
    cfg = read_cfg(tmp_path / "out/adapted.cfg")
    resumed = read_weights(tmp_path / "out/adapted.weights", cfg).values
    whole = read_weights(adapted[0] / "adapted.weights", cfg).values
    learned = np.abs(whole - read_weights(MODELS[FOOTAGE], find_network(Path(FOOTAGE))[0]).values)
    assert np.abs(resumed - whole).max() < 0.01 * learned.max()


@pytest.mark.parametrize(
    ("frames", "droplets", "message"),
    [
        ([3] * 12, True, "nothing moves in it"),
        (range(12), False, "nothing moves in it"),
        (range(5), True, "has 5 frames; adapt needs 8 or more"),
    ],
)
def test_what_nothing_can_be_learned_from_is_refused_in_one_line(
    frames: list[int], droplets: bool, message: str, tmp_path: Path
) -> None:
    path = write_video(tmp_path / "video.avi", frames, droplets=droplets)
    code, said = adapt(path, "--out", tmp_path / "out")
    assert code == 1
    assert message in said
    assert len([line for line in said.splitlines() if line.startswith("droptrack: ")]) == 1
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_a_video_in_which_no_droplet_is_found_is_refused(tmp_path: Path) -> None:
    """Something moves, but it is no droplet: a bright bar."""
    folder = tmp_path / "images"
    folder.mkdir()
    for t in range(10):
        image = np.full((160, 320), 30, np.uint8)
        image[:, 30 * t : 30 * t + 3] = 60
        cv2.imwrite(str(folder / f"{t:03d}.png"), image)
    code, said = adapt(folder, "--out", tmp_path / "out")
    assert code == 1
    assert "droplets found that can be learned from; try --scale or --diameter" in said
    assert not (tmp_path / "out").exists()


def test_labels_count_most_and_some_judge(video: Path, tmp_path: Path) -> None:
    folder, rng = tmp_path / "labels", np.random.default_rng(8)
    folder.mkdir()
    for t in range(30, 38):
        cv2.imwrite(str(folder / f"{t}.png"), channel_image(t, rng))
        (folder / f"{t}.txt").write_text(label_text(boxes_at(t), 320, 160))
    code, said = adapt(video, "--out", tmp_path / "out", "--labels", folder)
    assert code == 0, said
    n = sum(len(boxes_at(t)) for t in range(30, 38) if (t - 30) % 4)
    assert f"{n} labelled droplets in 6 images count most" in " ".join(said.split())
    report = json.loads((tmp_path / "out/report.json").read_text())
    rows = {row["measure"]: row for row in report["droplets"]}
    assert rows["average_precision_50_percent"]["before"] > 80
    data = read_data_file(tmp_path / "out/dataset/obj.data")
    kinds = [kind for path, kind in read_scenes(data).items() if path in data.train]
    assert kinds.count("labelled") == 10


@pytest.mark.parametrize(
    ("files", "message"),
    [({}, "has no image with a label file"), ({"0.png": "", "0.txt": ""}, "has a droplet")],
)
def test_labels_that_say_nothing_are_refused(
    files: dict[str, str], message: str, video: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "labels"
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
        if name.endswith(".png"):
            cv2.imwrite(str(folder / name), np.zeros((50, 50), np.uint8))
    code, said = adapt(video, "--out", tmp_path / "out", "--labels", folder)
    assert code == 1
    assert message in said


def test_images_of_several_sizes_are_learned_from_without_tracks(tmp_path: Path) -> None:
    rng, folder = np.random.default_rng(9), tmp_path / "images"
    folder.mkdir()
    for t in range(10):
        image = channel_image(7 * t, rng)
        cv2.imwrite(str(folder / f"{t}.png"), image[:, : 320 - 10 * (t % 3)])
    code, said = adapt(folder, "--out", tmp_path / "out")
    assert code == 0, said
    assert "as if they had nothing to do with one another" in " ".join(said.split())
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["summary"]["learned_by"] == "agreement between scales"
    assert report["summary"]["n_images_kept_back"] == 2
    rows = {row["measure"]: row for row in report["droplets"]}
    assert rows["mean_track_frames"]["before"] is None
    assert rows["agreement_percent"]["before"] > 60


@pytest.mark.parametrize("frozen", [False, True])
def test_statistics_stay_where_they_are_to_be_frozen(frozen: bool) -> None:
    small = Path(__file__).parents[1] / "reference/small-yolov3.cfg"
    cfg = read_cfg(small)
    network = DarknetNetwork(cfg)
    load_values(network, random_weights(cfg, np.random.default_rng(1)).values)
    before = dump_values(network)
    settings = TorchSettings(
        iterations=1,
        batch=2,
        subdivisions=1,
        optimizer="adamw",
        learning_rate=0.01,
        window=None,
        sizes=None,
        seed=0,
        workers=0,
        save_every=1,
        map_every=1,
        map_images=1,
        patience=0,
        devices=("cpu",),
        bf16=False,
        frozen_statistics=frozen,
    )
    norms = [one for one in network.modules() if isinstance(one, torch.nn.BatchNorm2d)]
    means = [one.running_mean.clone() for one in norms]
    images = torch.randint(0, 256, (2, 3, cfg.height, cfg.width), dtype=torch.uint8)
    truths = torch.tensor([[0, 0, 0.5, 0.5, 0.2, 0.2], [1, 0, 0.3, 0.3, 0.2, 0.2]])
    gradient_step(
        network, network, make_optimizer(network, cfg, settings), (images, truths), settings
    )
    same = [torch.equal(one.running_mean, mean) for one, mean in zip(norms, means, strict=True)]
    assert same == [frozen] * len(norms)
    assert (dump_values(network) != before).any()


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="asks Linux")
def test_bf16_is_for_processors_that_have_it() -> None:
    if torch.cuda.is_available():
        pytest.skip("a GPU decides")
    flags = Path("/proc/cpuinfo").read_text().split()
    assert computes_faster_in_bf16() is ("avx512_bf16" in flags)
