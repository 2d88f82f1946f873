"""Sizes of the simulations' droplets, against what their images show, counted on a fine grid."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import zoom

from data_gen.lattice_boltzmann.camera import Camera, capture
from data_gen.lattice_boltzmann.constriction import Constriction, constriction_parameters
from data_gen.lattice_boltzmann.recording import ground_truth_rows
from data_gen.lattice_boltzmann.shear import Shear, shear_parameters
from data_gen.lattice_boltzmann.simulation import AnySimulation
from droptrack.measurement.droplets import measure_droplets
from droptrack.measurement.shapes import COLUMNS

pytest.importorskip("numba")
FINE = 8  # steps a node


def on_a_fine_grid(field: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(zoom(field, FINE, order=1, grid_mode=True, mode="nearest"))


def shown_diameters(simulation: AnySimulation) -> NDArray[np.float64]:
    """Of circles as large as what is brighter than half in the image and is the droplet's own."""
    bright = on_a_fine_grid(simulation.shade()) > 0.5
    areas = []
    for fraction, corner in simulation.patches():
        y, x = (FINE * corner).astype(int)
        own = on_a_fine_grid(fraction) > 0.5
        areas.append((own & bright[y : y + own.shape[0], x : x + own.shape[1]]).sum())
    return np.asarray(2 * np.sqrt(np.array(areas) / np.pi) / FINE)


@pytest.mark.parametrize("kind", ["shear", "constriction"])
def test_droplets_of_simulations_are_as_large_as_their_images_show(kind: str) -> None:
    """Four cores at rest; nineteen packed droplets, once their films have found their width.

    The boxes are off by 4 %. What the truth counts as a packed droplet, fractions above 1/2, is
    larger: between two of them the image is dark where their fractions differ by less than 1/2.
    """
    simulation: AnySimulation
    if kind == "shear":
        shear = shear_parameters(4)
        simulation = Shear(shear, Shear.initial_state(shear))
    else:
        packed = constriction_parameters("small")
        simulation = Constriction(packed, Constriction.initial_state(packed))
        simulation.run(1000)
    truth = ground_truth_rows(simulation, 0, 1)
    boxes = truth[:, 4:8]
    off = 0.04 * np.random.default_rng(0).normal(size=boxes.shape)
    frame = capture(simulation.shade(), Camera(), 0)
    found = measure_droplets(frame, boxes + off * boxes[:, [2, 3, 2, 3]])
    error = found.shapes[:, COLUMNS.index("diameter_px")] / shown_diameters(simulation) - 1
    assert len(error) == (4 if kind == "shear" else 19)
    assert np.sqrt((error**2).mean()) < 0.01
    assert abs(error.mean()) < 0.003
