"""Labels for training detectors: COCO's JSON, and Darknet's text files."""

import json
from pathlib import Path

import numpy as np

from droptrack.data.files import write_text
from droptrack.data.formats.table import Table
from droptrack.errors import DroptrackError


def image_name(frame: int) -> str:
    """The file's name, without suffix, of a frame."""
    return f"{frame:06d}"


def write_coco(path: Path, table: Table) -> None:
    """An image a frame, an annotation a row, a category a class; areas as measured, if they are."""
    rows = table.rows
    width, height = table.size
    frames = np.unique(rows.frame).tolist()
    images = [
        {"id": n + 1, "file_name": f"{image_name(n)}.png", "width": width, "height": height}
        for n in frames
    ]
    measured = table.column("area_px2")
    classes, names = table.classes()
    annotations = []
    for i, (cx, cy, w, h) in enumerate(rows.boxes.tolist()):
        area = w * h if measured is None or not np.isfinite(measured[i]) else float(measured[i])
        annotations.append(
            {
                **{
                    "id": i + 1,
                    "image_id": int(rows.frame[i]) + 1,
                    "category_id": int(classes[i]) + 1,
                },
                **{"bbox": [cx - w / 2, cy - h / 2, w, h], "area": area, "iscrowd": 0},
                **{"track_id": int(rows.track_id[i]), "score": float(rows.scores[i])},
            }
        )
    content = {
        "info": {"description": dict(table.about)},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": k + 1, "name": name} for k, name in sorted(names.items())],
    }
    write_text(path, json.dumps(content) + "\n")


def write_darknet(path: Path, table: Table) -> None:
    """A folder with ``000012.txt`` for each frame with rows: class, cx, cy, w, h.

    In shares of the image. Boxes end where the image does; what lies outside has no label. Raises
    DroptrackError where the image's size is not known.
    """
    if " px" not in table.about.get("video", ""):
        raise DroptrackError("Darknet's labels need the image's size; give --size WxH")
    width, height = table.size
    rows, size = table.rows, np.array([width, height])
    low = np.clip(rows.boxes[:, :2] - rows.boxes[:, 2:] / 2, 0, size)
    high = np.clip(rows.boxes[:, :2] + rows.boxes[:, 2:] / 2, 0, size)
    shares = np.hstack([(low + high) / 2 / size, (high - low) / size])
    classes, _ = table.classes()
    path.mkdir(parents=True, exist_ok=True)
    for frame in np.unique(rows.frame).tolist():
        some = (rows.frame == frame) & (high > low).all(axis=1)
        lines = [
            f"{k} " + " ".join(f"{value:.6f}" for value in row)
            for k, row in zip(classes[some].tolist(), shares[some].tolist(), strict=True)
        ]
        write_text(path / f"{image_name(frame)}.txt", "".join(line + "\n" for line in lines))
