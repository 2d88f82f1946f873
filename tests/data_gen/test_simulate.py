import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.lattice_boltzmann.camera import Camera, capture
from data_gen.lattice_boltzmann.recording import (
    Recording,
    SimulationRecorder,
    axes_of,
    ground_truth_rows,
)
from data_gen.simulate import app
from droptrack.data.trajectories import read_trajectories
from droptrack.data.video import Video
from droptrack.errors import DroptrackError

pytest.importorskip("numba")
from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.geometry import Params
from data_gen.lattice_boltzmann.constriction import Constriction
from data_gen.lattice_boltzmann.free_energy import reference as fe
from data_gen.lattice_boltzmann.shear import Shear

TINY = [
    "width=70", "height=60", "core_radius=7", "shell_radius=22", "core_distance=9", "window=40",
    "rest_steps=10",
]  # fmt: skip
RUNNER = CliRunner()


def tiny_shear(out: Path, *options: str) -> list[str]:
    settings = [part for setting in TINY for part in ("--set", setting)]
    return [
        "shear", "--cores", "2", "--every", "10", "--out", str(out), *settings,
        *options,
    ]  # fmt: skip


def tiny_constriction() -> Constriction:
    params = Params(
        height=60, throat_height=40, throat_length=10, inlet_length=60, outlet_length=60,
        droplets=3, u_in=0.02, rest_steps=20, ramp_steps=200, window=50,
    )  # fmt: skip
    return Constriction(params, cg.initial_state(params))


def truth_and_video(out: Path) -> list[bytes]:
    return [(out / name).read_bytes() for name in ("truth.csv", "video.avi", "checks.csv")]


def test_shear_writes_video_ground_truth_parameters_and_images(tmp_path: Path) -> None:
    result = RUNNER.invoke(app, tiny_shear(tmp_path, "--steps", "40", "--scale", "3"))
    assert result.exit_code == 0, result.output
    assert "lattice updates/s" in result.output
    assert Video(str(tmp_path / "video.avi")).info.n_frames == 5
    frames = list(Video(str(tmp_path / "video.avi")))
    assert frames[0].shape == (180, 210, 3)
    for name in ("start", "middle", "end"):
        assert cv2.imread(str(tmp_path / f"{name}.png")) is not None
    written = json.loads((tmp_path / "parameters.json").read_text())
    assert written["parameters"]["core_radius"] == 7
    truth, about = read_trajectories(tmp_path / "truth.csv")
    assert "shear" in about["made by"]
    assert truth.frame.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    # the first core starts at 45 degrees, up right of the middle: image y points down
    assert truth.x[0] == pytest.approx(3 * (35 + 9 / 2**0.5), abs=1)
    assert truth.y[0] == pytest.approx(3 * (30 - 9 / 2**0.5), abs=1)
    for row in range(2):  # cores are white in a black shell
        x, y = int(truth.x[row]), int(truth.y[row])
        assert frames[0][y, x].min() > 200
    assert frames[0][90 - 45, 105 - 45].max() < 60


def test_ground_truth_is_that_of_a_drawn_droplet() -> None:
    simulation = tiny_constriction()
    state = simulation.state
    labels = np.zeros_like(state.labels)
    labels[0, 10:20, 5:25] = 1.0  # 20 wide, 10 high
    labels[1, 0, 0] = 0.3  # as good as nothing
    labels[2, 7, 3] = 0.9
    simulation.load(simulation.arrays() | {"labels": labels, "step": 5})
    rows = ground_truth_rows(simulation, 4, scale=2)
    y_0, x_0 = state.origins[0]
    expected = [4, 1, 2 * (x_0 + 15), 2 * (60 - y_0 - 15)]
    axes = [4 * 40 / 12**0.5, 4 * 20 / 12**0.5, 0]  # a rectangle's second moment is L^2 / 12
    np.testing.assert_allclose(rows[0], [*expected, *expected[2:], 40, 20, 800, *axes], atol=1e-9)
    assert rows[:, 1].tolist() == [1, 3]


@pytest.mark.parametrize("kind", ["shear", "constriction"])
def test_a_stopped_run_resumes_bit_for_bit(tmp_path: Path, kind: str) -> None:
    def simulation() -> Shear | Constriction:
        if kind == "constriction":
            return tiny_constriction()
        params = fe.Params(
            width=70, height=60, cores=2, core_radius=7, shell_radius=22, core_distance=9,
            window=40, rest_steps=10,
        )  # fmt: skip
        return Shear(params, fe.initial_state(params))

    recording = Recording(
        first=20, last=110, every=15, fps=25, camera=Camera(noise=4.0, seed=3), checkpoint_frames=2
    )
    SimulationRecorder(simulation(), tmp_path / "whole", recording).run(resume=False)

    class StoppedError(Exception):
        pass

    stopped = simulation()
    run = stopped.run

    def run_until_killed(steps: int) -> None:
        if stopped.step > 60:
            raise StoppedError
        run(steps)

    stopped.run = run_until_killed  # type: ignore[method-assign]
    with pytest.raises(StoppedError):
        SimulationRecorder(stopped, tmp_path / "parts", recording).run(resume=False)
    SimulationRecorder(simulation(), tmp_path / "parts", recording).run(resume=True)
    assert truth_and_video(tmp_path / "parts") == truth_and_video(tmp_path / "whole")
    states = [np.load(tmp_path / name / "checkpoint.npz") for name in ("parts", "whole")]
    for name in states[0].files:
        assert (states[0][name] == states[1][name]).all()


