"""TrackMate's XML: the model that its editor opens, and the simple file of tracks.

TrackMate's identities begin at 0, and whole numbers are the centres of its pixels.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Floats, Rows
from droptrack.data.formats.table import PIXEL_CENTRE, Table, table_of, tracks
from droptrack.data.formats.tables import px_of_unit, spots_table
from droptrack.data.formats.xml_files import number, read_xml, write_xml
from droptrack.errors import DroptrackError

VERSION = "7.12.1"  # of TrackMate, whose files these are like
NEWEST = 8  # whose files are read
READ = ("POSITION_X", "POSITION_Y", "FRAME", "RADIUS", "QUALITY")  # features of spots
# that follow from others, or say how to show a spot
NEEDLESS = {"ID", "name", "POSITION_Z", "POSITION_T", "VISIBILITY"}
# feature, name, short name, dimension, whether a whole number
SPOT_FEATURES = (
    ("QUALITY", "Quality", "Quality", "QUALITY", False),
    ("POSITION_X", "X", "X", "POSITION", False),
    ("POSITION_Y", "Y", "Y", "POSITION", False),
    ("POSITION_Z", "Z", "Z", "POSITION", False),
    ("POSITION_T", "T", "T", "TIME", False),
    ("FRAME", "Frame", "Frame", "NONE", True),
    ("RADIUS", "Radius", "R", "LENGTH", False),
    ("VISIBILITY", "Visibility", "Visibility", "NONE", True),
)
SHAPES = (  # of Spot2DMorphologyAnalyzer, and the column of ours
    ("AREA", "Area", "Area", "AREA", "area_px2", 2),
    ("PERIMETER", "Perimeter", "Perim.", "LENGTH", "perimeter_px", 1),
    ("CIRCULARITY", "Circularity", "Circ.", "NONE", "circularity", 0),
)
EDGE_FEATURES = (
    ("SPOT_SOURCE_ID", "Source spot ID", "Source ID", "NONE", True),
    ("SPOT_TARGET_ID", "Target spot ID", "Target ID", "NONE", True),
    ("LINK_COST", "Edge cost", "Cost", "COST", False),
)
TRACK_FEATURES = (
    ("TRACK_INDEX", "Track index", "Index", "NONE", True),
    ("TRACK_ID", "Track ID", "ID", "NONE", True),
    ("NUMBER_SPOTS", "Number of spots in track", "N spots", "NONE", True),
)


def write_trackmate_model(path: Path, table: Table) -> None:
    """The full model: spots, tracks, and how the image is calibrated."""
    units = table.units
    root = Element("TrackMate", version=VERSION)
    model = SubElement(
        root,
        "Model",
        spatialunits="pixel" if units.um_per_px is None else "micron",
        timeunits="frame" if units.fps is None else "sec",
    )
    shapes = [one for one in SHAPES if table.column(one[4]) is not None]
    declared = SubElement(model, "FeatureDeclarations")
    for kind, features in (
        ("SpotFeatures", (*SPOT_FEATURES, *((*one[:4], False) for one in shapes))),
        ("EdgeFeatures", EDGE_FEATURES),
        ("TrackFeatures", TRACK_FEATURES),
    ):
        parent = SubElement(declared, kind)
        for feature, name, short, dimension, whole in features:
            SubElement(
                parent,
                "Feature",
                feature=feature,
                name=name,
                shortname=short,
                dimension=dimension,
                isint=str(bool(whole)).lower(),
            )
    _add_spots(model, table)
    _add_tracks(model, table)
    width, height = table.size
    image = {
        **{"filename": "", "folder": "", "width": str(width), "height": str(height)},
        **{"nslices": "1", "nframes": str(table.n_frames), "voxeldepth": "1.0"},
        **dict.fromkeys(("pixelwidth", "pixelheight"), repr(units.um_per_px or 1.0)),
        "timeinterval": repr(1 / (units.fps or 1.0)),
    }
    _add_settings(SubElement(root, "Settings"), image, table)
    SubElement(root, "GUIState", state="ConfigureViews")
    write_xml(path, root)


def _add_settings(settings: Element, image: dict[str, str], table: Table) -> None:
    """As of tracks that were drawn by hand: TrackMate looks for all of these."""
    SubElement(settings, "ImageData", image)
    width, height = table.size
    ends = {"x": width - 1, "y": height - 1, "z": 0, "t": max(table.n_frames - 1, 0)}
    whole = {f"{axis}start": "0" for axis in ends}
    SubElement(
        settings, "BasicSettings", whole | {f"{axis}end": str(end) for axis, end in ends.items()}
    )
    SubElement(settings, "DetectorSettings", DETECTOR_NAME="MANUAL_DETECTOR", RADIUS="5.0")
    SubElement(settings, "InitialSpotFilter", feature="QUALITY", value="0.0", isabove="true")
    SubElement(settings, "SpotFilterCollection")
    SubElement(settings, "TrackerSettings", TRACKER_NAME="MANUAL_TRACKER")
    SubElement(settings, "TrackFilterCollection")
    analyzers = SubElement(settings, "AnalyzerCollection")
    for kind in ("Spot", "Edge", "Track"):
        SubElement(analyzers, f"{kind}Analyzers")


def _add_spots(model: Element, table: Table) -> None:
    rows, um, fps = table.rows, table.units.um_per_px or 1.0, table.units.fps or 1.0
    x, y = (rows.x - PIXEL_CENTRE) * um, (rows.y - PIXEL_CENTRE) * um
    radii = table.diameters() / 2 * um
    shapes = {
        name: column * um**power
        for name, *_, ours, power in SHAPES
        if (column := table.column(ours)) is not None
    }
    every = SubElement(model, "AllSpots", nspots=str(len(rows)))
    frames, starts = np.unique(rows.frame, return_index=True)
    for frame, some in zip(
        frames.tolist(), np.split(np.arange(len(rows)), starts[1:]), strict=True
    ):
        parent = SubElement(every, "SpotsInFrame", frame=str(frame))
        for i in some.tolist():
            values = {
                **{"ID": str(i), "name": f"ID{i}", "QUALITY": repr(float(rows.scores[i]))},
                **{"POSITION_X": repr(float(x[i])), "POSITION_Y": repr(float(y[i]))},
                **{"POSITION_Z": "0.0", "POSITION_T": repr(frame / fps), "FRAME": str(frame)},
                **{"RADIUS": repr(float(radii[i])), "VISIBILITY": "1"},
            }
            # NaN where there is none, as TrackMate writes it: what was declared is there
            values |= {
                name: repr(float(column[i])).replace("nan", "NaN")
                for name, column in shapes.items()
            }
            SubElement(parent, "Spot", values)


def _add_tracks(model: Element, table: Table) -> None:
    every, kept = SubElement(model, "AllTracks"), SubElement(model, "FilteredTracks")
    for index, (track_id, some) in enumerate(tracks(table.rows)):
        if len(some) < 2:
            continue  # a track of TrackMate has an edge
        one = {"name": f"Track_{track_id - 1}", "TRACK_ID": str(track_id - 1)}
        one |= {"TRACK_INDEX": str(index), "NUMBER_SPOTS": str(len(some))}
        track = SubElement(every, "Track", one)
        for source, target in zip(some[:-1].tolist(), some[1:].tolist(), strict=True):
            edge = {"SPOT_SOURCE_ID": str(source), "SPOT_TARGET_ID": str(target)}
            SubElement(track, "Edge", {**edge, "LINK_COST": "-1.0"})
        SubElement(kept, "TrackID", TRACK_ID=str(track_id - 1))


def write_trackmate_tracks(path: Path, table: Table) -> None:
    """The simple file, a list of places a track, in px or micrometres."""
    rows, units = table.rows, table.units
    um = units.um_per_px or 1.0
    found = tracks(rows)
    root = Element(
        "Tracks",
        nTracks=str(len(found)),
        spaceUnits="pixel" if units.um_per_px is None else "micron",
        frameInterval=repr(1 / (units.fps or 1.0)),
        timeUnits="frame" if units.fps is None else "sec",
    )
    for _, some in found:
        particle = SubElement(root, "particle", nSpots=str(len(some)))
        for i in some.tolist():
            x, y = ((value - PIXEL_CENTRE) * um for value in (rows.x[i], rows.y[i]))
            place = {"x": repr(float(x)), "y": repr(float(y)), "z": "0.0"}
            SubElement(particle, "detection", {"t": str(int(rows.frame[i])), **place})
    write_xml(path, root)


def read_trackmate_xml(path: Path, um_per_px: float | None) -> Table:
    """Either of the two files, also as TrackMate's user corrected it.

    A track that splits or merges becomes one for each piece between, with `parent_id` of the piece
    from which it came (the first, where several merged; 0: none). Spots in no track are left out,
    which is said. Raises DroptrackError where it is neither.
    """
    root = read_xml(path)
    if root.tag == "Tracks":
        return _read_simple(path, root, um_per_px)
    model = root.find("Model")
    if root.tag != "TrackMate" or model is None:
        raise DroptrackError(f"{path}: is no file of TrackMate's")
    version = root.attrib.get("version", "")
    if (first := version.partition(".")[0]).isdigit() and int(first) > NEWEST:
        raise DroptrackError(
            f"{path}: is of TrackMate {version}; files up to those of TrackMate {NEWEST} are read"
        )
    um = _px_of_model(path, root, model, um_per_px)
    spots = {int(number(path, one, "ID")): one for one in model.iter("Spot")}
    piece_of, parents = _pieces(path, model)
    unknown = set(piece_of) - set(spots)
    if unknown:
        raise DroptrackError(f"{path}: an edge leads to spot {min(unknown)}, which there is not")
    ids = sorted(piece_of)
    optional = [name for name in READ[3:] if all(name in spots[i].attrib for i in ids)]
    found = {
        name: np.array([number(path, spots[i], name) for i in ids], float)
        for name in (*READ[:3], *optional)
    }
    found["TRACK_ID"] = np.array([piece_of[i] for i in ids], float)
    left = len(spots) - len(ids)
    notes = [f"{left} spots in no track left out"] if left else []
    shapes = {one[0]: one[4:] for one in SHAPES}
    known = {*READ, *NEEDLESS, *shapes}
    if others := sorted({name for i in ids for name in spots[i].attrib} - known):
        notes.append(f"left out of spots: {', '.join(others)}")
    read = spots_table(path, found, um, notes)
    columns: dict[str, NDArray[Any]] = {}
    for name, (ours, power) in shapes.items():
        if any(name in spots[i].attrib for i in ids):
            values = [_number_or_nan(path, spots[i], name) for i in ids]
            columns[ours] = np.array(values)[_order(found)] / um**power
    if parents:
        of = [parents.get(i - 1, -1) + 1 for i in read.rows.track_id.tolist()]
        columns["parent_id"] = np.array(of, np.int64)
    rows = read.rows
    return table_of(
        path,
        frame=rows.frame,
        track_id=rows.track_id,
        boxes=rows.boxes,
        scores=rows.scores,
        columns=columns,
        about=read.about,
        notes=read.notes,
    )


def _order(found: Mapping[str, Floats]) -> Rows:
    """The order in which a table has rows with these features."""
    return np.lexsort((found["TRACK_ID"], found["FRAME"]))


def _number_or_nan(path: Path, spot: Element, name: str) -> float:
    """A feature of a spot, NaN where there is none or TrackMate says NaN."""
    known = spot.attrib.get(name, "NaN") != "NaN"
    return number(path, spot, name) if known else float("nan")


def _px_of_model(path: Path, root: Element, model: Element, um_per_px: float | None) -> float:
    """How many units of the model's lengths a pixel is."""
    unit = model.attrib.get("spatialunits", "pixel")
    image = root.find("Settings/ImageData")
    if um_per_px is None and image is not None and "pixelwidth" in image.attrib:
        um_per_px = number(path, image, "pixelwidth")
    return px_of_unit(path, unit, um_per_px)


