import struct
from pathlib import Path

import numpy as np
import pytest

from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import (
    cfg_text,
    convolutions,
    parse_cfg,
    read_cfg,
    with_options,
    yolo_heads,
)
from droptrack.network.darknet_weights import (
    WEIGHTS_VERSION,
    Weights,
    read_start,
    read_weights,
    write_weights,
)

CFG_FOLDER = Path(__file__).parents[2] / "darknet_cfg"

# sizes of files that Darknet itself writes for one class, in bytes
DARKNET_SIZES = {
    "yolov3": (75, 246_305_388),
    "yolov3-tiny": (13, 34_704_996),
    "yolov3-tiny-droplets": (13, 34_704_996),
}

SMALL = """
[net]
width=64
height=32
channels=3
# a comment
[convolutional]
batch_normalize=1
filters=4
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
anchors=4,4, 8,8, 16,12
classes=1
num=3
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.cfg"
    path.write_text(SMALL)
    return path


@pytest.mark.parametrize("name", DARKNET_SIZES)
def test_networks_have_as_many_values_as_darknet_writes(name: str) -> None:
    shapes = convolutions(read_cfg(CFG_FOLDER / f"{name}.cfg"))
    n_convolutions, n_bytes = DARKNET_SIZES[name]
    assert len(shapes) == n_convolutions
    assert 20 + 4 * sum(shape.n_values for shape in shapes) == n_bytes


def test_heads_have_the_strides_and_anchors_of_the_paper() -> None:
    coarse, middle, fine = yolo_heads(read_cfg(CFG_FOLDER / "yolov3.cfg"))
    assert [head.stride for head in (coarse, middle, fine)] == [32, 16, 8]
    assert coarse.anchors.tolist() == [[116, 90], [156, 198], [373, 326]]
    assert fine.anchors.tolist() == [[10, 13], [16, 30], [33, 23]]


def test_cfg_text_reads_back_to_the_same_sections(small: Path) -> None:
    cfg = read_cfg(small)
    again = parse_cfg(cfg_text(cfg), small)
    assert [(layer.kind, layer.options) for layer in again.layers] == [
        (layer.kind, layer.options) for layer in cfg.layers
    ]
    changed = with_options(cfg, {"width": "96"}, {"thresh": "0.005"})
    assert changed.width == 96
    assert changed.layers[-1].options["thresh"] == "0.005"
    assert "thresh" not in cfg.layers[-1].options


def test_weights_are_laid_out_byte_by_byte_as_darknet_does(small: Path, tmp_path: Path) -> None:
    """3 biases-scales-means-variances x 4 + 4 x 3 x 3 x 3 + 18 + 18 x 4 = 214 values."""
    cfg = read_cfg(small)
    values = np.arange(4 * 4 + 108 + 18 + 72, dtype=np.float32)
    path = tmp_path / "small.weights"
    write_weights(path, Weights(WEIGHTS_VERSION, 6400, values))
    data = path.read_bytes()
    assert data[:20] == struct.pack("<iiiQ", 0, 2, 5, 6400)
    assert data[20:] == struct.pack("<214f", *range(214))
    read = read_weights(path, cfg)
    assert (read.version, read.images_seen) == ((0, 2, 5), 6400)
    assert (read.values == values).all()


def test_old_weights_count_images_with_32_bits(small: Path, tmp_path: Path) -> None:
    path = tmp_path / "old.weights"
    path.write_bytes(struct.pack("<iiiI", 0, 1, 0, 77) + np.ones(214, "<f4").tobytes())
    assert read_weights(path, read_cfg(small)).images_seen == 77


@pytest.mark.parametrize(
    ("n_values", "problem"),
    [
        (213, "ends after 213 of 214 values, within convolution 2 \\(line 15\\)"),
        (20, "within convolution 1 \\(line 7\\)"),
        (215, "215 values, the network 214"),
    ],
)
def test_weights_one_value_off_are_refused(
    small: Path, tmp_path: Path, n_values: int, problem: str
) -> None:
    path = tmp_path / "bad.weights"
    write_weights(path, Weights(WEIGHTS_VERSION, 0, np.zeros(n_values, np.float32)))
    with pytest.raises(DroptrackError, match=problem):
        read_weights(path, read_cfg(small))


def test_weights_with_an_odd_byte_or_nan_or_nothing_are_refused(
    small: Path, tmp_path: Path
) -> None:
    cfg, path = read_cfg(small), tmp_path / "bad.weights"
    with pytest.raises(DroptrackError, match="no such file"):
        read_weights(path, cfg)
    path.write_bytes(b"")
    with pytest.raises(DroptrackError, match="0 bytes are too few"):
        read_weights(path, cfg)
    write_weights(path, Weights(WEIGHTS_VERSION, 0, np.full(214, np.nan, np.float32)))
    with pytest.raises(DroptrackError, match="NaN"):
        read_weights(path, cfg)
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(DroptrackError, match="does not fit"):
        read_weights(path, cfg)
    path.write_bytes(b"<html>404 not found</html>" * 100)
    with pytest.raises(DroptrackError, match="absurd"):
        read_weights(path, cfg)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[net]", "[convolutional]", r"starts with \[net\]"),
        ("width=64", "width=60", "width=60, .*multiple of 32; the nearest is 64"),
        ("filters=18", "filters=255", "filters=18 in the .* which has 255"),
        ("filters=18", "filters=eighteen", "line 15: .* should be a number"),
        ("filters=18", "filters=1_8", "line 15: .* should be a number"),
        ("filters=18", "filters=\uff11\uff18", "line 15: .* should be a number"),
        ("[yolo]", "[gru]", r"line 19: layer \[gru\] is not supported"),
        ("mask=0,1,2", "mask=3,4,5", "mask= names an anchor that is not there"),
        ("size=3", "size 3", "expected key=value"),
        ("[yolo]", "[yolo", "a section is written"),
    ],
)
def test_a_cfg_that_cannot_work_is_refused_with_the_place(
    small: Path, old: str, new: str, problem: str
) -> None:
    small.write_text(SMALL.replace(old, new))
    with pytest.raises(DroptrackError, match=problem) as caught:
        read_cfg(small)
    assert "small.cfg" in str(caught.value)


def test_the_first_layers_alone_start_a_training_but_find_nothing(
    small: Path, tmp_path: Path
) -> None:
    """The first convolution: 4 x 4 + 4 x 27 = 124 of 214 values."""
    cfg = read_cfg(small)
    path = tmp_path / "small.conv.1"
    write_weights(path, Weights(WEIGHTS_VERSION, 0, np.arange(124, dtype=np.float32)))
    assert read_start(path, cfg).values.tolist() == list(range(124))
    with pytest.raises(DroptrackError, match="has the first 1 layers only"):
        read_weights(path, cfg)
    with pytest.raises(DroptrackError, match="does not fit"):
        read_start(path.rename(tmp_path / "small.conv.2"), cfg)
