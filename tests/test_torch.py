"""The PyTorch network, loss and training, against OpenCV, a loop over cells, and each other."""

import gc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch", reason="needs the extra [train]")

from bench.random_network import random_weights  # noqa: E402
from data_gen.make_dataset import Recipe, make_dataset, picture_source  # noqa: E402
from droptrack import DroptrackError  # noqa: E402
from droptrack.darknet_files import (  # noqa: E402
    Cfg,
    cfg_text,
    parse_cfg,
    read_cfg,
    read_weights,
    with_options,
    write_weights,
    yolo_heads,
)
from droptrack.dataset import DataSet, read_data_file  # noqa: E402
from droptrack.detections import iou_matrix  # noqa: E402
from droptrack.detector import decode_head  # noqa: E402
from droptrack.torch_data import Augmentation, Batches, augment  # noqa: E402
from droptrack.torch_devices import choose_devices  # noqa: E402
from droptrack.torch_loss import yolo_loss  # noqa: E402
from droptrack.torch_network import DarknetNetwork, dump_values, load_values  # noqa: E402
from droptrack.torch_train import (  # noqa: E402
    Job,
    Settings,
    darknet_loss,
    learning_rate,
    train,
)
from droptrack.validation import darknet_detector  # noqa: E402

CFG_FOLDER = Path(__file__).parent.parent / "darknet_cfg"

TINY_TINY = """
[net]
width=96
height=64
channels=3
momentum=0.9
decay=0.0005
learning_rate=0.01
burn_in=10
steps=100,150
scales=.1,.5
[convolutional]
batch_normalize=1
filters=8
size=3
stride=2
pad=1
activation=leaky
[maxpool]
size=2
stride=2
[convolutional]
batch_normalize=1
filters=16
size=3
stride=2
pad=1
activation=leaky
[convolutional]
filters=18
size=1
activation=linear
[yolo]
mask=0,1,2
anchors=6,6, 10,10, 16,16, 40,40
classes=1
num=4
jitter=0
ignore_thresh=.5
"""


@pytest.mark.parametrize(
    ("name", "size"),
    [("yolov3-tiny", (416, 416)), ("yolov3-tiny-droplets", (416, 224)), ("yolov3", (160, 96))],
)
def test_outputs_are_those_of_opencv(name: str, size: tuple[int, int], tmp_path: Path) -> None:
    """Every layer kind of the paper's networks, with the same weights and picture in both."""
    options = {"width": str(size[0]), "height": str(size[1])}
    cfg = with_options(read_cfg(CFG_FOLDER / f"{name}.cfg"), options, {"thresh": "0.000001"})
    rng = np.random.default_rng(1)
    weights = random_weights(cfg, rng)
    path = tmp_path / "random.weights"
    write_weights(path, weights)
    theirs = cv2.dnn.readNetFromDarknet(
        np.frombuffer(cfg_text(cfg).encode(), np.uint8), np.frombuffer(path.read_bytes(), np.uint8)
    )
    picture = rng.random((1, 3, size[1], size[0]), np.float32)
    theirs.setInput(picture)
    outputs = theirs.forward(theirs.getUnconnectedOutLayersNames())

    network = DarknetNetwork(cfg)
    load_values(network, weights.values)
    network.eval()
    with torch.no_grad():
        maps = network(torch.from_numpy(picture))
    for raw, head, expected in zip(maps, network.heads, outputs, strict=True):
        rows = decode_head(raw[0].numpy(), head, 1e-6)
        sure = np.asarray(expected)[np.asarray(expected)[:, 4] > 1e-6]
        # OpenCV counts cell by cell, then anchor by anchor
        order = np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))
        other = np.lexsort((sure[:, 2], sure[:, 1], sure[:, 0]))
        assert len(rows) == len(sure) >= 45
        np.testing.assert_allclose(rows[order, :5], sure[other, :5], rtol=2e-3, atol=1e-4)


