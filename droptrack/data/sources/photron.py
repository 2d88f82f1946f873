"""Files of Photron cameras: pixels in ``.mraw``, what they are in ``.cih`` or ``.cihx`` beside it.

``.cih`` has lines ``Key : value``; ``.cihx`` has the same as XML. Grey, 8, 12 (packed) or 16 bits.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from droptrack.data.files import reading
from droptrack.data.sources.packed_bits import unpack_12
from droptrack.data.sources.source import (
    Image,
    ReadOptions,
    Source,
    random_access,
    refuse_channel,
)
from droptrack.errors import DroptrackError

MAX_SIDE = 65_536  # px
MAX_HEADER = 10_000_000  # bytes
# keys of .cih, and where .cihx has the same
PLACES = {
    "Record Rate(fps)": "recordInfo/recordRate",
    "Total Frame": "frameInfo/totalFrame",
    "Image Width": "imageDataInfo/resolution/width",
    "Image Height": "imageDataInfo/resolution/height",
    "Color Type": "imageDataInfo/colorInfo/type",
    "Color Bit": "imageDataInfo/colorInfo/bit",
    "EffectiveBit Depth": "imageDataInfo/effectiveBit/depth",
    "EffectiveBit Side": "imageDataInfo/effectiveBit/side",
    "File Format": "imageFileInfo/fileFormat",
}
CONVERT = "save it as TIFF of 16 bits with Photron FASTCAM Viewer (PFV)"


def open_mraw(path: Path, options: ReadOptions) -> Source:
    """A recording, by any of its files; raises DroptrackError for what it cannot be."""
    refuse_channel(str(path), options)
    header = _beside(path, (".cih", ".cihx"))
    pixels = _beside(path, (".mraw",))
    about = _read_header(header)
    width, height, n_frames, bits = (
        _whole(header, about, key)
        for key in ("Image Width", "Image Height", "Total Frame", "Color Bit")
    )
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and n_frames > 0):
        raise DroptrackError(f"{header}: claims {n_frames} images of {width} x {height} px")
    colour = about.get("Color Type", "Mono").lower() not in ("mono", "monochrome", "")
    if bits not in (8, 12, 16) or colour or about.get("File Format", "MRaw").lower() != "mraw":
        raise DroptrackError(
            f"{header}: {about.get('Color Type', 'Mono')}, {bits} bits, as "
            f"{about.get('File Format', 'MRaw')}, is not read here; {CONVERT}"
        )
    n_bytes = width * height * bits // 8
    with reading(pixels, ".mraw"):
        data = np.memmap(pixels, np.uint8, "r") if pixels.stat().st_size else np.zeros(0, np.uint8)

    def read(number: int) -> Image | None:
        raw = np.asarray(data[number * n_bytes : (number + 1) * n_bytes])
        if len(raw) < n_bytes:
            return None
        if bits == 12:
            return unpack_12(raw).reshape(height, width)
        return raw.view("<u2" if bits == 16 else np.uint8).reshape(height, width)

    depth = _whole(header, about, "EffectiveBit Depth", bits)
    higher = about.get("EffectiveBit Side", "Lower").lower() == "higher"  # of the 16 bits
    return random_access(
        read,
        Source(
            n_frames=min(n_frames, max(1, len(data))),
            bits=16 if higher and bits == 16 else depth if 8 < depth <= bits else 0,
            fps=_rate(about),
        ),
    )


def _beside(path: Path, suffixes: tuple[str, ...]) -> Path:
    """The file of that name with one of the suffixes, in any case of letters."""
    for suffix in suffixes:
        for one in (suffix, suffix.upper()):
            if (found := path.with_suffix(one)).is_file():
                return found
    raise DroptrackError(f"{path}: needs {path.stem}{' or '.join(suffixes)} beside it")


def _read_header(path: Path) -> dict[str, str]:
    with reading(path):
        if path.stat().st_size > MAX_HEADER:
            raise DroptrackError(f"{path}: {path.stat().st_size} bytes are too many")
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    if path.suffix.lower() == ".cih":
        pairs = (line.partition(" : ") for line in text.splitlines())
        return {key.strip(): value.strip() for key, colon, value in pairs if colon}
    start, end = text.find("<cih>"), text.rfind("</cih>")
    try:
        root = ElementTree.fromstring(text[start : end + len("</cih>")] if start >= 0 else text)
    except ElementTree.ParseError as error:
        raise DroptrackError(f"{path}: cannot be read as XML: {error}") from None
    return {key: value for key, place in PLACES.items() if (value := root.findtext(place))}


def _whole(path: Path, about: dict[str, str], key: str, default: int | None = None) -> int:
    if key not in about and default is not None:
        return default
    try:
        return int(about[key])
    except (KeyError, ValueError):
        has = f"has {about[key]!r}" if key in about else "is missing"
        raise DroptrackError(f"{path}: {key} {has}; it should be a number") from None


def _rate(about: dict[str, str]) -> float:
    try:
        return float(about.get("Record Rate(fps)", "0"))
    except ValueError:
        return 0.0
