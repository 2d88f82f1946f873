"""The analyses that there are, by their names, and one that is asked for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from droptrack.analysis.flock.report import FlockConfig, analyse_flock
from droptrack.analysis.flow.report import FlowConfig, analyse_flow
from droptrack.analysis.motion.report import MotionConfig, analyse_motion
from droptrack.analysis.records import Analysis
from droptrack.analysis.size.report import SizeConfig, analyse_size
from droptrack.analysis.structure.report import StructureConfig, analyse_structure
from droptrack.data.formats.table import Table

Config: TypeAlias = FlockConfig | MotionConfig | StructureConfig | FlowConfig | SizeConfig
ANALYSES: Mapping[str, Callable[[Table, Any], Analysis]] = {
    "flock": analyse_flock,
    "motion": analyse_motion,
    "structure": analyse_structure,
    "flow": analyse_flow,
    "size": analyse_size,
}


@dataclass(frozen=True)
class Asked:
    """An analysis by its name, and its options."""

    name: str
    config: Config

    def of(self, table: Table) -> Analysis:
        """What it finds in a table; raises DroptrackError for options that cannot be."""
        return ANALYSES[self.name](table, self.config)
