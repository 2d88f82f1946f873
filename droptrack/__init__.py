"""Find and track droplets in videos of flowing emulsions.

`track` does what the command ``droptrack track`` does, `evaluate` compares its result, which are
`Trajectories`, with the ground truth.
"""

from droptrack.api import track
from droptrack.data.detections import Detections
from droptrack.data.report import Report
from droptrack.data.trajectories import Trajectories, read_trajectories, write_trajectories
from droptrack.errors import DroptrackError
from droptrack.evaluation.trajectories import evaluate
from droptrack.pipeline.config import TrackingConfig
from droptrack.pipeline.run import TrackingRun
from droptrack.tracking.choice import TrackerConfig
from droptrack.version import __version__

__all__ = [
    "Detections",
    "DroptrackError",
    "Report",
    "TrackerConfig",
    "TrackingConfig",
    "TrackingRun",
    "Trajectories",
    "__version__",
    "evaluate",
    "read_trajectories",
    "track",
    "write_trajectories",
]
