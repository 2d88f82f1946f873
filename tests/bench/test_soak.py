"""The commands that `bench.soak` kills go on to the same result; one kill of each."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

for needed in ("torch", "numba", "openvino"):
    pytest.importorskip(needed)

from bench.soak_kills import Killable, killables, killed
from bench.soak_videos import numbered_image, shown_number

pytestmark = pytest.mark.skipif(
    not hasattr(signal, "SIGKILL") or not hasattr(os, "killpg"),
    reason="needs a system with signals",
)


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Killable]:
    return {one.name: one for one in killables(tmp_path_factory.mktemp("inputs"))}


@pytest.mark.parametrize("name", ["train", "simulate", "make_dataset", "adapt", "calibrate"])
def test_a_command_that_is_killed_ends_with_the_same_result(
    commands: dict[str, Killable], name: str, tmp_path: Path
) -> None:
    problems = list(killed(commands[name], tmp_path, np.random.default_rng(0), 1))
    assert problems == [None] * 2


def test_a_frame_shows_its_number_though_half_of_it_is_damaged() -> None:
    for number in (0, 1, 37, 63):
        image = numbered_image(number)
        image[:32] = 128
        assert shown_number(image) == number
        image[24:] = 128
        assert shown_number(image) is None
