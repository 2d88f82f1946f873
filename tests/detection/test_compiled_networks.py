"""Networks that an earlier run compiled are used again, where nothing has changed."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("openvino")

from droptrack.detection.engine_choice import Backend, Engines, Network, Precision, choose_detector
from droptrack.detection.engines import compiled_networks
from droptrack.detection.engines.openvino import OpenVinoEngine
from droptrack.network.bundled import find_network
from droptrack.network.darknet_cfg import Cfg, cfg_text
from droptrack.network.darknet_weights import Weights, read_weights

CFG, WEIGHTS_PATH = find_network(size="96x64")
WEIGHTS = read_weights(WEIGHTS_PATH, CFG)
FRAMES = [np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache; returns its folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "droptrack"


class Counted:
    """Gives the weights, and counts how often it was asked for them."""

    def __init__(self) -> None:
        self.n = 0

    def __call__(self) -> tuple[Cfg, Weights]:
        self.n += 1
        return CFG, WEIGHTS


def maps(asked: Counted, **told_by: str) -> list[np.ndarray]:
    """What a new engine computes."""
    engine = OpenVinoEngine(CFG, asked, "fp32", 0.4, told_by=told_by or {"weights": "a"})
    outputs: list[np.ndarray] = engine.start(engine.prepare(FRAMES)).result().outputs
    return outputs


@pytest.mark.usefixtures("cache")
def test_a_network_is_compiled_once_and_computes_the_same_then() -> None:
    asked = Counted()
    first, second = maps(asked), maps(asked)
    assert asked.n == 1
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    maps(asked, weights="b")
    assert asked.n == 2  # of other weights


def test_what_is_damaged_or_not_taken_is_compiled_again(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = Counted()
    first = maps(asked)
    (kept,) = cache.iterdir()
    content = bytearray(kept.read_bytes())
    content[len(content) // 2] ^= 1
    kept.write_bytes(content)
    np.testing.assert_array_equal(maps(asked)[0], first[0])
    assert asked.n == 2
    monkeypatch.setattr(compiled_networks, "find", lambda _: b"of an OpenVINO to come")
    np.testing.assert_array_equal(maps(asked)[0], first[0])
    assert asked.n == 3


def test_the_networks_used_longest_ago_are_deleted(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled_networks, "MAX_KEPT", 2)
    for number in range(4):
        compiled_networks.keep({"number": number}, b"network")
    assert len(list(cache.iterdir())) == 2
    assert compiled_networks.find({"number": 3}) == b"network"


def test_where_nothing_can_be_kept_it_is_compiled_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    asked = Counted()
    maps(asked)
    maps(asked)
    assert asked.n == 2


def test_engines_are_shared_by_videos_of_one_size_and_the_last_ones_kept() -> None:
    engines = Engines(2)

    def engine(size: str) -> object:
        cfg, weights = find_network(size=size)
        network = Network(cfg, weights, threshold=0.4, max_iou=0.3)
        found = choose_detector(network, Backend.opencv, Precision.fp32, engines=engines)
        return found.engine

    assert "width=96" in cfg_text(CFG)
    first = engine("96x64")
    assert engine("96x64") is first
    assert engine("128x64") is not first
    assert engine("96x64") is first
    engine("64x64")  # now the one of 128 x 64 was used longest ago
    assert engine("96x64") is first
