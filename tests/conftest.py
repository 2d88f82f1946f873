"""Short videos with their truth, made once; loops and the arrays that they stand for."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from typer.testing import CliRunner

from data_gen.scenes.shapes import BLACK, WHITE, draw_contour, draw_ellipses
from data_gen.simulate import app as simulate
from droptrack.data.trajectories import sorted_trajectories, write_trajectories
from droptrack.data.video import VideoInfo, VideoWriter
from droptrack.detection import decoding
from droptrack.measurement import centre_of_mass, closed_paths, outlines, rays, rings


@pytest.fixture
def arrays(monkeypatch: pytest.MonkeyPatch) -> Callable[[], AbstractContextManager[None]]:
    """Within, nothing is done in compiled loops, as where Numba is not installed."""

    @contextmanager
    def without_loops() -> Iterator[None]:
        with monkeypatch.context() as patch:
            for module in (centre_of_mass, closed_paths, outlines, rays, rings, decoding):
                patch.setattr(module, "load_loops", lambda: None)
            yield

    return without_loops


@pytest.fixture(params=["arrays", "compiled"])
def implementation(
    request: pytest.FixtureRequest, arrays: Callable[[], AbstractContextManager[None]]
) -> Iterator[None]:
    """In arrays, and in compiled loops."""
    if request.param == "arrays":
        with arrays():
            yield
    else:
        pytest.importorskip("numba")
        assert centre_of_mass.load_loops() is not None
        assert closed_paths.load_loops() is not None
        assert outlines.load_loops() is not None
        assert rays.load_loops() is not None
        assert rings.load_loops() is not None
        assert decoding.load_loops() is not None
        yield


@pytest.fixture(scope="session")
def sine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's test video (Eq. D1): 12 droplets, 40 frames."""
    folder = tmp_path_factory.mktemp("sine")
    result = CliRunner().invoke(simulate, ["sine", "--out", str(folder), "--frames", "40"])
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="session")
def four_cores(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four cores in a sheared shell, simulated for 15,000 steps: a tenth of a turn, 31 frames."""
    pytest.importorskip("numba")
    return _simulated(tmp_path_factory, "shear", "--cores", "4", "--steps", "15000")


@pytest.fixture(scope="session")
def nineteen_droplets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nineteen droplets that pass a constriction, simulated."""
    pytest.importorskip("numba")
    return _simulated(tmp_path_factory, "constriction")


def _simulated(tmp_path_factory: pytest.TempPathFactory, *arguments: str) -> Path:
    folder = tmp_path_factory.mktemp(arguments[0])
    result = CliRunner().invoke(simulate, [*arguments, "--out", str(folder)])
    assert result.exit_code == 0, result.output
    return folder


def cells(points: np.ndarray, film: float, free: float) -> list[np.ndarray]:
    """Radii (128,) of polygonal droplets around points, a film of liquid apart, corners rounded."""
    angles = np.arange(128) * 2 * np.pi / 128
    shapes = []
    for point in points:
        radii = np.full(128, free)
        for other in points:
            offset = other - point
            distance = np.hypot(*offset)
            if 0 < distance < 2 * free + film:
                cosine = np.cos(angles - np.arctan2(offset[1], offset[0]))
                wall = (distance - film) / 2 / np.maximum(cosine, 1e-3)
                radii = np.minimum(radii, wall)
        shapes.append(gaussian_filter1d(radii, 3.0, mode="wrap"))
    return shapes


@pytest.fixture(scope="session")
def dense_flow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nineteen touching, deforming droplets squeezed to 60 % of their height, 30 frames."""
    folder = tmp_path_factory.mktemp("dense")
    row, column = np.mgrid[-2:3, -3:4].reshape(2, -1)
    lattice = np.column_stack([column + (row % 2) / 2, row * np.sqrt(0.75)]) * 62.0
    lattice = lattice[np.argsort(np.hypot(*lattice.T))[:19]]
    table = []
    with VideoWriter(folder / "video.avi", VideoInfo(1000, 500, 25, 30), "MJPG") as video:
        for t in range(30):
            squeeze = 1 - 0.4 * t / 29
            points = lattice * [1 / squeeze, squeeze] + [320 + 8 * t, 250]
            canvas = np.zeros((500, 1000), np.uint8)
            for i, (point, radii) in enumerate(zip(points, cells(points, 6, 34), strict=True)):
                draw_contour(canvas, point, radii, WHITE)
                angles = np.arange(128) * 2 * np.pi / 128
                outline = point + radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
                moment = (2 / 3 * radii**3)[:, None] * np.column_stack(
                    [np.cos(angles), np.sin(angles)]
                )
                centre = point + moment.sum(axis=0) / (radii**2).sum()
                low, high = outline.min(axis=0), outline.max(axis=0)
                table.append([t, i + 1, *centre, *((low + high) / 2), *(high - low)])
            video.write(np.repeat(canvas[..., None], 3, axis=2))
    _write_truth(folder, np.array(table))
    return folder


@pytest.fixture(scope="session")
def sheared_shell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four white cores that turn clockwise in a black ellipse on white, 30 frames."""
    folder = tmp_path_factory.mktemp("shell")
    table = []
    with VideoWriter(folder / "video.avi", VideoInfo(1020, 510, 25, 30), "MJPG") as video:
        for t in range(30):
            canvas = np.full((510, 1020), WHITE, np.uint8)
            draw_ellipses(canvas, np.array([[510.0, 255, 190, 130, -0.5]]), BLACK, edge_px=8)
            turn = 0.05 * t + np.arange(4) * np.pi / 2
            u, v = 95 * np.cos(turn), 65 * np.sin(turn)
            x, y = 510 + u * np.cos(0.5) + v * np.sin(0.5), 255 - u * np.sin(0.5) + v * np.cos(0.5)
            discs = np.column_stack([x, y, np.full((4, 2), 38.0), np.zeros(4)])
            draw_ellipses(canvas, discs, WHITE, edge_px=8)
            table += [[t, i + 1, x[i], y[i], x[i], y[i], 76.0, 76.0] for i in range(4)]
            video.write(np.repeat(canvas[..., None], 3, axis=2))
    _write_truth(folder, np.array(table))
    return folder


def _write_truth(folder: Path, table: np.ndarray) -> None:
    n = len(table)
    rows = sorted_trajectories(
        table[:, 0].astype(np.int64),
        table[:, 1].astype(np.int64),
        table[:, 2],
        table[:, 3],
        table[:, 4:8],
        np.ones(n),
        np.ones(n, bool),
    )
    write_trajectories(folder / "truth.csv", rows, {"video": "video.avi, 1000 x 500 px"})
