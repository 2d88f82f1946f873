"""Folders of images: numbered sequences, whose missing numbers are missing frames."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

from droptrack.data.files import reading
from droptrack.data.sources.image_files import (
    IMAGE_SUFFIXES,
    NUMBERS,
    TIFF_SUFFIXES,
    decode_image,
    image_files,
)
from droptrack.data.sources.source import Image, ReadOptions, Source, refuse_channel, spread
from droptrack.data.sources.tiff_stacks import is_first_of_set, n_images, open_stacks, read_single
from droptrack.errors import DroptrackError

MAX_SPARSE = 1000  # numbers for each image, above which they are times rather than frames
VIDEOS = {".avi", ".mp4", ".mov", ".mkv", ".webm", ".mpg", ".wmv", ".m4v", ".cine", ".mraw"}
N_NAMED = 4  # sequences that a message names


@dataclass(frozen=True)
class NumberedImages:
    """Images in order, the number of each from 0, and what is to be said of them."""

    files: tuple[Path, ...]
    numbers: tuple[int, ...]
    notes: tuple[str, ...] = ()


def open_sequence(folder: Path, pattern: str, options: ReadOptions) -> Source:
    """The images of a folder whose names fit a pattern such as ``*``, as one video.

    Raises DroptrackError where there are none, or several sequences.
    """
    files = [path for path in image_files(folder) if fnmatch(path.name, pattern)]
    if not files:
        raise DroptrackError(_what_is_there(folder, pattern))
    if files[0].suffix.lower() in TIFF_SUFFIXES and n_images(files[0]) > 1:
        return open_stacks(_stacks(folder, files), options)
    refuse_channel(str(folder), options)
    found = number_images(folder, files, renumber=options.renumber)

    def samples() -> list[Image]:
        places = [found.files[i] for i in spread(len(found.files))]
        return [image for path in places if (image := read_image_file(path)) is not None]

    return Source(
        images=_images(folder, found),
        n_frames=found.numbers[-1] + 1,
        n_absent=found.numbers[-1] + 1 - len(found.files),
        samples=samples,
        notes=found.notes,
    )


def open_image(path: Path, options: ReadOptions) -> Source:
    """One image, as a video with one frame."""
    refuse_channel(str(path), options)
    image = read_image_file(path)
    return Source(images=iter([] if image is None else [(0, image)]), n_frames=1)


def number_images(folder: Path, files: Sequence[Path], *, renumber: bool) -> NumberedImages:
    """The frames that images are, as the numbers in their names say.

    Raises DroptrackError for images of several sequences, with their names.
    """
    in_order = NumberedImages(tuple(files), tuple(range(len(files))))
    patterns: dict[tuple[str, ...], list[Path]] = defaultdict(list)
    for path in files:
        patterns[tuple(NUMBERS.split(path.name.lower())[::2])].append(path)
    if len(patterns) == len(files):
        return in_order  # names that have nothing in common
    if len(patterns) > 1 and renumber:
        return in_order
    if len(patterns) > 1:
        raise DroptrackError(_several(folder, ["#".join(parts) for parts in patterns]))
    columns = list(zip(*(map(int, NUMBERS.split(p.name)[1::2]) for p in files), strict=True))
    if not any(len(set(column)) == len(files) for column in columns):
        if renumber:
            return in_order
        raise DroptrackError(_several(folder, _kinds(files, columns)))
    counting = [column for column in columns if all(a < b for a, b in pairwise(column))]
    numbers = min(counting, key=lambda column: column[-1] - column[0], default=(0, 10**15))
    if numbers[-1] - numbers[0] >= MAX_SPARSE * len(files):
        note = f"{folder}: the numbers in the names are no frames: images are counted one by one"
        return NumberedImages(in_order.files, in_order.numbers, () if renumber else (note,))
    frames = tuple(number - numbers[0] for number in numbers)
    n_missing = frames[-1] + 1 - len(files)
    if renumber or not n_missing:
        return in_order
    missing = next(i for i, frame in enumerate(frames) if frame != i) + numbers[0]
    note = (
        f"{folder}: {n_missing} of the numbers {numbers[0]} to {numbers[-1]} are missing, the "
        f"first is {missing}: these frames are missing in the video; --renumber counts the images"
    )
    return NumberedImages(in_order.files, frames, (note,))


def _stacks(folder: Path, files: Sequence[Path]) -> Sequence[Path]:
    """Files of many images in order; only the first of those that know of one another."""
    if is_first_of_set(files[0]):
        return files[:1]
    found = number_images(folder, files, renumber=False)
    if found.notes:
        raise DroptrackError(f"{found.notes[0].partition(': these')[0]}: how many frames had it?")
    return found.files


def _images(folder: Path, found: NumberedImages) -> Iterator[tuple[int, Image]]:
    size = None
    for number, path in zip(found.numbers, found.files, strict=True):
        image = read_image_file(path)
        if image is None:
            continue
        size = size or image.shape[:2]
        if image.shape[:2] != size:
            raise DroptrackError(
                f"{folder}: frame {number} is {image.shape[1]} x {image.shape[0]} px, those before "
                f"it {size[1]} x {size[0]}; it is {path.name}"
            )
        yield number, image


def read_image_file(path: Path) -> Image | None:
    """A file with one image, as it is stored, upright; None if it cannot be decoded.

    Raises DroptrackError where the file cannot be read, or holds several.
    """
    with reading(path, "an image"):
        return read_single(path) if path.suffix.lower() in TIFF_SUFFIXES else decode_image(path)


def _kinds(files: Sequence[Path], columns: Sequence[tuple[int, ...]]) -> list[str]:
    """Names of the sequences of images that differ in several numbers; the last one counts."""
    kinds = {}
    for path, numbers in zip(files, zip(*columns, strict=True), strict=True):
        parts = NUMBERS.split(path.name)
        parts[2 * len(numbers) - 1] = "#"
        kinds["".join(parts)] = path
    return list(kinds)


def _several(folder: Path, names: Sequence[str]) -> str:
    shown = ", ".join(names[:N_NAMED]) + (", ..." if len(names) > N_NAMED else "")
    if len(names) == 1:
        return f"{folder}: several of its images {shown} have one number; is a file there twice?"
    example = names[0].replace("#", "*")
    return (
        f"{folder}: has several sequences of images: {shown} (#: a number); name one of them, "
        f"as in '{folder / example}', or put each into a folder of its own; --renumber takes all"
    )


def _what_is_there(folder: Path, pattern: str) -> str:
    """Why a folder has no images."""
    names = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    if not names:
        return f"{folder}: has no frame: the folder is empty"
    if pattern != "*":
        hint = ""
        if not pattern.lower().endswith(tuple(IMAGE_SUFFIXES)):
            hint = "; of several videos: droptrack batch"
        return f"{folder}: has no image whose name is {pattern}{hint}"
    if any(Path(name).suffix.lower() in VIDEOS for name in names):
        return f"{folder}: has no image, but videos: name one of them, or all to droptrack batch"
    kinds = sorted({Path(name).suffix.lower() or "no suffix" for name in names})[:N_NAMED]
    return (
        f"{folder}: has no frame: no image ({' '.join(sorted(IMAGE_SUFFIXES))}), only "
        f"{len(names)} other entries ({' '.join(kinds)})"
    )
