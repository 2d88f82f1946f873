"""GEFF, the graph exchange format: a node a row, an edge from each to its droplet's next."""

import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Rows
from droptrack.data.formats.table import Table, tracks
from droptrack.data.formats.tables import columns_of, table_of_columns
from droptrack.errors import DroptrackError

ABOUT = "droptrack"  # the key under which `#` lines are kept


def write_geff(path: Path, table: Table) -> None:
    """Axes t, y, x in frames and px, with what these are in seconds and micrometres if known."""
    geff, spec = _geff()
    rows, units = table.rows, table.units
    frames: dict[str, str | float] = {"unit": "frame", "type": "time"}
    places: dict[str, str | float] = {"unit": "pixel", "type": "space"}
    if units.fps is not None:
        frames |= {"scale": 1 / units.fps, "scaled_unit": "second"}
    if units.um_per_px is not None:
        places |= {"scale": units.um_per_px, "scaled_unit": "micrometer"}
    axes = [
        spec.Axis(name=name, **kind)
        for name, kind in zip("tyx", (frames, places, places), strict=True)
    ]
    columns = columns_of(table)
    properties = {"t": columns.pop("frame"), **columns}
    properties["observed"] = properties["observed"].astype(np.int64)
    metadata = spec.GeffMetadata(
        geff_version=".".join(version("geff-spec").split(".")[:2]),
        directed=True,
        axes=axes,
        node_props_metadata={},
        edge_props_metadata={},
        track_node_props={"tracklet": "track_id"},
        extra={ABOUT: dict(table.about)},
    )
    if path.exists():
        raise DroptrackError(f"{path}: is there already; choose another name or remove it")
    geff.core_io.write_arrays(
        path,
        node_ids=np.arange(len(rows), dtype=np.uint64),
        node_props={name: {"values": one, "missing": None} for name, one in properties.items()},
        edge_ids=_edges(table).astype(np.uint64),
        edge_props=None,
        metadata=metadata,
    )


def _edges(table: Table) -> Rows:
    """Rows (E, 2): each row and the next one of its droplet; and from parents to their child."""
    found = tracks(table.rows)
    pairs = [np.column_stack([some[:-1], some[1:]]) for _, some in found]
    last = {track_id: int(some[-1]) for track_id, some in found}
    for name in ("parent_id", "parent_id_2"):
        if (parent := table.column(name)) is not None:
            born = [(last.get(int(parent[some[0]])), int(some[0])) for _, some in found]
            pairs += [np.array([[one, child]]) for one, child in born if one is not None]
    return np.concatenate([np.zeros((0, 2), np.int64), *pairs])


def read_geff(path: Path) -> Table:
    """A graph whose nodes have t, y, x and the tracklet's identity, also another program's."""
    geff, _ = _geff()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = geff.core_io.read_to_memory(path)
    except Exception as error:  # noqa: BLE001  of zarr, of pydantic, and its own
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DroptrackError(f"{path}: cannot be read as GEFF: {first}") from None
    metadata = read["metadata"]
    if _major(str(metadata.geff_version)) > _major(version("geff-spec")):
        raise DroptrackError(
            f"{path}: is GEFF {metadata.geff_version}; up to {version('geff-spec')} is read"
        )
    left = sorted(name for name, one in read["node_props"].items() if one["values"].ndim != 1)
    columns: dict[str, NDArray[Any]] = {
        name: one["values"] for name, one in read["node_props"].items() if one["values"].ndim == 1
    }
    tracklet = (metadata.track_node_props or {}).get("tracklet", "track_id")
    names = {axis.type: axis.name for axis in metadata.axes or [] if axis.type == "time"}
    for ours, theirs in (("frame", names.get("time", "t")), ("track_id", tracklet)):
        if theirs not in columns:
            raise DroptrackError(f"{path}: nodes should have a property {theirs}")
        columns[ours] = columns.pop(theirs)
    about = (metadata.extra or {}).get(ABOUT, {})
    notes = [f"left out of nodes: {', '.join(left)}"] if left else []
    return table_of_columns(path, columns, dict(about), notes)


def _major(text: str) -> int:
    """The first number of a version; 0 where there is none."""
    first = text.partition(".")[0]
    return int(first) if first.isdigit() else 0


def _geff() -> tuple[Any, Any]:
    try:
        import geff
        import geff.core_io
        import geff_spec
    except ImportError:
        raise DroptrackError("GEFF needs geff: pip install 'droptrack[formats]'") from None
    return geff, geff_spec
