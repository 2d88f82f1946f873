"""CVAT for video 1.1: boxes at key frames, which CVAT joins by straight lines."""

from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from droptrack.data.arrays import Bools, Floats, Rows
from droptrack.data.formats.table import Table, table_of, tracks
from droptrack.data.formats.xml_files import number, read_xml, write_xml
from droptrack.errors import DroptrackError

VERSION = "1.1"
LABEL = "droplet"
MAX_FRAMES = 10_000_000
TOLERANCE_PX = 0.25  # by which a side may be off between key frames
SIDES = ("xtl", "ytl", "xbr", "ybr")


def write_cvat(path: Path, table: Table) -> None:
    """A track a droplet, ``outside`` after its last frame and in its gaps; its class is the label.

    Of several classes, the one that it has most often.
    """
    root = Element("annotations")
    SubElement(root, "version").text = VERSION
    task = SubElement(SubElement(root, "meta"), "task")
    width, height = table.size
    for tag, text in (("size", table.n_frames), ("mode", "interpolation"), ("start_frame", 0)):
        SubElement(task, tag).text = str(text)
    SubElement(task, "stop_frame").text = str(max(table.n_frames - 1, 0))
    classes, names = table.classes()
    labels = SubElement(task, "labels")
    for _, name in sorted(names.items()):
        one = SubElement(labels, "label")
        SubElement(one, "name").text = name
        SubElement(one, "attributes")
    size = SubElement(task, "original_size")
    SubElement(size, "width").text = str(width)
    SubElement(size, "height").text = str(height)
    half = table.rows.boxes[:, 2:] / 2
    sides = np.hstack([table.rows.boxes[:, :2] - half, table.rows.boxes[:, :2] + half])
    for track_id, some in tracks(table.rows):
        label = names[int(np.bincount(classes[some]).argmax())]
        track = SubElement(root, "track", id=str(track_id), label=label, source="auto")
        _add_boxes(track, table, some, sides[some])
    write_xml(path, root)


def _add_boxes(track: Element, table: Table, some: Rows, sides: Floats) -> None:
    frames = table.rows.frame[some]
    bridged = ~table.rows.observed[some]
    starts = np.flatnonzero(np.diff(frames) > 1) + 1
    for piece in np.split(np.arange(len(some)), starts):
        kept = key_frames(frames[piece], sides[piece], bridged[piece])
        for k in piece[kept].tolist():
            _add_box(track, int(frames[k]), sides[k], occluded=bool(bridged[k]), outside=False)
        end = int(piece[-1])
        if frames[end] + 1 < table.n_frames:
            _add_box(track, int(frames[end]) + 1, sides[end], occluded=False, outside=True)


def _add_box(track: Element, frame: int, sides: Floats, *, occluded: bool, outside: bool) -> None:
    values = {name: f"{side:.3f}" for name, side in zip(SIDES, sides.tolist(), strict=True)}
    flags = {"outside": str(int(outside)), "occluded": str(int(occluded)), "keyframe": "1"}
    SubElement(track, "box", {"frame": str(frame), **flags, **values, "z_order": "0"})


def key_frames(frames: Rows, sides: Floats, bridged: Bools) -> Rows:
    """Which of the frames (M,) of sides (M, 4) straight lines between them need.

    By halving where a line is off the most (Douglas & Peucker 1973); and where `bridged` changes.
    """
    kept = {0, len(frames) - 1, *(np.flatnonzero(np.diff(bridged)) + 1).tolist()}
    ends = sorted(kept)
    waiting = list(pairwise(ends))
    while waiting:
        start, end = waiting.pop()
        if end - start < 2:
            continue
        share = (frames[start:end] - frames[start]) / (frames[end] - frames[start])
        line = sides[start] + share[:, None] * (sides[end] - sides[start])
        off = np.abs(sides[start:end] - line).max(axis=1)
        worst = start + int(off.argmax())
        if off.max() > TOLERANCE_PX:
            kept.add(worst)
            waiting += [(start, worst), (worst, end)]
    return np.array(sorted(kept), np.int64)