def _pieces(path: Path, model: Element) -> tuple[dict[int, int], dict[int, int]]:
    """The piece, from 0, of each spot in a track, and of pieces the one from which they came.

    The kept tracks keep their numbers where they neither split nor merge.
    """
    kept = {one.attrib.get("TRACK_ID") for one in model.iterfind("FilteredTracks/TrackID")}
    piece_of: dict[int, int] = {}
    parents: dict[int, int] = {}
    every = [one for one in model.iterfind("AllTracks/Track") if one.attrib.get("TRACK_ID") in kept]
    numbers = [int(number(path, one, "TRACK_ID")) for one in every]
    free = max(numbers, default=-1) + 1
    for track, first in zip(every, numbers, strict=True):
        after: dict[int, list[int]] = {}
        before: dict[int, list[int]] = {}
        for edge in track.iter("Edge"):
            source, target = (int(number(path, edge, f"SPOT_{e}_ID")) for e in ("SOURCE", "TARGET"))
            after.setdefault(source, []).append(target)
            before.setdefault(target, []).append(source)
        starts = [
            spot
            for spot in sorted({*after, *before})
            if len(before.get(spot, [])) != 1 or len(after[before[spot][0]]) != 1
        ]
        piece = first
        for start in starts:
            spot: int | None = start
            while spot is not None:
                piece_of[spot] = piece
                following = after.get(spot, [])
                alone = len(following) == 1 and len(before[following[0]]) == 1
                spot = following[0] if alone else None
            free, piece = (free + 1, free)
        for start in starts:
            if start in before:
                parents[piece_of[start]] = piece_of[before[start][0]]
    return piece_of, parents


def _read_simple(path: Path, root: Element, um_per_px: float | None) -> Table:
    um = px_of_unit(path, root.attrib.get("spaceUnits", "pixel"), um_per_px)
    values = [
        [float(k), *(number(path, one, name) for name in ("t", "x", "y"))]
        for k, particle in enumerate(root.iter("particle"))
        for one in particle.iter("detection")
    ]
    columns: Floats = np.array(values, float).reshape(-1, 4)
    names = ("TRACK_ID", "FRAME", "POSITION_X", "POSITION_Y")
    return spots_table(path, dict(zip(names, columns.T, strict=True)), um, [])
