"""The simulations on a GPU: the same fields as the reference's.

Where there is no GPU the same tests run in CUDA's simulator, which is Python, and so for as few
steps on as few nodes as will do.
"""

import os
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen.lattice_boltzmann.color_gradient import reference as cg
from data_gen.lattice_boltzmann.color_gradient.geometry import Params, solid_nodes
from data_gen.lattice_boltzmann.free_energy import reference as fe
from data_gen.lattice_boltzmann.settings import solver_class, usable_device
from data_gen.simulate import app
from droptrack.data.trajectories import read_trajectories
from droptrack.errors import DroptrackError

numba = pytest.importorskip("numba")

SIMULATED = os.environ.get("NUMBA_ENABLE_CUDASIM", "0") != "0"


def works() -> bool:
    """Whether there is a GPU, or its simulator."""
    try:
        return usable_device("cuda", print) == "cuda"
    except DroptrackError:
        return False


WORKS = works()
on_cuda = pytest.mark.skipif(not WORKS, reason="needs CUDA")
on_gpu = pytest.mark.skipif(not WORKS or SIMULATED, reason="needs a GPU")
# Numba warns of grids too small to fill a GPU, as these are
pytestmark = pytest.mark.filterwarnings("ignore:.*Grid size")


def tiny_constriction(**changes: Any) -> Params:
    values: dict[str, Any] = {
        "droplets": 2, "radius": 5, "height": 24, "throat_height": 14, "throat_length": 3,
        "inlet_length": 23, "outlet_length": 5, "tau": 0.9, "window": 25, "rest_steps": 13,
        "ramp_steps": 4, "u_in": 0.03,
    }  # fmt: skip
    return Params(**(values | changes))


def small_constriction() -> Params:
    return tiny_constriction(
        droplets=5, radius=6, height=70, throat_height=24, inlet_length=60, throat_length=30,
        outlet_length=50, window=40,
    )  # fmt: skip


def rough_emulsion(params: Params) -> cg.State:
    """Touching droplets off their windows' middles, in walls' reach, in a disturbed flow."""
    rng = np.random.default_rng(5)
    state = cg.initial_state(params)
    solid = solid_nodes(params)
    whole = np.zeros((params.droplets, *solid.shape))
    for k, label in enumerate(state.labels):
        whole[k][cg.nodes(state, k)] = label
    shift = (params.inlet_length - round(params.emulsion_diameter)) // 2 + 5  # into the throat
    whole = np.roll(whole, shift, axis=2) * rng.uniform(0.9, 1.05, whole.shape) * ~solid
    state.origins[:, 1] += shift - 4
    state.origins[:] = state.origins.clip(0, np.array(solid.shape) - state.labels.shape[1:])
    labels = np.array([c[cg.nodes(state, k)] for k, c in enumerate(whole)])
    return replace(
        state, f=state.f * rng.uniform(0.95, 1.05, state.f.shape), labels=labels, step=15,
        emulsion=np.roll(state.emulsion, shift, axis=1) * ~solid,
    )  # fmt: skip


def tiny_shear(**changes: Any) -> fe.Params:
    values: dict[str, Any] = {
        "width": 26, "height": 24, "cores": 2, "core_radius": 3.0, "shell_radius": 8.5,
        "core_distance": 3.0, "a": 0.08, "k": 0.06, "window": 16, "rest_steps": 51,
        "force_x": 1e-6, "epsilon": 0.01,
    }  # fmt: skip
    return fe.Params(**(values | changes))


def small_shear(**changes: Any) -> fe.Params:
    return tiny_shear(
        **{
            "width": 70, "height": 64, "core_radius": 7.0, "shell_radius": 22.0,
            "core_distance": 9.0, "a": 0.07, "k": 0.1, "window": 40,
        } | changes
    )  # fmt: skip


def rough_cores(params: fe.Params) -> fe.State:
    """Cores off their windows' middles, one across the periodic edge, in a disturbed flow."""
    rng = np.random.default_rng(1)
    state = fe.initial_state(params)
    origins = state.origins
    shift = params.width // 2 - 2
    if params.window:
        origins = origins + np.array([[0, shift], [1, shift - 2]])
        cores = np.roll(state.cores, (-1, 2), axis=(1, 2))
    else:
        cores = np.roll(state.cores, shift, axis=2)
    return replace(
        state, f=state.f * rng.uniform(0.97, 1.03, state.f.shape), step=49,
        origins=origins, cores=cores + rng.uniform(0, 0.05, cores.shape),
        outer=np.roll(state.outer, shift, axis=1),
    )  # fmt: skip


def assert_same(state: Any, expected: Any, atol: float) -> None:
    assert state.step == expected.step
    for name, value in vars(expected).items():
        np.testing.assert_allclose(getattr(state, name), value, rtol=0, atol=atol, err_msg=name)


