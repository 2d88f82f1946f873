"""How much of an MPEG-4 or QuickTime file is shown: an edit list may leave out a part of it.

So do programs that cut a video without encoding it again. ISO/IEC 14496-12, sections 8.2.2
(mvhd), 8.4.2 (mdhd), 8.4.3 (hdlr) and 8.6.6 (elst).
"""

import struct
from collections.abc import Iterator
from pathlib import Path

MAX_MOOV = 2**28  # bytes
MAX_BOXES = 10_000
ROUNDED = 2  # units of time, often milliseconds, that an edit may lack
LONG = 1  # a box's size that says: it follows in 8 bytes


def shown_share(path: Path) -> float:
    """The share of its own duration for which a file's first video track is shown; 1 if unknown."""
    try:
        moov = _moov(path)
        timescale = _timescale_duration(dict(_boxes(moov))[b"mvhd"])[0]
        for kind, trak in _boxes(moov):
            if kind != b"trak":
                continue
            parts = dict(_boxes(trak))
            media = dict(_boxes(parts[b"mdia"]))
            if media[b"hdlr"][8:12] != b"vide":
                continue
            shown = _shown(dict(_boxes(parts[b"edts"]))[b"elst"])
            units, duration = _timescale_duration(media[b"mdhd"])
            whole = duration * timescale / units
            return shown / whole if 0 < shown < whole - ROUNDED else 1.0
    except (struct.error, KeyError, ZeroDivisionError):
        pass
    return 1.0


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
