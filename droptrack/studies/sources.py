"""What the arguments of a batch stand for: patterns, folders, lists, files and addresses."""

import glob
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from droptrack.data.sources.image_files import IMAGE_SUFFIXES, TIFF_SUFFIXES
from droptrack.data.sources.microscopy import MICROSCOPY_SUFFIXES
from droptrack.data.sources.opencv_names import printable
from droptrack.data.sources.tiff_stacks import n_images
from droptrack.errors import DroptrackError
from droptrack.pipeline.notes import Say
from droptrack.studies.addresses import is_address, matches
from droptrack.studies.jobs import identity
from droptrack.studies.lists import Entry, read_list
from droptrack.studies.options import VideoOptions

VIDEO_SUFFIXES = {
    *(".avi", ".mp4", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".wmv", ".webm", ".ts", ".mts"),
    *(".flv", ".ogv", ".cine", ".mraw", *MICROSCOPY_SUFFIXES, *TIFF_SUFFIXES),
}
LISTS = (".csv", ".tsv")
SIGNS = "*?["  # of patterns
MAX_NAMED = 3  # files in one line


def find_videos(sources: Iterable[str], options: VideoOptions, say: Say) -> list[Entry]:
    """The videos that sources stand for, in their order, each once.

    A pattern: the videos and folders of images that it matches (``**``: in all folders). A folder:
    those in it; of a folder of images, itself. ``.csv``: a list (`read_list`). Anything else is a
    video. `say` is told what is left out. Raises DroptrackError where a source has nothing.
    """
    entries: list[Entry] = []
    for source in sources:
        path = Path(source)
        if path.suffix.lower() in LISTS and path.is_file():
            listed = read_list(path, options)
            _say_of_columns(source, listed[0], say)
            entries += listed
        elif is_address(source):
            entries += [Entry(video=one, where=source) for one in _addresses(source)]
        elif path.exists() and not path.is_dir():
            entries.append(Entry(video=source, where=source))
        elif path.is_dir():
            inside = [str(one) for one in path.iterdir()]
            found = _videos_in(source, inside, say) if not _is_sequence(path, inside) else [source]
            entries += [Entry(video=one, where=source) for one in found]
            _refuse_none(source, found, "has no video and no folder of images")
        elif any(sign in source for sign in SIGNS):
            found = _videos_in(source, glob.iglob(source, recursive=True), say)  # noqa: PTH207
            entries += [Entry(video=one, where=source) for one in found]
            _refuse_none(source, found, "matches no video and no folder of images")
        else:
            raise DroptrackError(f"{source}: no such video, folder, pattern or list")
    return _each_once(entries, say)


def _say_of_columns(source: str, entry: Entry, say: Say) -> None:
    """Tell which columns of a list are no options: one of them may be a slip."""
    if entry.free:
        plural = "columns" if len(entry.free) > 1 else "column"
        say(f"{source}: {plural} of your own: {printable(', '.join(entry.free))}")


def _addresses(source: str) -> list[str]:
    if not any(sign in source for sign in SIGNS):
        return [source]
    found = [one for one in matches(source) if Path(one).suffix.lower() in VIDEO_SUFFIXES]
    _refuse_none(source, found, "matches no video")
    return sorted(found)


def _videos_in(source: str, paths: Iterable[str], say: Say) -> list[str]:
    """The videos, and folders of images, among paths; tells what else there is."""
    found, others = [], []
    names = sorted(paths)
    videos = VIDEO_SUFFIXES - (TIFF_SUFFIXES if _single_tiffs(names) else set())
    for name in names:
        path = Path(name)
        if path.name.startswith("."):
            continue
        if path.is_dir():
            if _has_images(path):
                found.append(name)
        elif path.suffix.lower() in videos:
            found.append(name)
        else:
            others.append(path.name)
    if others:
        more = f" and {len(others) - MAX_NAMED} more" if len(others) > MAX_NAMED else ""
        named = printable(", ".join(others[:MAX_NAMED]))
        say(f"{source}: left out, as no videos by their names: {named}{more}")
    return found


def _is_sequence(folder: Path, inside: Sequence[str]) -> bool:
    """Whether a folder is itself a video: it has images, and no videos."""
    if any(Path(one).suffix.lower() in VIDEO_SUFFIXES - TIFF_SUFFIXES for one in inside):
        return False
    tiffs = [one for one in inside if Path(one).suffix.lower() in TIFF_SUFFIXES]
    return _has_images(folder) and (not tiffs or _single_tiffs(tiffs))


def _has_images(folder: Path) -> bool:
    with os.scandir(folder) as files:
        return any(Path(file.name).suffix.lower() in IMAGE_SUFFIXES for file in files)


def _single_tiffs(names: Sequence[str]) -> bool:
    """Whether TIFF files are images of one sequence, not videos: the first has one image."""
    first = next((Path(one) for one in names if Path(one).suffix.lower() in TIFF_SUFFIXES), None)
    return first is not None and n_images(first) == 1


def _refuse_none(source: str, found: Sequence[str], why: str) -> None:
    if not found:
        raise DroptrackError(f"{source}: {why}")


def _each_once(entries: Sequence[Entry], say: Say) -> list[Entry]:
    """The videos without those named again; raises DroptrackError where lists contradict."""
    kept: dict[tuple[str, str], Entry] = {}
    again: dict[str, None] = {}
    for entry in entries:
        key = identity(entry.video), entry.name
        before = kept.setdefault(key, entry)
        if before is entry:
            continue
        if (before.options, before.free) != (entry.options, entry.free):
            raise DroptrackError(
                f"{entry.where}: {printable(entry.video)} was in {before.where} already, with "
                "other columns; give each a name of its own in a column 'name'"
            )
        again[before.video] = None
    if again:
        plural = "videos are each" if len(again) > 1 else "video is"
        more = ", ..." if len(again) > MAX_NAMED else ""
        named = printable(", ".join(list(again)[:MAX_NAMED]))
        say(f"{len(again)} {plural} named more than once, and done once: {named}{more}")
    return list(kept.values())