@on_cuda
@pytest.mark.parametrize("size", ["tiny", pytest.param("small", marks=on_gpu)])
def test_colour_gradient_is_the_reference_to_rounding(size: str) -> None:
    params, steps = (tiny_constriction(), 2) if size == "tiny" else (small_constriction(), 60)
    state = rough_emulsion(params)
    before = state.origins.copy()
    running = solver_class("color_gradient", "cuda")(params, state)
    running.run(1)
    running.run(steps - 1)
    for _ in range(steps):
        state = cg.step(params, state)
    assert (state.origins != before).any()  # at step 16
    assert cg.label_sum(state)[:, params.inlet_length :].max() > 0.5  # some are in the throat
    assert_same(running.state, state, atol=1e-13 if size == "tiny" else 1e-10)


@on_cuda
@pytest.mark.parametrize(("window", "order"), [(True, 4), (False, 2)])
@pytest.mark.parametrize("size", ["tiny", pytest.param("small", marks=on_gpu)])
def test_free_energy_is_the_reference_to_rounding(size: str, window: bool, order: int) -> None:
    make, steps = (tiny_shear, 3) if size == "tiny" else (small_shear, 60)
    params = make(flux_order=order) if window else make(flux_order=order, window=0)
    state = rough_cores(params)
    before = state.origins.copy()
    running = solver_class("free_energy", "cuda")(params, state)
    running.run(1)
    running.run(steps - 1)
    for _ in range(steps):  # the windows move at step 50, the walls at 51
        state = fe.step(params, state)
    assert (state.origins != before).any() == window
    assert_same(running.state, state, atol=1e-13)


@on_gpu
@pytest.mark.parametrize("model", ["color_gradient", "free_energy"])
def test_two_runs_on_a_gpu_are_equal_bit_for_bit(model: str) -> None:
    states = []
    for parts in ((60,), (1, 7, 52)):
        params: Any = small_constriction() if model == "color_gradient" else small_shear()
        state: Any = rough_emulsion(params) if model == "color_gradient" else rough_cores(params)
        running = solver_class(model, "cuda")(params, state)
        for steps in parts:
            running.run(steps)
        states.append(running.state)
    assert_same(states[0], states[1], atol=0)


@on_cuda
@pytest.mark.parametrize(
    ("model", "size"),
    [
        ("free_energy", "tiny"),
        pytest.param("free_energy", "small", marks=on_gpu),
        pytest.param("color_gradient", "small", marks=on_gpu),
    ],
)
def test_what_one_device_began_the_other_ends(model: str, size: str) -> None:
    params: Any = small_constriction()
    if model == "free_energy":
        params = tiny_shear() if size == "tiny" else small_shear()
    ends = []
    for devices in (("cpu", "cpu", "cpu"), ("cpu", "cuda", "cpu")):
        state: Any = rough_emulsion(params) if model == "color_gradient" else rough_cores(params)
        for device in devices:
            running = solver_class(model, device)(params, state)
            running.run(1 if size == "tiny" else 20)
            state = running.state
        ends.append(state)
    assert_same(ends[1], ends[0], atol=1e-13 if size == "tiny" else 1e-10)


@on_gpu
def test_the_flow_alone_runs_without_droplets() -> None:
    params = tiny_constriction(droplets=0)
    running = solver_class("color_gradient", "cuda")(params, cg.initial_state(params))
    running.run(20)
    state = cg.initial_state(params)
    for _ in range(20):
        state = cg.step(params, state)
    assert_same(running.state, state, atol=1e-13)


def shear_command(out: Path, *options: str) -> list[str]:
    values = vars(tiny_shear(rest_steps=0)) | {"width": 28}
    del values["cores"]
    settings = [part for n, v in values.items() for part in ("--set", f"{n}={v}")]
    return ["shear", "--cores", "2", "--every", "1", "--out", str(out), *settings, *options]


@on_cuda
def test_the_command_runs_on_cuda_and_says_so(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, shear_command(tmp_path, "--steps", "1", "--device", "cuda"))
    assert done.exit_code == 0, done.output
    assert "updates/s on " in done.output
    assert "the CPU" not in done.output
    assert read_trajectories(tmp_path / "truth.csv")[0].frame.tolist() == [0, 0, 1, 1]


def test_cuda_is_refused_with_the_cure_where_it_is_not_to_be_had(tmp_path: Path) -> None:
    if WORKS:
        pytest.skip("it is to be had")
    done = CliRunner().invoke(app, shear_command(tmp_path, "--steps", "2", "--device", "cuda"))
    assert done.exit_code == 1
    assert len(done.output.splitlines()) == 1
    cure = "--device cpu" if find_spec("numba_cuda") else "droptrack[simulate-cuda]"
    assert cure in done.output
    auto = CliRunner().invoke(app, shear_command(tmp_path, "--steps", "2", "--device", "auto"))
    assert auto.exit_code == 0, auto.output
    assert "updates/s on the CPU" in auto.output


@pytest.mark.skipif(SIMULATED, reason="is what runs in the simulator")
def test_the_kernels_are_the_reference_in_the_simulator() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__],
        capture_output=True, text=True, check=False, env=os.environ | {"NUMBA_ENABLE_CUDASIM": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 passed" in done.stdout
