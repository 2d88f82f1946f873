"""Names of the videos' folders: short, lasting, and each of one video only."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import PurePath

from droptrack.errors import DroptrackError
from droptrack.pipeline.results_folder import results_name
from droptrack.studies.jobs import identity
from droptrack.studies.lists import Entry

RESERVED = ("trajectories",)  # folders of the study itself
PLAIN = re.compile(r"[^\x00-\x1f/\\:*?\"<>|.][^\x00-\x1f/\\:*?\"<>|]{0,120}")


def name_videos(entries: Sequence[Entry], before: Mapping[str, str]) -> list[str]:
    """A name for each video, in their order: that of the file where it is the only one.

    Of files of one name, those of their folders come before it (``monday_a``, ``tuesday_a``). A
    video keeps the name it had `before` (names by the videos' `identity`). Systems that take ``A``
    for ``a`` are thought of. Raises DroptrackError for names in a list that cannot be.
    """
    names: dict[int, str] = {}
    _take_given(entries, names)
    given = {name.casefold() for name in names.values()}
    taken = {*given, *RESERVED, *(name.casefold() for name in before.values())}
    for k, entry in enumerate(entries):
        name = before.get(identity(entry.video), "")
        if k not in names and name and name.casefold() not in given:
            names[k] = name
            given.add(name.casefold())
    left = {k: _candidates(entry.video) for k, entry in enumerate(entries) if k not in names}
    tried = {k: next(candidates) for k, candidates in left.items()}
    while tried:
        wanted = [name.casefold() for name in tried.values()]
        for k, name in list(tried.items()):
            if name.casefold() not in taken and wanted.count(name.casefold()) == 1:
                names[k] = tried.pop(k)
        taken |= {name.casefold() for name in names.values()}
        tried = {k: next(left[k]) for k in tried}
    return [names[k] for k in range(len(entries))]


def _take_given(entries: Sequence[Entry], names: dict[int, str]) -> None:
    """Take the names that lists give."""
    where: dict[str, str] = {}
    for k, entry in enumerate(entries):
        if not entry.name:
            continue
        folded = entry.name.casefold()
        if not PLAIN.fullmatch(entry.name) or folded in RESERVED:
            raise DroptrackError(f"{entry.where}: name {entry.name!r}: is no name for a folder")
        if folded in where:
            raise DroptrackError(
                f"{entry.where}: name {entry.name!r}: {where[folded]} has it already"
            )
        where[folded] = entry.where
        names[k] = entry.name


def _candidates(video: str) -> Iterator[str]:
    """Names from the shortest on: a, a_avi, folder_a, folder_a_avi, ... a_2, a_3."""
    base = results_name(video)
    path = PurePath(identity(video).partition("://")[2] or identity(video))
    if "://" in video:
        base = path.stem
    suffix = f"_{path.suffix[1:]}" if path.suffix and base != path.name else ""
    for depth in range(4):
        parents = [part for part in path.parts[:-1] if PLAIN.fullmatch(part)]
        start = "_".join([*parents[len(parents) - depth :], ""]) if depth else ""
        yield f"{start}{base}"
        if suffix:
            yield f"{start}{base}{suffix}"
    for number in count(2):
        yield f"{base}_{number}"
