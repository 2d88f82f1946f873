"""Whether the beginning of a video file is whole, where no later frame tells what was before it.

FFmpeg looks for the first thing that it understands, and counts from there. Matroska and WebM:
RFC 9559; transport streams and program streams: ISO/IEC 13818-1, sections 2.4.3 and 2.5.3.
"""

import mmap
import re
from collections.abc import Iterator
from pathlib import Path

# what the first bytes of files are, and where they stand
MPEG_4 = ((4, b"ftyp"), (4, b"moov"), (4, b"mdat"), (4, b"wide"), (4, b"free"), (4, b"skip"))
RIFF = ((0, b"RIFF"),)
MATROSKA = ((0, b"\x1a\x45\xdf\xa3"),)
PROGRAM = ((0, b"\0\0\1\xba"),)
ASF, FLV, OGG = ((0, b"0&\xb2u"),), ((0, b"FLV"),), ((0, b"OggS"),)
CONTAINERS = (*MPEG_4, *RIFF, *MATROSKA, *PROGRAM, *ASF, *FLV, *OGG)
SUFFIXES = {
    *(".avi", ".mp4", ".m4v", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".vob", ".ts", ".m2ts"),
    *(".mts", ".wmv", ".flv", ".ogv"),
}

LOOKED_AT = 2**17  # bytes of a stream of packets
PACKED = re.compile(rb"DivX\d+(b|Build)\d+p")
SYNC = 0x47  # first byte of a transport stream's packet
PACKETS = ((188, 0), (192, 4), (204, 0))  # their sizes, and where the first one begins
STARTS = b"\0\0\1"
SYSTEM = 0xBB  # kinds of a program stream's parts above it say their size
PACK = 0xBA
END = 0xB9

SEGMENT, CLUSTER = b"\x18\x53\x80\x67", b"\x1f\x43\xb6\x75"
PARTS = {  # of a segment, before its clusters
    *(b"\x11\x4d\x9b\x74", b"\x15\x49\xa9\x66", b"\x16\x54\xae\x6b", b"\x1c\x53\xbb\x6b"),
    *(b"\x19\x41\xa4\x69", b"\x10\x43\xa7\x70", b"\x12\x54\xc3\x67", b"\xec", b"\xbf"),
}
SIMPLE_BLOCK, BLOCK = b"\xa3", b"\xa0"
NUMBERS, MAX_NUMBER = (b"\xe7", b"\xab", b"\xa7", b"\xbf"), 8  # bytes
IN_CLUSTER = {*NUMBERS, b"\xec", b"\xaf", SIMPLE_BLOCK, BLOCK}
TRACKS, TRACK, TRACK_NUMBER, TRACK_TYPE = b"\x16\x54\xae\x6b", b"\xae", b"\xd7", b"\x83"
VIDEO = 1
N_ELEMENTS = 1000  # that are looked at

LOST = (
    "is damaged where it begins: frames may be missing there, so that later ones have too small a "
    "number; is there another copy of the file?"
)
CUT = (
    "has {there:.3g} of the {claimed:.3g} MB that it claims: it is cut off, or its recording broke "
    "off; what is there was read"
)


def begins_with(path: Path, marks: tuple[tuple[int, bytes], ...]) -> bool:
    """Whether one of the marks stands in its place of the first bytes."""
    with path.open("rb") as file:
        head = file.read(12)
    return any(head[place:].startswith(mark) for place, mark in marks)


def is_packed(path: Path) -> bool:
    """Whether two frames of MPEG-4 lie in one packet, as of DivX: their times are no help then."""
    with path.open("rb") as file:
        return PACKED.search(file.read(LOOKED_AT)) is not None


def doubt_of_beginning(path: Path) -> str:
    """Why the first frames of a file may be missing; empty where its beginning is whole.

    A Matroska file that is shorter than it claims is said, too.
    """
    if not path.stat().st_size:
        return ""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if _is_one(data, MATROSKA):
            return _matroska(data)
        if _is_one(data, PROGRAM):
            return LOST * (not _whole_program(data[:LOOKED_AT]))
        if _is_one(data, CONTAINERS) or path.suffix.lower() not in SUFFIXES:
            return ""
        return LOST * (not _whole_transport(data[:LOOKED_AT]))


def _is_one(data: mmap.mmap, marks: tuple[tuple[int, bytes], ...]) -> bool:
    return any(data[place : place + len(mark)] == mark for place, mark in marks)