def read_cvat(path: Path) -> Table:
    """Tracks of boxes, with every frame between their key frames; ``occluded`` is not observed.

    Labels are classes where there is another one than LABEL.
    """
    root = read_xml(path)
    if root.tag != "annotations" or (root.find("track") is None and root.find("image") is not None):
        raise DroptrackError(f"{path}: should be CVAT for video, which has tracks")
    version = root.findtext("version") or VERSION
    if version.strip() not in {"1.0", VERSION}:
        raise DroptrackError(
            f"{path}: is CVAT for video {version.strip()}; up to {VERSION} is read"
        )
    stop = root.findtext("meta/task/stop_frame") or root.findtext("meta/task/size") or ""
    last = int(stop) if stop.strip().isdigit() else -1
    if root.findtext("meta/task/stop_frame") is None:
        last -= 1
    if last > MAX_FRAMES:
        raise DroptrackError(f"{path}: frames should be {MAX_FRAMES} or less, not {last}")
    found: list[list[float]] = []
    other = 0
    label_of: dict[int, str] = {}
    for k, track in enumerate(root.iter("track")):
        other += sum(one.tag not in {"box", "attribute"} for one in track)
        track_id = int(track.attrib["id"]) if track.attrib.get("id", "").isdigit() else k
        label_of[track_id] = track.attrib.get("label", LABEL)
        found += _rows(path, track, track_id, last)
    table = np.array(found, float).reshape(-1, 7)
    shift = min(0.0, table[:, 1].min(initial=1) - 1)  # CVAT's identities begin at 0
    sides = table[:, 2:6]
    boxes = np.hstack([(sides[:, :2] + sides[:, 2:]) / 2, sides[:, 2:] - sides[:, :2]])
    notes = [f"{other} shapes that are no boxes left out"] if other else []
    if next(root.iter("attribute"), None) is not None:
        notes.append("attributes left out")
    return table_of(
        path,
        frame=table[:, 0],
        track_id=table[:, 1] - shift,
        boxes=boxes,
        observed=table[:, 6] == 0,
        columns=_classes(root, [label_of[one] for one in table[:, 1].astype(int).tolist()]),
        notes=notes,
    )


def _classes(root: Element, labels: list[str]) -> dict[str, NDArray[Any]]:
    """The columns of classes of rows with these labels, in the order in which the task has them."""
    if {*labels} <= {LABEL}:
        return {}
    named = [one.findtext("name") or "" for one in root.iterfind("meta/task/labels/label")]
    order = {name: k for k, name in enumerate(dict.fromkeys([*named, *sorted({*labels})]))}
    ids = np.array([order[name] for name in labels], np.int64)
    return {"class_id": ids, "class_name": np.array(labels, np.str_)}


def _rows(path: Path, track: Element, track_id: int, last: int) -> list[list[float]]:
    """Rows [frame, id, sides, occluded] of a track, up to the frame `last` where it is known."""
    boxes = sorted(track.iter("box"), key=lambda box: number(path, box, "frame"))
    rows: list[list[float]] = []
    for k, box in enumerate(boxes):
        if box.attrib.get("outside") == "1":
            continue
        start, sides = int(number(path, box, "frame")), _sides(path, box)
        occluded = float(box.attrib.get("occluded") == "1")
        following = boxes[k + 1] if k + 1 < len(boxes) else None
        if not 0 <= start <= MAX_FRAMES:
            raise DroptrackError(f"{path}: frames should be 0 to {MAX_FRAMES}, not {start}")
        end = int(number(path, following, "frame")) if following is not None else last + 1
        then = sides if following is None else _sides(path, following)
        if following is not None and following.attrib.get("outside") == "1":
            then = sides  # CVAT holds a box until the frame in which it is outside
        for frame in range(start, max(end, start + 1)):
            share = (frame - start) / max(end - start, 1)
            rows.append([frame, track_id, *(sides + share * (then - sides)).tolist(), occluded])
    return rows


def _sides(path: Path, box: Element) -> Floats:
    return np.array([number(path, box, name) for name in SIDES])