def test_an_interrupted_run_keeps_what_it_has(tmp_path: Path) -> None:
    simulation = tiny_constriction()
    run = simulation.run

    def run_and_interrupt(steps: int) -> None:
        run(steps)
        if simulation.step >= 170:
            os.kill(os.getpid(), signal.SIGINT)

    simulation.run = run_and_interrupt  # type: ignore[method-assign]
    recording = Recording(
        first=0, last=400, every=20, fps=25, camera=Camera(), checkpoint_frames=100
    )
    with pytest.raises(KeyboardInterrupt):
        SimulationRecorder(simulation, tmp_path, recording).run(resume=False)
    with np.load(tmp_path / "checkpoint.npz") as kept:
        assert len(kept["counts"]) == 10  # the frame at 180 too
    text = SimulationRecorder(tiny_constriction(), tmp_path, recording).run(resume=True)
    assert "21 frames" in text


def test_an_unstable_run_stops_says_where_and_keeps_the_checkpoint(tmp_path: Path) -> None:
    simulation = tiny_constriction()
    recording = Recording(first=0, last=400, every=10, fps=25, camera=Camera(), checkpoint_frames=1)
    run = simulation.run

    def blow_up(steps: int) -> None:
        run(steps)
        if simulation.step >= 30:
            f = simulation.state.f.copy()
            f[1, 30, 30] = np.nan
            simulation.load(simulation.arrays() | {"f": f})

    simulation.run = blow_up  # type: ignore[method-assign]
    with pytest.raises(DroptrackError, match=r"unstable at step 30: values that are not finite"):
        SimulationRecorder(simulation, tmp_path, recording).run(resume=False)
    with np.load(tmp_path / "checkpoint.npz") as kept:
        assert kept["state_step"] == 20
        assert np.isfinite(kept["state_f"]).all()


def test_too_strong_a_tension_is_seen_as_unstable() -> None:
    simulation = tiny_constriction()
    params = replace(simulation.params, sigma=0.2, near_contact=40.0)
    wild = Constriction(params, cg.initial_state(params))
    trouble = None
    for _ in range(20):
        wild.run(50)
        trouble = trouble or wild.unstable()
    assert trouble


def test_camera_effects_change_the_image_and_leave_the_ground_truth(tmp_path: Path) -> None:
    plain = tiny_shear(tmp_path / "plain", "--steps", "20")
    degraded = tiny_shear(
        tmp_path / "degraded", "--steps", "20", "--blur", "1", "--noise", "8", "--uneven", "0.5"
    )
    assert RUNNER.invoke(app, plain).exit_code == RUNNER.invoke(app, degraded).exit_code == 0
    first, second = (
        read_trajectories(tmp_path / n / "truth.csv")[0] for n in ("plain", "degraded")
    )
    assert (first.x == second.x).all()
    assert (first.boxes == second.boxes).all()
    shade = np.ones((20, 30))
    image = capture(shade, Camera(noise=5.0, uneven=0.5, seed=1), 7)
    assert image[:4, :4].mean() > 1.6 * image[-4:, -4:].mean()
    assert (image == capture(shade, Camera(noise=5.0, uneven=0.5, seed=1), 7)).all()
    assert (image != capture(shade, Camera(noise=5.0, uneven=0.5, seed=1), 8)).any()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--set", "mobility=1"], "unstable"),
        (["--set", "mobilty=1"], "no such parameter"),
        (["--set", "width=wide"], "whole number"),
        (["--scale", "0"], "--scale"),
        (["--steps", "5"], "--steps"),
        (["--resume"], "no run to resume"),
        (["--threads", "9999"], "--threads"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    tmp_path: Path, options: list[str], reason: str
) -> None:
    result = RUNNER.invoke(app, tiny_shear(tmp_path, *options))
    assert result.exit_code == 1
    assert reason in result.output
    assert len(result.output.splitlines()) == 1


def test_checkpoints_of_other_runs_and_broken_ones_are_refused(tmp_path: Path) -> None:
    assert RUNNER.invoke(app, tiny_shear(tmp_path, "--steps", "20")).exit_code == 0
    again = RUNNER.invoke(app, tiny_shear(tmp_path, "--steps", "20"))
    assert "holds a run already" in again.output
    complete = RUNNER.invoke(app, tiny_shear(tmp_path, "--steps", "20", "--resume"))
    assert "complete" in complete.output
    other = RUNNER.invoke(app, tiny_shear(tmp_path, "--steps", "20", "--set", "a=0.08", "--resume"))
    assert "other parameters a;" in other.output
    checkpoint = tmp_path / "checkpoint.npz"
    checkpoint.write_bytes(checkpoint.read_bytes()[:1000])
    broken = RUNNER.invoke(app, tiny_shear(tmp_path, "--steps", "20", "--resume"))
    assert "cannot be read as a checkpoint" in broken.output
    for result in (again, complete, other, broken):
        assert result.exit_code == 1
        assert len(result.output.splitlines()) == 1


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = RUNNER.invoke(app, tiny_shear(tmp_path / "file" / "run", "--steps", "20"))
    assert result.exit_code == 1
    assert "file" in result.output
    assert len(result.output.splitlines()) == 1


def test_without_numba_the_command_says_what_to_install(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from data_gen.simulate import app\n"
        f"app(['shear', '--out', {str(tmp_path / 'run')!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "droptrack[simulate]" in done.stderr


def test_the_axes_of_nodes_are_those_of_their_ellipse() -> None:
    """Nodes of a turned ellipse with semi-axes of 30 and 18, y down: its axes, and its angle."""
    y, x = np.mgrid[-40:41, -40:41]
    along, across = x * np.cos(0.4) + y * np.sin(0.4), y * np.cos(0.4) - x * np.sin(0.4)
    inside = (along / 30) ** 2 + (across / 18) ** 2 < 1
    major, minor, angle = axes_of(x[inside], y[inside])
    assert (major, minor, angle) == pytest.approx((60, 36, 0.4), rel=5e-3)
