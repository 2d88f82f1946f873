"""The formats by their names, what each can hold, and which a file is in."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from droptrack.data.files import reading
from droptrack.data.formats import cvat, geff_files, labels, mot_tracks, tables, trackmate_xml
from droptrack.data.formats.table import Table, tracks
from droptrack.errors import DroptrackError

EVERYTHING = frozenset({"everything"})
POSITIONS, BOXES, SCORES, BRIDGED = "x, y", "boxes", "scores", "which rows are bridged gaps"
CLASSES = frozenset({"class_id", "class_name"})
SHAPES = frozenset({"area_px2", "perimeter_px", "circularity"})


class FormatName(StrEnum):
    """What ``--to`` and ``--from`` take."""

    csv = "csv"
    parquet = "parquet"
    trackpy = "trackpy"
    trackmate_xml = "trackmate-xml"
    trackmate_tracks = "trackmate-tracks"
    trackmate_csv = "trackmate-csv"
    mot = "mot"
    mot_truth = "mot-truth"
    napari = "napari"
    cvat = "cvat"
    geff = "geff"
    coco = "coco"
    darknet = "darknet"


@dataclass(frozen=True, kw_only=True)
class Format:
    """How a format is written and read, and what it can hold of a table beside frames and ids."""

    write: Callable[[Path, Table], None]
    read: Callable[[Path, float | None], Table] | None = None
    holds: frozenset[str] = EVERYTHING


def _plain(read: Callable[[Path], Table]) -> Callable[[Path, float | None], Table]:
    return lambda path, _: read(path)


FORMATS = {
    FormatName.csv: Format(write=tables.write_csv, read=_plain(tables.read_csv)),
    FormatName.parquet: Format(write=tables.write_parquet, read=_plain(tables.read_parquet)),
    FormatName.trackpy: Format(write=tables.write_trackpy, read=_plain(tables.read_trackpy)),
    FormatName.napari: Format(write=tables.write_napari, read=_plain(tables.read_napari)),
    FormatName.geff: Format(write=geff_files.write_geff, read=_plain(geff_files.read_geff)),
    FormatName.trackmate_xml: Format(
        write=trackmate_xml.write_trackmate_model,
        read=trackmate_xml.read_trackmate_xml,
        holds=frozenset({POSITIONS, SCORES, "diameter_px"}) | SHAPES,
    ),
    FormatName.trackmate_tracks: Format(
        write=trackmate_xml.write_trackmate_tracks,
        read=trackmate_xml.read_trackmate_xml,
        holds=frozenset({POSITIONS}),
    ),
    FormatName.trackmate_csv: Format(
        write=tables.write_trackmate_csv,
        read=tables.read_trackmate_csv,
        holds=frozenset({POSITIONS, SCORES, "diameter_px"}),
    ),
    FormatName.mot: Format(
        write=mot_tracks.write_mot,
        read=_plain(mot_tracks.read_mot),
        holds=frozenset({BOXES, SCORES}),
    ),
    FormatName.mot_truth: Format(
        write=mot_tracks.write_mot_truth,
        read=_plain(mot_tracks.read_mot),
        holds=frozenset({BOXES, "outline_seen"}),
    ),
    FormatName.cvat: Format(
        write=cvat.write_cvat,
        read=_plain(cvat.read_cvat),
        holds=frozenset({BOXES, BRIDGED}) | CLASSES,
    ),
    FormatName.coco: Format(
        write=labels.write_coco, holds=frozenset({BOXES, SCORES, "area_px2"}) | CLASSES
    ),
    FormatName.darknet: Format(write=labels.write_darknet, holds=frozenset({BOXES, "class_id"})),
}
WITH_ABOUT = {FormatName.csv, FormatName.parquet, FormatName.geff, FormatName.coco}
BY_SUFFIX = {
    ".csv": FormatName.csv,
    ".parquet": FormatName.parquet,
    ".xml": FormatName.trackmate_xml,
    ".txt": FormatName.mot,
    ".geff": FormatName.geff,
    ".json": FormatName.coco,
}


def format_by_suffix(path: Path) -> FormatName:
    """The format that a name stands for; raises DroptrackError where it stands for none."""
    if path.suffix.lower() in BY_SUFFIX:
        return BY_SUFFIX[path.suffix.lower()]
    known = ", ".join(BY_SUFFIX)
    raise DroptrackError(f"{path}: the suffix is none of {known}; say what it is with --to")


def format_of(path: Path) -> FormatName:
    """The format that a file is in, by its first lines."""
    if path.is_dir():
        return FormatName.geff
    with reading(path), path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"PAR1"):
        return FormatName.parquet
    text = head.decode("utf-8", errors="replace").lstrip("\ufeff")
    if text.lstrip().startswith("<"):
        return FormatName.cvat if "<annotations" in text else FormatName.trackmate_xml
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    header = lines[0].split(",") if lines else []
    if header[:2] == ["LABEL", "ID"]:
        return FormatName.trackmate_csv
    if header[:4] == list(tables.NAPARI):
        return FormatName.napari
    if "particle" in header:
        return FormatName.trackpy
    return FormatName.mot if path.suffix.lower() == ".txt" else FormatName.csv


def lost_in(name: FormatName, table: Table) -> list[str]:
    """What of a table a format cannot hold."""
    holds, rows = FORMATS[name].holds, table.rows
    lost = ["# lines"] if table.about and name not in WITH_ABOUT else []
    if name is FormatName.trackmate_xml and (np.unique_counts(rows.track_id).counts == 1).any():
        lost.append("identities of droplets seen once")
    if name is FormatName.cvat and _classes_change(table):
        lost.append("classes of single frames (a droplet has its most frequent one)")
    if holds == EVERYTHING:
        return lost
    centred = np.allclose(rows.boxes[:, :2], np.column_stack([rows.x, rows.y]), atol=1e-6)
    if POSITIONS not in holds and not centred:
        lost.append("x, y (boxes' centres take their place)")
    if BOXES not in holds and len(rows):
        lost.append("boxes")
    if SCORES not in holds and (rows.scores != 1).any():
        lost.append("scores")
    if BRIDGED not in holds and not rows.observed.all():
        lost.append(BRIDGED)
    return lost + [column for column in rows.columns if column not in holds]


def _classes_change(table: Table) -> bool:
    """Whether a droplet has another class in some frame than in others."""
    classes, _ = table.classes()
    return any(len(np.unique(classes[some])) > 1 for _, some in tracks(table.rows))
