"""The tutorial runs from its first cell to its last, and finds what the paper's Eq. D1 says."""

from pathlib import Path

import pytest

WHY = "the tutorial is run by nbclient in a kernel of ipykernel: make dev"
nbformat = pytest.importorskip("nbformat", reason=WHY)
nbclient = pytest.importorskip("nbclient", reason=WHY)
pytest.importorskip("ipykernel", reason=WHY)

TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial.ipynb"
CHECKS = """
assert len(table) == 12 * 60
assert abs(step - 5) < 1e-3
assert report.summary["n_droplets_found_in_every_frame"] == 12
assert report.summary["n_switches"] == report.summary["n_false"] == 0
assert report.summary["mse_y_px2"] < 1e-4
"""


def test_the_tutorial_finds_twelve_droplets_that_move_by_five_pixels_a_frame(
    tmp_path: Path,
) -> None:
    notebook = nbformat.read(TUTORIAL, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(CHECKS))
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=where).execute()


def test_the_tutorial_is_kept_without_outputs() -> None:
    cells = nbformat.read(TUTORIAL, as_version=4).cells
    assert not [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")]
