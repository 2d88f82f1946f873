"""Where the frames of an AVI file lie, as its index says, or the chunks themselves.

FFmpeg looks for the next frame where one is damaged, and counts on as if none had been lost; by the
index, frames keep their numbers. Index and chunks say the same twice: what is damaged of one is
taken from the other. Microsoft, "AVI RIFF File Reference": idx1.
"""

import mmap
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ENTRY = np.dtype([("kind", "S4"), ("flags", "<u4"), ("start", "<u4"), ("size", "<u4")])
HEADER = 8  # bytes of a chunk's kind and size
MAX_CHUNKS = 1000  # before the index
FRAME = re.compile(rb"\d\dd[bc]")  # of a stream: compressed, or bytes of pixels
CHUNK = re.compile(rb"\d\d(d[bc]|wb|tx|pc)|JUNK|LIST|idx1|ix\d\d")
MIN_KNOWN = 0.5  # share of an index whose chunks are where it says, without which it is none
ONE_PART, MAX_HEAD = 2**29, 2**16  # bytes of files with one list of frames, of what is before it
TOTAL = HEADER + 16  # where the number of frames is in the chunk avih
MIN_USUAL = 0.02  # share of all chunks that is of a kind
N_AT_ONCE = 1000  # frames whose places are a list, which takes 136 bytes for each
N_CHUNKS = 20  # that are looked for among so many of the index
N_TRIED = 200  # entries that are looked up to find where the index counts from


@dataclass(frozen=True)
class AviFrames:
    """Start and size (N, 2) of the first stream's frames; `doubt`: why their numbers may be wrong.

    `n_odd`: frames whose chunks are damaged, which FFmpeg may leave out without a word. `whole`:
    False of a file that is cut off, whose head may claim more frames.
    """

    places: NDArray[np.int64]
    n_odd: int
    doubt: str = ""
    whole: bool = True


def avi_frames(path: Path) -> AviFrames | None:
    """The frames of an AVI file with one list of them; None of other files, and if none is found.

    A frame that is nowhere has the size 0.
    """
    n_bytes = path.stat().st_size
    if n_bytes < 12 + HEADER:
        return None
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[:4] != b"RIFF" or data[8:12] != b"AVI ":
            return None
        if _has_several_parts(data):
            return None
        movie, index = _find_index(data)
        found = None if index is None else _by_index(data, movie, index)
        return found or _by_chunks(data, movie)


def read_frames(path: Path, frames: AviFrames) -> Iterator[NDArray[np.uint8]]:
    """The frames as they are in the file."""
    with path.open("rb") as file:
        for row in range(0, len(frames.places), N_AT_ONCE):
            for start, size in frames.places[row : row + N_AT_ONCE].tolist():
                file.seek(start)
                yield np.frombuffer(file.read(size), np.uint8)


def _has_several_parts(data: mmap.mmap) -> bool:
    """Whether further lists of frames follow the first, as in files of more than a GB."""
    whole = _chunk(data, 0)[1] + HEADER
    if data[whole : whole + 4] == b"RIFF":
        return True
    return len(data) > max(whole + HEADER, ONE_PART) and data.find(b"odml", 0, MAX_HEAD) > 0


def _chunk(data: mmap.mmap, place: int) -> tuple[bytes, int]:
    """The kind and the size of a chunk."""
    return data[place : place + 4], int.from_bytes(data[place + 4 : place + HEADER], "little")