def test_a_score_is_objectness_times_class_probability(tmp_path: Path) -> None:
    """Through OpenCV, against the network's own maps."""
    cfg = read_cfg(Path(__file__).parent / "data" / "mini.cfg")
    rng = np.random.default_rng(8)
    weights, path = random_weights(cfg, rng), tmp_path / "random.weights"
    write_weights(path, weights)
    picture = rng.integers(0, 256, (cfg.height, cfg.width, 3), np.uint8)
    (found,) = darknet_detector(cfg, path).detect([picture])

    network = DarknetNetwork(cfg)
    load_values(network, weights.values)
    network.eval()
    inputs = torch.from_numpy(picture[..., ::-1].copy()).permute(2, 0, 1)[None] / 255
    with torch.no_grad():
        (raw,) = network(inputs)
    chances = raw[0].sigmoid()
    scores = (chances[:, 4] * chances[:, 5]).numpy().ravel()
    assert len(found) > 20
    nearest = np.abs(found.scores[:, None] - scores[None]).min(axis=1)
    assert nearest.max() < 1e-4
    assert found.scores.max() == pytest.approx(scores.max(), abs=1e-4)


def test_weights_loaded_and_dumped_are_the_same_bytes(tmp_path: Path) -> None:
    cfg = read_cfg(CFG_FOLDER / "yolov3-tiny.cfg")
    values = random_weights(cfg, np.random.default_rng(2)).values
    network = DarknetNetwork(cfg)
    load_values(network, values)
    assert dump_values(network).tobytes() == values.tobytes()
    with pytest.raises(ValueError, match="values, not"):
        load_values(network, np.append(values, np.float32(1)))


