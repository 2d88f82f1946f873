"""Areas and axes in the simulations' truth, against those of the droplets in their images."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage
from typer.testing import CliRunner

from data_gen.simulate import app
from droptrack.data.trajectories import read_trajectories

pytest.importorskip("numba")

SHEAR = [
    "width=90", "height=70", "core_radius=9", "shell_radius=28", "core_distance=12", "window=40",
    "rest_steps=10",
]  # fmt: skip
CONSTRICTION = [
    "height=60", "throat_height=40", "throat_length=10", "inlet_length=60", "outlet_length=60",
    "droplets=3", "u_in=0.02", "rest_steps=20", "ramp_steps=200", "window=50",
]  # fmt: skip
SNAPSHOTS = {"start": 0, "end": -1}  # frames


def by_pixels(image: np.ndarray, x: float, y: float) -> tuple[float, float, float, float]:
    """Area, axes and angle of the bright piece of an image (H, W) at a place, from its pixels."""
    pieces, _ = ndimage.label(image > 127)
    rows, columns = np.nonzero(pieces == pieces[int(y), int(x)])
    covariance = np.cov(columns, rows, bias=True) + np.eye(2) / 12
    (minor, major), vectors = np.linalg.eigh(covariance)
    angle = np.arctan2(vectors[1, 1], vectors[0, 1])
    return len(rows), 4 * float(np.sqrt(major)), 4 * float(np.sqrt(minor)), float(angle)


@pytest.mark.parametrize(
    ("kind", "settings", "steps", "off"),
    [
        ("shear", SHEAR, 600, 0.03),
        # its image draws dark films where droplets touch, over the fluid that truth counts
        ("constriction", CONSTRICTION, 400, 0.06),
    ],
)
def test_areas_and_axes_are_those_of_the_image(
    kind: str, settings: list[str], steps: int, off: float, tmp_path: Path
) -> None:
    options = [part for one in settings for part in ("--set", one)]
    scale = ("--scale", "4", "--steps", str(steps), "--every", str(steps // 4))
    cores = ("--cores", "2") if kind == "shear" else ()
    done = CliRunner().invoke(app, [kind, "--out", str(tmp_path), *options, *scale, *cores])
    assert done.exit_code == 0, done.output
    truth, _ = read_trajectories(tmp_path / "truth.csv")
    frames = np.unique(truth.frame)
    n_turned = 0
    for name, place in SNAPSHOTS.items():
        image = cv2.imread(str(tmp_path / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        rows = truth[truth.frame == frames[place]]
        assert len(rows) == 2 + (kind == "constriction")
        for i in range(len(rows)):
            area, major, minor, angle = by_pixels(image, rows.x[i], rows.y[i])
            assert np.sqrt(rows.columns["area"][i]) == pytest.approx(np.sqrt(area), rel=off)
            assert rows.columns["major_px"][i] == pytest.approx(major, rel=off)
            assert rows.columns["minor_px"][i] == pytest.approx(minor, rel=off)
            if major > 1.2 * minor:
                n_turned += 1
                apart = (rows.columns["angle_rad"][i] - angle + np.pi / 2) % np.pi - np.pi / 2
                assert abs(apart) < 0.1
    assert n_turned > 0 or kind == "shear"  # whose cores stay all but round