def _find_index(data: mmap.mmap) -> tuple[int, NDArray[np.void] | None]:
    """Where the list of frames begins, 0 if unknown, and the index."""
    place, movie, at = 12, 0, -1
    for _ in range(MAX_CHUNKS):
        kind, size = _chunk(data, place)
        if kind == b"LIST" and data[place + HEADER : place + HEADER + 4] == b"movi":
            movie = place + HEADER
        if kind == b"idx1":
            at = place
            break
        place += HEADER + size + size % 2
        if place >= len(data):
            break
    at = at if at >= 0 else data.rfind(b"idx1")
    movie = movie or max(0, data.find(b"movi"))
    if at < 0:
        return movie, None
    size = min(_chunk(data, at)[1], len(data) - at - HEADER)
    content = data[at + HEADER : at + HEADER + size // ENTRY.itemsize * ENTRY.itemsize]
    return movie, np.frombuffer(content, ENTRY) if content else None


def _by_index(data: mmap.mmap, movie: int, index: NDArray[np.void]) -> AviFrames | None:
    """The frames that an index has, those whose entries are damaged too."""
    kinds, starts, sizes = (index[name].tolist() for name in ("kind", "start", "size"))
    base = _base(data, movie, kinds, starts, sizes)
    video = _video_kind(kinds)
    if base is None or video is None:
        return None
    known = _usual(kinds)
    places: list[tuple[int, int]] = []
    n_odd, n_known, following = 0, 0, movie + 4
    for i, (kind, start, size) in enumerate(zip(kinds, starts, sizes, strict=True)):
        after = base + starts[i + 1] if i + 1 < len(starts) else 0
        place = base + start
        here = data[place : place + HEADER] == kind + size.to_bytes(4, "little")
        n_known += here
        if not here:
            kind, place, size = _resolved(data, known, (kind, place, size), following, after)  # noqa: PLW2901
        if kind == video or (kind == b"" and set(known) == {video}):
            places.append((place + HEADER, size))
            n_odd += not here
        following = place + HEADER + size + size % 2 if size else after or following
    if (
        n_known < MIN_KNOWN * len(index)
        or not places
        or FRAME.fullmatch(_chunk(data, following)[0])
    ):
        return None
    return AviFrames(np.array(places, np.int64), n_odd)


def _usual(kinds: list[bytes]) -> dict[bytes, int]:
    """The kinds of chunks that are no accident, and how many there are of each."""
    n_each = Counter(kind for kind in kinds if CHUNK.fullmatch(kind))
    usual = {kind: n for kind, n in n_each.items() if n > max(1, MIN_USUAL * len(kinds))}
    return usual or dict(n_each)


def _resolved(
    data: mmap.mmap,
    known: dict[bytes, int],
    entry: tuple[bytes, int, int],
    following: int,
    after: int,
) -> tuple[bytes, int, int]:
    """Kind, place and size of a chunk that its entry and itself do not agree on.

    That is right which ends where the next chunk begins: where `after` says, or one is there.
    Without one, the kind may be empty and the size 0.
    """
    chunk = _chunk(data, following)
    kinds = [one for one in (entry[0], chunk[0]) if one in known]
    kind = max(kinds, key=lambda one: known[one], default=b"")  # one bit makes 10dc of 00dc
    _, place, size = entry
    for one in (
        (kind, place, size),
        (kind, following, chunk[1]),
        (kind, place, chunk[1]),
        (kind, following, size),
    ):
        end = one[1] + HEADER + one[2] + one[2] % 2
        fits = 0 <= one[1] < end <= len(data)
        if fits and (end in (after, len(data)) or _is_chunk(data, end)):
            return one
    return kind, following, 0


def _video_kind(kinds: list[bytes]) -> bytes | None:
    """The kind of the first stream with frames; None without one."""
    return min((kind for kind in _usual(kinds) if FRAME.fullmatch(kind)), default=None)


def _base(
    data: mmap.mmap, movie: int, kinds: list[bytes], starts: list[int], sizes: list[int]
) -> int | None:
    """Where the index counts from: the list's kind, or the file; found where that is damaged."""
    heads = [kind + size.to_bytes(4, "little") for kind, size in zip(kinds, sizes, strict=True)]
    entries = [one for one in zip(starts, heads, strict=True) if CHUNK.fullmatch(one[1][:4])]
    tried = entries[:: max(1, len(entries) // N_TRIED)]

    def n_right(base: int) -> int:
        places = ((base + start, head) for start, head in tried)
        return sum(place >= 0 and data[place : place + HEADER] == head for place, head in places)

    best = max((movie, 0), key=n_right)
    if n_right(best) < MIN_KNOWN * len(tried):
        bases = {0}
        for found in islice(FRAME.finditer(data, 12), N_CHUNKS):
            head = data[found.start() : found.start() + HEADER]
            alike = (start for start, other in entries if other == head)
            bases.update(found.start() - start for start in islice(alike, N_CHUNKS))
        best = max(bases, key=n_right)
    return best if tried and n_right(best) >= MIN_KNOWN * len(tried) else None


def _by_chunks(data: mmap.mmap, movie: int) -> AviFrames | None:
    """The frames of a file without a good index, one after the other."""
    first = FRAME.search(data, movie)
    if first is None:
        return None
    place = movie + 4 if movie else first.start()
    chunks: list[tuple[bytes, int, int]] = []
    whole, list_end = False, movie + _chunk(data, movie - HEADER)[1] if movie else 0
    while place + HEADER <= len(data):
        kind, size = _chunk(data, place)
        if kind == b"idx1" or (chunks and place == list_end):
            whole = True
            break
        if kind == b"LIST" and data[place + HEADER : place + HEADER + 4] == b"rec ":
            place += HEADER + 4
            continue
        end = place + HEADER + size + size % 2
        if CHUNK.fullmatch(kind) and (end >= len(data) or _is_chunk(data, end)):
            following = end
        else:
            found = _next_chunk(data, place + 4)
            following = len(data) if found is None else found
            if CHUNK.fullmatch(kind) and end + HEADER <= following:  # the next one is damaged
                following = end
        chunks.append((kind, place + HEADER, min(size, following - place - HEADER)))
        place = following
    return _numbered(chunks, _claimed(data) if whole else 0)


def _numbered(chunks: list[tuple[bytes, int, int]], claimed: int) -> AviFrames | None:
    """The frames among chunks, of which some may be damaged, and hold any number of frames.

    `claimed`: how many there should be; 0 if that is unknown.
    """
    kinds = _usual([kind for kind, _, _ in chunks])
    video = min((kind for kind in kinds if FRAME.fullmatch(kind)), default=None)
    if video is None:
        return None
    frames: list[tuple[int, int]] = []
    gaps: list[int] = []
    for kind, start, size in chunks:
        if kind in kinds and kind != video:
            continue
        if kind != video:
            gaps.append(len(frames))
        frames.append((start, size))
    n_more = claimed - len(frames)
    alone = set(kinds) == {video} and claimed
    known = not gaps and n_more in (0, -len(frames))
    if alone and len(gaps) == 1 and -1 <= n_more <= chunks[-1][1] // HEADER:
        frames[gaps[0] : gaps[0] + 1] = [frames[gaps[0]], *[(0, 0)] * n_more][: n_more + 1]
        known = True
    known = known or bool(alone and n_more == 0)
    doubt = (
        f"its index is damaged, and its list of frames {max(1, len(gaps))} times: frames may be "
        "missing there without their numbers, so that those of later ones are wrong; "
        "is there another copy of the file?"
    )
    places = np.array(frames, np.int64)
    return AviFrames(places, len(gaps), "" if known else doubt, whole=bool(claimed))


def _claimed(data: mmap.mmap) -> int:
    """The number of frames that the file's head claims; 0 if it is damaged."""
    place = data.find(b"avih", 0, MAX_HEAD)
    return int.from_bytes(data[place + TOTAL : place + TOTAL + 4], "little") if place > 0 else 0


def _is_chunk(data: mmap.mmap, place: int) -> bool:
    kind, size = _chunk(data, place)
    return bool(CHUNK.fullmatch(kind)) and place + HEADER + size <= len(data)


def _next_chunk(data: mmap.mmap, place: int) -> int | None:
    """The next chunk after one that is damaged."""
    for found in CHUNK.finditer(data, place):
        if _is_chunk(data, found.start()):
            return found.start()
    return None