def darknet_deltas(
    cfg: Cfg, raw: NDArray[np.float64], truths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What Darknet adds to its layer's delta: one loop a prediction and one a truth, one image.

    raw: logits (A, 5 + C, rows, columns); truths (T, 5): class, box relative to the image.
    """
    (head,) = yolo_heads(cfg)
    truth_thresh = cfg.layers[head.layer].number("truth_thresh", 1)
    n, _, rows, columns = raw.shape
    width, height = columns * head.stride, rows * head.stride
    sigmoid = 1 / (1 + np.exp(-raw))
    delta = np.zeros_like(raw)

    def answer(a: int, j: int, i: int, truth: NDArray[np.float64]) -> None:
        class_id, x, y, w, h = truth
        scale = 0.75 * (2 - w * h)
        delta[a, 0, j, i] += scale * (x * columns - i - sigmoid[a, 0, j, i])
        delta[a, 1, j, i] += scale * (y * rows - j - sigmoid[a, 1, j, i])
        delta[a, 2, j, i] += scale * (np.log(w * width / head.anchors[a, 0]) - raw[a, 2, j, i])
        delta[a, 3, j, i] += scale * (np.log(h * height / head.anchors[a, 1]) - raw[a, 3, j, i])
        delta[a, 4, j, i] = 1 - sigmoid[a, 4, j, i]
        delta[a, 5 + int(class_id), j, i] = 1 - sigmoid[a, 5 + int(class_id), j, i]

    for a in range(n):
        for j in range(rows):
            for i in range(columns):
                box = [
                    (i + sigmoid[a, 0, j, i]) / columns,
                    (j + sigmoid[a, 1, j, i]) / rows,
                    np.exp(raw[a, 2, j, i]) * head.anchors[a, 0] / width,
                    np.exp(raw[a, 3, j, i]) * head.anchors[a, 1] / height,
                ]
                overlaps = iou_matrix(np.array([box]), truths[:, 1:])[0]
                delta[a, 4, j, i] = -sigmoid[a, 4, j, i]
                if overlaps.max() > 0.5 and sigmoid[a, 5, j, i] > 0.25:
                    delta[a, 4, j, i] = 0
                if overlaps.max() > truth_thresh:
                    answer(a, j, i, truths[overlaps.argmax()])
    for truth in truths:
        shapes = np.hstack(
            [np.zeros((len(head.all_anchors), 2)), head.all_anchors / [width, height]]
        )
        anchor = int(iou_matrix(np.array([[0, 0, *truth[3:]]]), shapes).argmax())
        if anchor in head.mask:
            answer(head.mask.index(anchor), int(truth[2] * rows), int(truth[1] * columns), truth)
    return delta


@pytest.mark.parametrize("truth_thresh", ["1", "0.55"])
def test_gradient_of_the_loss_is_what_darknet_writes_down(truth_thresh: str) -> None:
    text = TINY_TINY + f"truth_thresh={truth_thresh}\n"
    cfg = parse_cfg(text, Path("tiny.cfg"))
    rng = np.random.default_rng(3)
    raw = rng.normal(0, 1.5, (2, 3, 6, 8, 12))
    truths = [
        np.array(
            [[0, 0.31, 0.42, 0.11, 0.17], [0, 0.32, 0.43, 0.12, 0.17], [0, 0.8, 0.2, 0.5, 0.7]]
        ),
        np.array([[0, 0.11, 0.92, 0.06, 0.1]]),
    ]
    for image in range(2):  # some predictions right on a truth, so that they are ignored
        raw[image, 1, 2:4, 4:6, 3:6] = 0.1
    batch = np.concatenate([np.column_stack([np.full(len(t), i), t]) for i, t in enumerate(truths)])
    maps = torch.tensor(raw, dtype=torch.float64, requires_grad=True)
    loss = yolo_loss(cfg, [maps], torch.tensor(batch))
    loss.total.backward()  # type: ignore[no-untyped-call]
    expected = np.stack([darknet_deltas(cfg, raw[i], truths[i]) for i in range(2)])
    answering = (expected[:, :, 4] > 0).sum()
    assert answering == 2 if truth_thresh == "1" else answering > 2
    assert (expected[:, :, 4] == 0).any() or truth_thresh != "1"
    np.testing.assert_allclose(-2 * maps.grad.numpy(), expected, atol=2e-5)  # a mean over 2 images
    # the first two truths share a cell and anchor
    assert loss.n_rewritten == 1 or truth_thresh != "1"
    assert float(darknet_loss([maps])) == pytest.approx((expected**2).sum() / 2, rel=1e-5)


def test_a_perfect_answer_costs_next_to_nothing() -> None:
    cfg = parse_cfg(TINY_TINY, Path("tiny.cfg"))
    raw = torch.zeros(1, 3, 6, 8, 12)
    raw[:, :, 4] = -12
    raw[0, 1, :, 4, 6] = torch.tensor([0.0, 0, 0, 0, 12, 12])  # cell centre, anchor 10 x 10
    truth = torch.tensor([[0, 0, 6.5 / 12, 4.5 / 8, 10 / 96, 10 / 64]])
    loss = yolo_loss(cfg, [raw], truth)
    assert float(loss.objectness + loss.classes) < 0.01
    assert float(loss.regression) == pytest.approx(
        2 * np.log(2) * 0.75 * (2 - 100 / 6144), rel=1e-5
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    folder = tmp_path_factory.mktemp("data") / "a"
    for _ in make_dataset(folder, Recipe("a", 24, 8, seed=2), 1):
        pass
    return read_data_file(folder / "obj.data")


def settings(**changes: object) -> Settings:
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
    return Settings(**{**options, **changes})  # type: ignore[arg-type]


def test_training_lowers_the_loss_and_leaves_weights_that_load(
    data: DataSet, tmp_path: Path
) -> None:
    cfg = parse_cfg(TINY_TINY, tmp_path / "tt.cfg")
    steps = list(train(Job(cfg, data, tmp_path, settings(iterations=60))))
    losses = [step.loss for step in steps]
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:5])
    assert read_weights(tmp_path / "tt_final.weights", cfg).seen == 60 * 4
    rows = (tmp_path / "training.csv").read_text().splitlines()
    assert len(rows) == 61
    assert rows[1].startswith("1,")


def test_an_interrupted_training_goes_on_as_if_it_had_not_been(
    data: DataSet, tmp_path: Path
) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    cfg = parse_cfg(TINY_TINY, Path("tt.cfg"))
    whole = list(train(Job(cfg, data, tmp_path / "whole", settings())))
    training = train(Job(cfg, data, tmp_path / "cut", settings()))
    for _ in range(12):
        next(training)
    training.close()  # as Ctrl-C does
    rest = list(train(Job(cfg, data, tmp_path / "cut", settings(), resume=True)))
    assert [step.iteration for step in rest] == list(range(13, 31))
    np.testing.assert_allclose([s.loss for s in rest], [s.loss for s in whole[12:]], rtol=1e-3)
    end, other = (read_weights(tmp_path / n / "tt_final.weights", cfg) for n in ("whole", "cut"))
    np.testing.assert_allclose(end.values, other.values, rtol=1e-2, atol=1e-3)


def test_two_devices_or_two_halves_learn_what_one_does(data: DataSet, tmp_path: Path) -> None:
    """Without batch normalisation, whose statistics are those of what is computed together."""
    text = TINY_TINY.replace("batch_normalize=1", "batch_normalize=0")
    cfg = parse_cfg(text, Path("tt.cfg"))
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
        steps = list(train(Job(cfg, data, out, how)))
        assert len((out / "training.csv").read_text().splitlines()) == 7
        values.append(read_weights(out / "tt_final.weights", cfg).values)
        losses.append([[step.loss, step.objectness] for step in steps])
    for other in (1, 2):
        np.testing.assert_allclose(values[other], values[0], rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(losses[other], losses[0], rtol=1e-3)


def test_gpus_that_are_not_there_are_named() -> None:
    with pytest.raises(DroptrackError, match=r"--gpus 0,77: PyTorch finds \d+, numbered from 0"):
        choose_devices("0,77", 8, 1)


def test_training_stops_when_the_map_gets_no_better(data: DataSet, tmp_path: Path) -> None:
    """At a rate of nothing the second mAP equals the first."""
    cfg = parse_cfg(TINY_TINY, Path("tt.cfg"))
    idle = settings(learning_rate=0.0, map_every=3, patience=1)
    steps = list(train(Job(cfg, data, tmp_path, idle)))
    assert steps[-1].iteration == 6
    assert read_weights(tmp_path / "tt_final.weights", cfg).seen == 6 * 4


def test_pictures_are_drawn_afresh_and_the_same_after_a_resume(
    data: DataSet, tmp_path: Path
) -> None:
    cfg = parse_cfg(TINY_TINY, Path("tt.cfg"))
    drawn: list[NDArray[np.float64]] = []
    source = picture_source("tiny")

    def draw(rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        image, boxes = source(rng)
        assert image.shape == (600, 1200, 3)
        drawn.append(boxes)
        return image, boxes

    training = train(Job(cfg, data, tmp_path, settings(), draw=draw))
    for _ in range(4):
        next(training)
    training.close()
    assert len(drawn) == 4 * 4
    assert len({boxes.tobytes() for boxes in drawn}) == 16
    list(train(Job(cfg, data, tmp_path, settings(iterations=6), resume=True, draw=draw)))
    assert len({boxes.tobytes() for boxes in drawn}) == 24  # none of the first 16 again
    with pytest.raises(DroptrackError, match="no scene nought; there are a, b"):
        picture_source("nought")


def test_training_holds_on_to_no_tensors(data: DataSet, tmp_path: Path) -> None:
    cfg = parse_cfg(TINY_TINY, Path("tt.cfg"))
    counts = []
    for step in train(Job(cfg, data, tmp_path, settings(iterations=25))):
        if step.iteration in (5, 25):
            gc.collect()
            counts.append(sum(issubclass(type(item), torch.Tensor) for item in gc.get_objects()))
    assert counts[0] == counts[1] > 10


def test_a_loss_that_is_no_number_stops_the_training(data: DataSet, tmp_path: Path) -> None:
    cfg = parse_cfg(TINY_TINY, Path("tt.cfg"))
    wild = settings(optimizer="sgd", learning_rate=1e12)
    with pytest.raises(DroptrackError, match="no number any more at iteration"):
        list(train(Job(cfg, data, tmp_path, wild)))


def test_a_label_of_a_class_that_is_not_there_is_named(data: DataSet, tmp_path: Path) -> None:
    image = tmp_path / "0.jpg"
    image.write_bytes(data.train[0].read_bytes())
    image.with_suffix(".txt").write_text("1 0.5 0.5 0.1 0.1\n")
    cfg = parse_cfg(TINY_TINY, Path("tt.cfg"))
    wrong = replace(data, train=(image,))
    with pytest.raises(DroptrackError, match=r"0\.txt: has class 1, but the data set 1 classes"):
        list(train(Job(cfg, wrong, tmp_path, settings())))


def test_darknets_rate_burns_in_with_the_fourth_power_and_falls_in_steps() -> None:
    cfg, sgd = parse_cfg(TINY_TINY, Path("tt.cfg")), settings(optimizer="sgd", learning_rate=0.01)
    rates = {n: learning_rate(n, cfg, sgd) for n in (1, 5, 10, 100, 101, 151)}
    expected = {1: 1e-6, 5: 0.01 / 16, 10: 0.01, 100: 0.01, 101: 0.001, 151: 0.0005}
    assert rates == pytest.approx(expected)


def test_every_picture_is_used_once_before_any_is_used_again() -> None:
    batches = list(Batches(n=12, batch=4, start=0, stop=6, seed=1, random=(0.5, 2)))
    indices = [item[0] for batch in batches for item in batch]
    assert sorted(indices[:12]) == sorted(indices[12:]) == list(range(12))
    assert indices[:12] != indices[12:]
    later = list(Batches(n=12, batch=4, start=4, stop=6, seed=1, random=(0.5, 2)))
    assert later == batches[4:]
    factors = {batch[0][2] for batch in batches}
    assert len(factors) == 6
    assert all(0.5 <= factor <= 2 for factor in factors)


@pytest.mark.parametrize("window", [(416, 224), (832, 416)])
def test_augmented_boxes_stay_on_their_droplets(window: tuple[int, int]) -> None:
    """Draw squares, change the picture at random, and find them again where the boxes say."""
    rng = np.random.default_rng(7)
    image = np.zeros((600, 1200, 3), np.uint8)
    boxes = np.array([[200, 100, 80, 60], [640, 320, 60, 60], [1000, 480, 100, 40.0]])
    for x, y, w, h in boxes.astype(int):
        image[y - h // 2 : y + h // 2, x - w // 2 : x + w // 2] = 255
    how = Augmentation((832, 416), window, 0.2, (1, 1), 1.5, 1.5, 0.1, flip=True)
    seen = 0
    for _ in range(30):
        picture, truths = augment(
            rng, image, np.zeros(3, np.int64), boxes / [1200, 600, 1200, 600], how, 1.0
        )
        mask = (picture[..., 0] > picture.max() / 2).astype(np.uint8)
        _, _, stats, _ = cv2.connectedComponentsWithStats(mask)
        found = stats[1:, :4].astype(float)
        found[:, :2] += found[:, 2:] / 2
        wanted = truths[:, 1:] * [window[0], window[1], window[0], window[1]]
        for box in wanted:
            assert np.abs(found - box).max(axis=1).min() < 1.5
        seen += len(wanted)
    assert seen > 30
