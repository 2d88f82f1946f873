"""Checks before a training starts, so that it does not fail hours later."""

import shutil
from pathlib import Path

from droptrack.data.darknet_dataset import DataSet, read_labels
from droptrack.errors import DroptrackError
from droptrack.network.darknet_cfg import INPUT_MULTIPLE, Cfg, convolutions, yolo_heads

# AlexeyAB's Darknet looks for the labels of such images elsewhere
MOVED_LABELS = (
    "/JPEGImages/",
    *(f"/images/{split}{year}/" for split in ("train", "val") for year in (2014, 2017)),
)
# the values of Darknet's options that mean what the PyTorch trainer does
ONLY_DARKNET = {
    "net": {
        **dict.fromkeys(("mosaic", "mixup", "cutmix", "blur", "gaussian_noise", "angle"), "0"),
        "policy": "steps",
    },
    "yolo": {
        "iou_loss": "mse",
        **dict.fromkeys(("scale_x_y", "obj_normalizer", "cls_normalizer", "iou_thresh"), "1"),
        **dict.fromkeys(("label_smooth_eps", "objectness_smooth", "focal_loss"), "0"),
    },
}
SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".tiff"}


def check_network(cfg: Cfg, data: DataSet) -> None:
    """Raises DroptrackError, with file, line and cure, for a cfg that cannot be trained on data."""
    net = cfg.net
    for head in yolo_heads(cfg):
        if head.classes != len(data.names):
            line = cfg.layers[head.layer].line
            raise DroptrackError(
                f"{cfg.path}:{line}: classes={head.classes}, but {data.path} has "
                f"{len(data.names)}; set classes={len(data.names)}, and filters="
                f"{(len(data.names) + 5) * len(head.mask)} in the [convolutional] before it"
            )
    batch, subdivisions = net.integer("batch", 1), net.integer("subdivisions", 1)
    if batch < 2:
        raise DroptrackError(f"{cfg.path}:{net.line}: batch={batch} trains nothing; set batch=64")
    if subdivisions < 1 or batch % subdivisions:
        raise DroptrackError(
            f"{cfg.path}:{net.line}: subdivisions={subdivisions} should divide batch={batch}"
        )
    if net.integer("letter_box", 0):
        raise DroptrackError(
            f"{cfg.path}:{net.line}: letter_box=1 trains on images with borders, but droptrack "
            "stretches images to the network's size; set letter_box=0"
        )
    if len(net.numbers("steps", ())) != len(net.numbers("scales", ())):
        raise DroptrackError(f"{cfg.path}:{net.line}: steps= and scales= should be equally many")
    if net.integer("max_batches", 0) < 1:
        raise DroptrackError(f"{cfg.path}:{net.line}: max_batches= should say how long to train")


def check_images(cfg: Cfg, data: DataSet) -> None:
    """Look at every image's file and labels; raises DroptrackError, with line and cure."""
    layer = next(layer for layer in cfg.layers if layer.kind == "yolo")
    max_boxes = layer.integer("max", 200)
    for listing in (data.train, data.valid):
        for image in listing:
            if not image.is_file() or not image.stat().st_size:
                raise DroptrackError(
                    f"{image}: no such image, or empty; make the data set again, or take it off "
                    f"the lists that {data.path} names"
                )
            labels = image.with_suffix(".txt")
            if not labels.is_file():
                raise DroptrackError(
                    f"{labels}: missing; each image needs its labels beside it, an image without "
                    "droplets an empty file"
                )
            class_ids, boxes = read_labels(image)
            if len(boxes) > max_boxes:
                raise DroptrackError(
                    f"{cfg.path}:{layer.line}: max={max_boxes}, but {labels} has {len(boxes)} "
                    f"boxes, the rest of which would not be learnt; set max={len(boxes)} or more"
                )
            unknown = (class_ids < 0) | (class_ids >= len(data.names))
            if unknown.any():
                row = int(unknown.argmax())
                raise DroptrackError(
                    f"{labels}:{_line(labels, row)}: has class {class_ids[row]}, but {data.path} "
                    f"has classes 0 to {len(data.names) - 1}"
                )
            if not (boxes > 0).all():
                row = int((boxes <= 0).any(axis=1).argmax())
                raise DroptrackError(
                    f"{labels}:{_line(labels, row)}: a box needs a centre, a width and a "
                    "height above 0; delete the line"
                )


def _line(labels: Path, row: int) -> int:
    """The line, from 1, of a row of labels, from 0: some lines may be blank."""
    lines = labels.read_text(encoding="utf-8-sig").splitlines()
    return [number for number, line in enumerate(lines, start=1) if line.strip()][row]


def check_for_torch(cfg: Cfg) -> None:
    """Raises DroptrackError for what Darknet's training can do and the PyTorch trainer cannot."""
    for layer in (cfg.net, *(layer for layer in cfg.layers if layer.kind == "yolo")):
        for key, known in ONLY_DARKNET["yolo" if layer.kind == "yolo" else "net"].items():
            text = layer.text(key, known)
            if text != known and _number(text) != _number(known):
                raise DroptrackError(
                    f"{cfg.path}:{layer.line}: {key}={text} is only for Darknet; "
                    f"set {key}={known}, or use --trainer darknet"
                )


def check_window(window: tuple[int, int] | None) -> None:
    """Raises DroptrackError for a window that is no input of a network."""
    if window and any(side < INPUT_MULTIPLE or side % INPUT_MULTIPLE for side in window):
        width, height = window
        raise DroptrackError(
            f"--window {width}x{height}: both should be multiples of {INPUT_MULTIPLE}"
        )


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def check_for_darknet(cfg: Cfg, data: DataSet, out: Path) -> None:
    """Raises DroptrackError for names that Darknet would misread and for too small a disk."""
    if "." in cfg.path.stem:
        raise DroptrackError(
            f"{cfg.path}: Darknet cuts names at the first dot; rename it without one"
        )
    if len(set(data.valid)) != len(data.valid):
        twice = next(image for image in data.valid if data.valid.count(image) > 1)
        raise DroptrackError(
            f"{data.path}: lists {twice} twice for validation, at which Darknet stops; delete one"
        )
    for image in {*data.train, *data.valid}:
        path = str(image.resolve())
        if any(part in path for part in MOVED_LABELS):
            raise DroptrackError(
                f"{image}: Darknet seeks the labels of such a path in labels/; rename the folder"
            )
        if image.suffix.lower() not in SUFFIXES or path != path.strip() or "\n" in path:
            raise DroptrackError(f"{image}: Darknet does not find the labels of such a name")
    iterations = cfg.net.integer("max_batches")
    snapshots = iterations // (1000 if iterations <= 10_000 else 10_000) + 5
    log_lines = 2 + 2 * cfg.net.integer("subdivisions", 1) * len(yolo_heads(cfg))
    wanted = snapshots * 4 * sum(c.n_values for c in convolutions(cfg))
    wanted += 170 * log_lines * iterations
    place = next(folder for folder in (out.resolve(), *out.resolve().parents) if folder.exists())
    if (free := shutil.disk_usage(place).free) < wanted:
        raise DroptrackError(
            f"{out}: has {free / 1e9:.1f} GB free, the training writes up to {wanted / 1e9:.1f} GB"
            "; make room or choose another --out"
        )
