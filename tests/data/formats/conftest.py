"""The file that is converted."""

from pathlib import Path

import pytest

from droptrack.data.trajectories import write_trajectories
from tests.data.formats.conversions import ABOUT, three_droplets


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    path = tmp_path / "trajectories.csv"
    write_trajectories(path, three_droplets(), ABOUT)
    return path