def _whole_transport(data: bytes) -> bool:
    """Whether a transport stream's packets follow one another, and begin what they should."""
    for size, first in PACKETS:
        starts = range(first, len(data) - 188 + 1, size)
        if len(starts) > 1 and all(data[start] == SYNC for start in starts):
            return all(_begins_well(data[start : start + 188]) for start in starts)
    return False


def _begins_well(packet: bytes) -> bool:
    """Whether a packet that begins a frame or a table has its first bytes."""
    begins, has_payload = packet[1] & 0x40, packet[3] & 0x10
    payload = packet[5 + packet[4] if packet[3] & 0x20 else 4 :]
    if not (begins and has_payload) or packet[1:3] == b"\x1f\xff" or len(payload) < 4:
        return True
    is_table = payload[0] == 0 and (payload[1] != 0 or packet[1] & 0x1F == packet[2] == 0)
    return payload.startswith(STARTS) or is_table or payload[0] > 0


def _whole_program(data: bytes) -> bool:
    """Whether a program stream's parts follow one another."""
    place = 0
    while place + 14 <= len(data):
        if data[place : place + 3] != STARTS:
            return False
        kind = data[place + 3]
        if kind == END:
            return True
        if kind == PACK:
            mpeg_2 = data[place + 4] & 0xC0 == 0x40
            place += 14 + (data[place + 13] & 7) if mpeg_2 else 12
        elif kind >= SYSTEM:
            place += 6 + int.from_bytes(data[place + 4 : place + 6], "big")
        else:
            return False
    return True


def _matroska(data: mmap.mmap) -> str:
    """What is wrong before the first frame of the first cluster, or with the segment's size."""
    top = list(_elements(data, 0, len(data), 2))
    if len(top) < 2 or top[1][0] != SEGMENT:
        return LOST
    _, start, size = top[1]
    end = len(data) if size is None else start + size
    tracks: set[int] = set()
    for kind, first, length in _elements(data, start, min(end, len(data)), N_ELEMENTS):
        until = len(data) if length is None else min(len(data), first + length)
        if kind == CLUSTER:
            if not _has_first_frame(data, first, until, tracks):
                return LOST
            break
        if kind not in PARTS:
            return LOST
        if kind == TRACKS:
            tracks = _video_tracks(data, first, until)
    else:
        return LOST
    return CUT.format(there=len(data) / 1e6, claimed=end / 1e6) * (end > len(data))


def _video_tracks(data: mmap.mmap, start: int, end: int) -> set[int]:
    """The numbers of a file's video tracks."""
    found = set()
    for kind, first, size in _elements(data, start, end, N_ELEMENTS):
        if kind == TRACK and size is not None:
            parts = {
                part: int.from_bytes(data[at : at + (n or 0)], "big")
                for part, at, n in _elements(data, first, first + size, N_ELEMENTS)
            }
            if parts.get(TRACK_TYPE) == VIDEO:
                found.add(parts.get(TRACK_NUMBER, 0))
    return found


def _has_first_frame(data: mmap.mmap, start: int, end: int, tracks: set[int]) -> bool:
    """Whether a cluster is whole up to its first frame, or has none."""
    found = False
    place = start
    for kind, first, size in _elements(data, start, end, N_ELEMENTS):
        if kind not in IN_CLUSTER or size is None or (kind in NUMBERS and size > MAX_NUMBER):
            return kind == CLUSTER and found
        if found:  # what follows it shows that its size is right
            return True
        if kind in (SIMPLE_BLOCK, BLOCK):
            at = first
            if kind == BLOCK:  # a group, whose first part it is
                at = next(_elements(data, first, first + size, 1), (b"", first, None))[1]
            found = data[at] & 0x7F in tracks if at < len(data) else False
        place = first + size
    return place >= min(end, len(data))


def _elements(
    data: mmap.mmap, place: int, end: int, n: int
) -> Iterator[tuple[bytes, int, int | None]]:
    """Kinds, starts and sizes of up to n elements; the size is None where it is not said."""
    for _ in range(n):
        if place >= end:
            return
        n_kind = 9 - data[place].bit_length()
        at = place + n_kind
        if n_kind > 4 or at >= len(data) or not data[at]:
            yield b"", place, None
            return
        n_size = 9 - data[at].bit_length()
        size = int.from_bytes(data[at : at + n_size], "big") & (1 << 7 * n_size) - 1
        unknown = size == (1 << 7 * n_size) - 1
        yield data[place:at], at + n_size, None if unknown else size
        if unknown:
            return
        place = at + n_size + size
