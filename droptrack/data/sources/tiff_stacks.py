"""TIFF files with many images: plain ones, BigTIFF, ImageJ's hyperstacks, OME.

A frame is a time; where there are several planes (Z) as well, they follow one another at each time.
Pages are read when their frame is due.
"""

import logging
import math
import weakref
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import cv2
import numpy as np
import tifffile

from droptrack.data.files import reading
from droptrack.data.sources.image_files import MAX_PIXELS, decode_image
from droptrack.data.sources.opencv_names import opencv_name, without_log
from droptrack.data.sources.source import Image, ReadOptions, Source, spread
from droptrack.data.sources.tiff_pages import as_bgr, is_packed, unpack_page
from droptrack.errors import DroptrackError

MICROMETRES = {"um": 1.0, "µm": 1.0, "μm": 1.0, "micron": 1.0, "microns": 1.0, "\\u00B5m": 1.0}
MICROMETRES |= {"nm": 1e-3, "mm": 1e3, "cm": 1e4, "m": 1e6}
SECONDS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6, "min": 60.0}
SPACE = "YXS"  # axes of one image
OPENCV_DECODES = (1, 2, 3, 4, 5, 7, 8, 32773, 32946)  # compressions: fax, LZW, JPEG, Deflate
MAX_TAGS = 500  # of a page

logging.getLogger("tifffile").disabled = True  # what is wrong with a file is said by an error


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a file says of its units; 0 where it says nothing."""

    pixel_size_um: float = 0.0
    fps: float = 0.0
    bits: int = 0


class TiffStack:
    """One file, open: `n_frames` images, each read when it is asked for.

    Raises DroptrackError for what is no TIFF, and for pages of several sizes.
    """

    def __init__(self, path: Path, channel: int | None) -> None:
        self.path = path
        self.notes: list[str] = []
        check_pages(path)
        try:
            self._file = tifffile.TiffFile(path)
            weakref.finalize(self, self._file.close)
            self._series = self._file.series[0]
            self._axes, self._shape = self._series.axes, self._series.shape
            self.calibration = _calibration(self._file)
            self._pages = self._all_pages()
        except DroptrackError:
            raise
        except Exception as error:  # noqa: BLE001  tifffile raises all kinds for damaged files
            raise DroptrackError(f"{path}: cannot be read as TIFF: {_line(error)}") from None
        counts = [
            (axis, n) for axis, n in zip(self._axes, self._shape, strict=True) if axis not in SPACE
        ]
        self._outer = [n for _, n in counts]
        if len(self._pages) > math.prod(self._outer):  # one series after the other
            counts = [("T", len(self._pages))]
        self._order = _frame_order(counts, self._channel(dict(counts), channel))
        self._map = self._mapped()
        planes = dict(counts).get("Z", 1)
        if planes > 1 and len(self._order) > planes:
            self.notes.append(
                f"{path}: has {planes} planes (Z) at each time, which follow one another"
            )

    @property
    def n_frames(self) -> int:
        """Images in the stack."""
        return len(self._order)

    def read(self, number: int) -> Image | None:
        """An image, from 0; None if it cannot be decoded."""
        index = self._order[number]
        page: Any = self._file.pages[0]
        image: Image | None
        try:
            if self._map is not None:
                image = np.asarray(self._map[index])
            else:
                page = self._pages[index]
                image = self._page(page, index)
        except DroptrackError:
            raise
        except Exception:  # noqa: BLE001  its decoders do, too
            return None
        if image is None:
            return None
        try:  # pages after the first know only their key frame
            image = as_bgr(image, page.keyframe, self._axes)
        except (ValueError, IndexError, TypeError):  # a damaged colour map, for one
            return None
        return image if image.ndim in (2, 3) else None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _channel(self, counts: dict[str, int], channel: int | None) -> int:
        n = counts.get("C", 1)
        if channel is None and n > 1:
            self.notes.append(f"{self.path}: has {n} channels, of which 0 is read; see --channel")
        if channel is not None and n == 1:
            raise DroptrackError(f"{self.path}: has no channels; leave out --channel")
        if channel is not None and not 0 <= channel < n:
            raise DroptrackError(f"{self.path}: --channel {channel}: has channels 0 to {n - 1}")
        return channel or 0

    def _all_pages(self) -> Sequence[Any]:
        """Pages of the first series, and of others alike where nothing says what these are.

        Raises DroptrackError where pages are of several sizes; small copies do not count.
        """
        first = self._series.keyframe
        if first.imagewidth * first.imagelength > MAX_PIXELS:
            raise DroptrackError(
                f"{self.path}: {first.imagewidth} x {first.imagelength} px are too many"
            )
        others = [one for one in self._file.series[1:] if not one.keyframe.is_reduced]
        if not others:
            return self._series.pages
        if self._file.is_imagej or self._file.is_ome:
            n = len(others) + 1
            self.notes.append(f"{self.path}: has {n} series, of which the first is read")
            return self._series.pages
        for other in (one.keyframe for one in others):
            if (other.shape, other.dtype) != (first.shape, first.dtype):
                raise DroptrackError(
                    f"{self.path}: page {other.index + 1} is {other.imagewidth} x "
                    f"{other.imagelength} px of {other.dtype}, those before it {first.imagewidth} "
                    f"x {first.imagelength} of {first.dtype}; split the file there"
                )
        return [page for one in (self._series, *others) for page in one.pages]

    def _mapped(self) -> Any:
        """All images as one array in the file, which some writers describe by its first only."""
        offset, shape = self._series.dataoffset, self._shape
        if offset is None or len(self._order) == 1 or self._pages is not self._series.pages:
            return None
        inner = shape[len(self._outer) :]
        dtype = np.dtype(self._series.dtype).newbyteorder(self._file.byteorder)
        image_bytes = math.prod(inner) * dtype.itemsize
        there = max(0, (self.path.stat().st_size - offset) // image_bytes)  # of a cut file, less
        count = min(math.prod(self._outer), there)
        if not count:
            return None
        return np.memmap(self.path, dtype, "r", offset, (count, *inner))

    def _page(self, page: Any, index: int) -> Image | None:
        """A page's values; None if it cannot be decoded."""
        if page is None:
            return None
        try:
            return np.asarray(page.asarray())
        except Exception as error:
            if "imagecodecs" not in str(error) and not isinstance(error, ImportError):
                raise
        first = page.keyframe
        if is_packed(first):
            return unpack_page(page)
        # compressed otherwise than by numbers alone: OpenCV has the decoders
        if first.compression not in OPENCV_DECODES:
            raise DroptrackError(
                f"{self.path}: is compressed as {first.compression.name}: pip install imagecodecs"
            )
        with opencv_name(self.path) as name, without_log():
            ok, images = cv2.imreadmulti(name, index, 1, flags=cv2.IMREAD_UNCHANGED)
        image = np.asarray(images[0]) if ok else None
        return image[..., ::-1] if image is not None and image.ndim == 3 else image


