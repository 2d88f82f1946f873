"""The columns of a study's tables."""

from droptrack.data.trajectories import COLUMNS as TABLE
from droptrack.data.trajectories import TEXT, WHOLE
from droptrack.data.units import Units
from droptrack.measurement.shapes import COLUMNS as SHAPE
from droptrack.pipeline.results import columns_with

# of the summary: each column, and what it holds; the user's own come after the third
COLUMNS: dict[str, type] = {
    "name": str,
    "video": str,
    "state": str,
    "n_droplets": int,
    "diameter_px": float,
    "diameter_um": float,
    "polydispersity": float,
    "frequency_per_frame": float,
    "frequency_per_s": float,
    "speed_px_per_frame": float,
    "speed_um_per_s": float,
    "n_coalescence": int,
    "n_break_up": int,
    "n_frames": int,
    "n_frames_missing": int,
    "n_long_gaps": int,
    "n_gaps_against_flow": int,
    "fps": float,
    "um_per_px": float,
    "warnings": str,
    "reason": str,
    "backend": str,
    "weights_sha256": str,
    "version": str,
    "seconds": float,
}
N_FIRST = 3

# of the trajectories, with all units that there may be
OF_TRAJECTORIES = (*TABLE, *columns_with(Units(um_per_px=1, fps=1), SHAPE), *TEXT, *WHOLE)
