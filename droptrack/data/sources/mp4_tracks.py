"""What an MPEG-4 or QuickTime file says of its video tracks, and OpenCV does not tell.

An edit list may leave out a part of what is there: so do programs that cut a video without encoding
it again. A matrix may mirror the frames, and there may be more tracks than the one that OpenCV
reads. ISO/IEC 14496-12, sections 8.2.2 (mvhd), 8.3.2 (tkhd), 8.4.2 (mdhd), 8.4.3 (hdlr), 8.6.6
(elst) and 8.7.3.2 (stsz).
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

MAX_MOOV = 2**28  # bytes
MAX_BOXES = 10_000
ROUNDED = 2  # units of time, often milliseconds, that an edit may lack
LONG = 1  # a box's size that says: it follows in 8 bytes


@dataclass(frozen=True)
class Tracks:
    """The video tracks of a file: how many, and of the first: what is shown of it, and how.

    shown_share: of its own duration, for which it is shown; is_mirrored: whether it is to be shown
    as in a mirror.
    """

    n: int = 1
    shown_share: float = 1.0
    is_mirrored: bool = False


def read_tracks(path: Path) -> Tracks:
    """The video tracks of a file, as far as it tells."""
    tracks: list[dict[bytes, bytes]] = []
    share, is_mirrored = 1.0, False
    try:
        moov = _moov(path)
        every = [_parts(trak) for kind, trak in _boxes(moov) if kind == b"trak"]
        tracks = [parts for parts in every if parts.get(b"hdlr", b"")[8:12] == b"vide"]
        tracks = [parts for parts in tracks if not _is_picture(parts)] or tracks
        timescale = _timescale_duration(dict(_boxes(moov))[b"mvhd"])[0]
        is_mirrored = _mirrors(tracks[0][b"tkhd"])
        share = _shown_share(tracks[0], timescale)
    except (struct.error, KeyError, IndexError, ZeroDivisionError):
        pass
    return Tracks(max(1, len(tracks)), share, is_mirrored)


def _parts(trak: bytes) -> dict[bytes, bytes]:
    """The boxes of a track, with those of its media and of its table of samples."""
    parts = dict(_boxes(trak))
    for kind in (b"mdia", b"minf", b"stbl"):
        parts |= dict(_boxes(parts.get(kind, b"")))
    return parts


def _is_picture(parts: dict[bytes, bytes]) -> bool:
    """Whether a track has one sample, as a title picture."""
    return parts.get(b"stsz", b"")[8:12] == b"\0\0\0\1"


def _shown_share(parts: dict[bytes, bytes], timescale: int) -> float:
    """The share of a track's duration that its edit list shows."""
    if b"edts" not in parts:
        return 1.0
    shown = _shown(dict(_boxes(parts[b"edts"]))[b"elst"])
    units, duration = _timescale_duration(parts[b"mdhd"])
    whole = duration * timescale / units
    return shown / whole if 0 < shown < whole - ROUNDED else 1.0


def _mirrors(tkhd: bytes) -> bool:
    """Whether a track's matrix turns right into left, or up into down, but not both."""
    a, b, _, c, d = struct.unpack_from(">5i", tkhd, 52 if tkhd[:1] == b"\1" else 40)
    return bool(a * d - b * c < 0)


def _moov(path: Path) -> bytes:
    """The box that describes the file; empty without one."""
    n_bytes, place = path.stat().st_size, 0
    with path.open("rb") as file:
        for _ in range(MAX_BOXES):
            file.seek(place)
            head = file.read(16)
            if len(head) < 8:
                break
            size, kind = int.from_bytes(head[:4], "big"), head[4:8]
            start = 8
            if size == LONG:
                size, start = int.from_bytes(head[8:], "big"), 16
            if kind == b"moov" and size <= min(MAX_MOOV, n_bytes):
                file.seek(place + start)
                return file.read(max(0, size - start))
            if size < start:
                break
            place += size
    return b""


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of the boxes in a box."""
    place = 0
    for _ in range(MAX_BOXES):
        if place + 8 > len(data):
            return
        size = int.from_bytes(data[place : place + 4], "big")
        if size < 8:
            return
        yield data[place + 4 : place + 8], data[place + 8 : place + size]
        place += size


def _timescale_duration(data: bytes) -> tuple[int, int]:
    """Units a second, and the duration in them, of mvhd and mdhd."""
    version = data[:1] == b"\1"
    timescale, duration = struct.unpack_from(
        ">IQ" if version else ">II", data, 20 if version else 12
    )
    return int(timescale), int(duration)


def _shown(data: bytes) -> int:
    """The length of all edits that show something, in the file's units."""
    n = struct.unpack_from(">I", data, 4)[0]
    entry = struct.Struct(">QqI" if data[:1] == b"\1" else ">IiI")
    edits = (entry.unpack_from(data, 8 + i * entry.size) for i in range(min(n, MAX_BOXES)))
    return sum(int(duration) for duration, start, _ in edits if start >= 0)