def _frame_order(axes: Sequence[tuple[str, int]], channel: int) -> list[int]:
    """Which image of the file each frame is: all axes but C, times before planes."""
    shape = [n for _, n in axes]
    numbers = np.arange(math.prod(shape)).reshape(shape)
    names = [axis for axis, _ in axes]
    if "C" in names:
        numbers = np.take(numbers, channel, axis=names.index("C"))
        names.remove("C")
    order = sorted(range(len(names)), key=lambda i: (names[i] != "T", names[i] == "Z", i))
    return [int(number) for number in numbers.transpose(order).ravel()]


def open_stacks(files: Sequence[Path], options: ReadOptions) -> Source:
    """Files of images, one after the other, as one video. Raises DroptrackError."""
    stacks = [TiffStack(path, options.channel) for path in files]
    n_frames = sum(stack.n_frames for stack in stacks)
    places = [(stack, i) for stack in stacks for i in range(stack.n_frames)]
    calibration = stacks[0].calibration

    def samples() -> list[Image]:
        return [image for i in spread(n_frames) if (image := _read(places[i])) is not None]

    def images() -> Iterator[tuple[int, Image]]:
        for number, (stack, i) in enumerate(places):
            image = stack.read(i)
            if image is not None:
                yield number, image
            if i == stack.n_frames - 1:
                stack.close()

    return Source(
        images=images(),
        n_frames=n_frames,
        samples=samples,
        bits=calibration.bits,
        fps=calibration.fps,
        pixel_size_um=calibration.pixel_size_um,
        notes=tuple(dict.fromkeys(note for stack in stacks for note in stack.notes)),
    )


def _read(place: tuple[TiffStack, int]) -> Image | None:
    return place[0].read(place[1])


