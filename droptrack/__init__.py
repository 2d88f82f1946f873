"""Find and track droplets in videos of flowing emulsions.

`track` does what the command ``droptrack track`` does, `evaluate` compares its result, which are
`Trajectories`, with the ground truth.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from droptrack.errors import DroptrackError
from droptrack.version import __version__

if TYPE_CHECKING:
    from droptrack.api import track
    from droptrack.data.detections import Detections
    from droptrack.data.report import Report
    from droptrack.data.trajectories import Trajectories, read_trajectories, write_trajectories
    from droptrack.evaluation.trajectories import evaluate
    from droptrack.pipeline.config import TrackingConfig
    from droptrack.pipeline.run import TrackingRun
    from droptrack.tracking.choice import TrackerConfig

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

# where they are; each is imported when it is asked for, since all together take a second
_PLACES = {
    "Detections": "data.detections",
    "Report": "data.report",
    "TrackerConfig": "tracking.choice",
    "TrackingConfig": "pipeline.config",
    "TrackingRun": "pipeline.run",
    "Trajectories": "data.trajectories",
    "evaluate": "evaluation.trajectories",
    "read_trajectories": "data.trajectories",
    "track": "api",
    "write_trajectories": "data.trajectories",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'droptrack' has no attribute {name!r}")
    return getattr(import_module(f"droptrack.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