def check_pages(path: Path) -> None:
    """Raise DroptrackError where the chain of a file's pages leads back, or to what is none.

    tifffile goes through all that a damaged chain leads to, which may take for ever. TIFF 6.0, page
    13, and "The BigTIFF File Format": the number of tags, the tags, and where the next page is.
    """
    with reading(path, "TIFF"), path.open("rb") as file:
        head = file.read(16)
        order: Literal["little", "big"] = "little" if head[:2] == b"II" else "big"
        big = int.from_bytes(head[2:4], order) == 43
        count_bytes, tag_bytes, place_bytes = (8, 20, 8) if big else (2, 12, 4)
        place = int.from_bytes(head[8:16] if big else head[4:8], order)
        seen: set[int] = set()
        while place:
            file.seek(place)
            n_tags = int.from_bytes(file.read(count_bytes), order)
            if place in seen or n_tags > MAX_TAGS:
                raise DroptrackError(f"{path}: page {len(seen) + 1} is damaged")
            seen.add(place)
            file.seek(place + count_bytes + n_tags * tag_bytes)
            place = int.from_bytes(file.read(place_bytes), order)


def is_first_of_set(path: Path) -> bool:
    """Whether a file says which other files go on with its images, as OME's do."""
    try:
        check_pages(path)
        with tifffile.TiffFile(path) as file:
            return bool(file.is_ome and file.series[0].is_multifile)
    except Exception:  # noqa: BLE001  as above
        return False


def n_images(path: Path) -> int:
    """The number of images in a TIFF file; 0 where it is none."""
    try:
        stack = TiffStack(path, None)
    except DroptrackError:
        return 0
    stack.close()
    return stack.n_frames


def read_single(path: Path) -> Image | None:
    """The image of a file with one; None if it cannot be decoded.

    Raises DroptrackError where there are more.
    """
    try:
        stack = TiffStack(path, None)
    except DroptrackError:
        return decode_image(path)
    try:
        if stack.n_frames > 1:
            raise DroptrackError(f"{path}: has {stack.n_frames} images, the files before it one")
        return stack.read(0)
    finally:
        stack.close()


def _calibration(file: tifffile.TiffFile) -> Calibration:
    """What the file says of pixel size, frame interval and bits in use."""
    first: Any = file.pages[0]
    bits = first.bitspersample if first.bitspersample in (10, 12, 14) else 0
    tag = file.pages[0].tags.get("MaxSampleValue")  # type: ignore[union-attr]
    if tag is not None and isinstance(tag.value, int) and 255 < tag.value < 65535:
        bits = tag.value.bit_length()
    if file.is_ome and file.ome_metadata:
        return _ome_calibration(file.ome_metadata, bits)
    if file.is_imagej and file.imagej_metadata:
        return _imagej_calibration(file, file.imagej_metadata, bits)
    return Calibration(bits=bits)


def _ome_calibration(text: str, bits: int) -> Calibration:
    """Attributes of OME's first Pixels element."""
    with suppress(ElementTree.ParseError):
        for element in ElementTree.fromstring(text).iter():
            if element.tag.rpartition("}")[2] == "Pixels":
                got = element.attrib
                size = _number(got.get("PhysicalSizeX"))
                step = _number(got.get("TimeIncrement"))
                return Calibration(
                    pixel_size_um=size * MICROMETRES.get(got.get("PhysicalSizeXUnit", "µm"), 0.0),
                    fps=_inverse(step * SECONDS.get(got.get("TimeIncrementUnit", "s"), 0.0)),
                    bits=int(_number(got.get("SignificantBits"))) or bits,
                )
    return Calibration(bits=bits)


def _imagej_calibration(file: tifffile.TiffFile, about: dict[str, Any], bits: int) -> Calibration:
    """ImageJ's description: ``unit``, ``finterval`` or ``fps``; pixels a unit in XResolution."""
    resolution = file.pages[0].tags.get("XResolution")  # type: ignore[union-attr]
    per_unit = 0.0
    if resolution is not None:
        numerator, denominator = resolution.value
        per_unit = numerator / denominator if denominator else 0.0
    unit = MICROMETRES.get(str(about.get("unit", "")).strip(), 0.0)
    interval = _number(about.get("finterval"))
    return Calibration(
        pixel_size_um=_inverse(per_unit) * unit,
        fps=_inverse(interval) or _number(about.get("fps")),
        bits=bits,
    )


def _number(value: object) -> float:
    """A positive number, else 0."""
    try:
        number = float(str(value))
    except ValueError:
        return 0.0
    return number if math.isfinite(number) and number > 0 else 0.0


def _inverse(value: float) -> float:
    return 1 / value if value > 0 else 0.0


def _line(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
