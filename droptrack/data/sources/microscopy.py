"""Files of microscopes: Nikon's ``.nd2``, Zeiss' ``.czi``, Leica's ``.lif``, by the readers in the
extra ``[microscopy]``.
"""  # noqa: D205

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from droptrack.data.sources.other_formats import BIOFORMATS
from droptrack.data.sources.source import Image, ReadOptions, Source, random_access
from droptrack.errors import DroptrackError

MICROSCOPY_SUFFIXES = (".nd2", ".czi", ".lif")
# times that a file may be smaller than its images, and bytes of these that are no matter
MAX_SHRUNK, MIN_SHRUNK = 100, 10_000_000
# where ZEN writes metres a pixel, seconds a frame, and bits of a level
CZI_PLACES = (
    ".//Scaling/Items/Distance[@Id='X']/Value",
    ".//Image/Dimensions/T/Positions/Interval/Increment",
    ".//Image/ComponentBitCount",
)


def open_microscopy(path: Path, options: ReadOptions) -> Source:
    """A file of a microscope as a video; raises DroptrackError for what cannot be read."""
    suffix = path.suffix.lower()
    opener = {".nd2": _open_nd2, ".czi": _open_czi, ".lif": _open_lif}[suffix]
    try:
        return opener(path, options)
    except ImportError as error:
        raise DroptrackError(
            f"{path}: reading {suffix} needs {error.name}: pip install 'droptrack[microscopy]'"
        ) from None
    except DroptrackError:
        raise
    except Exception as error:  # noqa: BLE001  these readers raise all kinds for damaged files
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise DroptrackError(f"{path}: cannot be read as {suffix}: {reason}") from None


def _open_nd2(path: Path, options: ReadOptions) -> Source:
    import nd2

    file = nd2.ND2File(path)
    sizes = {axis: n for axis, n in file.sizes.items() if axis not in "YXS"}
    channels = sizes.pop("C", 1)
    channel = _channel(path, options, channels)
    n = prod(sizes.values())

    def read(number: int) -> Image | None:
        image = np.asarray(file.read_frame(number))
        return _plane(image, channel, channels)

    voxel = file.voxel_size()
    return random_access(
        read,
        Source(
            n_frames=n,
            bits=int(file.attributes.bitsPerComponentSignificant or 0),
            fps=_nd2_rate(file),
            pixel_size_um=float(voxel.x) if voxel.x and voxel.x != 1 else 0.0,
            notes=_notes(path, sizes, options, channels),
        ),
    )


def _nd2_rate(file: Any) -> float:
    for loop in file.experiment:
        period = getattr(getattr(loop, "parameters", None), "periodMs", None)
        if loop.type == "TimeLoop" and period:
            return float(1000 / period)
    return 0.0


def _open_czi(path: Path, options: ReadOptions) -> Source:
    import czifile

    with czifile.CziFile(path) as file:
        axes, shape = str(file.axes), tuple(file.shape)
        n_bytes = prod(shape) * np.dtype(file.dtype).itemsize
        if n_bytes > MAX_SHRUNK * path.stat().st_size + MIN_SHRUNK:
            raise DroptrackError(f"{path}: claims {n_bytes} bytes of images; is it damaged?")
        if "0" in axes:  # its name of samples; S are scenes
            axes = axes.replace("S", "P").replace("0", "S")
        source = _from_array(path, axes, shape, file.asarray, options)
        size, rate, bits = _czi_calibration(str(file.metadata() or ""))
    return replace(source, pixel_size_um=size, fps=rate, bits=bits)


def _czi_calibration(xml: str) -> tuple[float, float, int]:
    """Width of a pixel in um, frames a second, bits in use; 0 where the metadata do not say."""
    metres = step = bits = 0.0
    with suppress(ElementTree.ParseError, ValueError):
        root = ElementTree.fromstring(xml)
        metres, step, bits = (float(root.findtext(place) or 0) for place in CZI_PLACES)
    return 1e6 * metres, 1 / step if step > 0 else 0.0, int(bits) if bits > 8 else 0


def _open_lif(path: Path, options: ReadOptions) -> Source:
    import liffile

    file = liffile.LifFile(path)
    image = file.images[0]
    source = _from_array(path, "".join(image.dims), tuple(image.shape), image.asarray, options)
    if len(file.images) > 1:
        raise DroptrackError(
            f"{path}: holds {len(file.images)} images; save the one to be tracked: {BIOFORMATS}"
        )
    return source


def _from_array(
    path: Path,
    axes: str,
    shape: Sequence[int],
    load: Callable[[], Any],
    options: ReadOptions,
) -> Source:
    """A file that is read at once, as its axes say."""
    array = np.asarray(load())
    counts = {axis: n for axis, n in zip(axes, shape, strict=True) if axis not in "YXS"}
    channels = counts.get("C", 1)
    channel = _channel(path, options, channels)
    if "C" in axes:
        array = np.take(array, channel, axis=axes.index("C"))
        axes = axes.replace("C", "")
    order = sorted(
        range(len(axes)), key=lambda i: ("YXS".find(axes[i]), axes[i] != "T", axes[i] == "Z")
    )
    array = array.transpose(order)
    n_inner = sum(axis in "YXS" for axis in axes)
    frames = array.reshape(-1, *array.shape[array.ndim - n_inner :])
    counts.pop("C", None)
    return random_access(
        lambda number: _plane(frames[number], 0, 1),
        Source(n_frames=len(frames), notes=_notes(path, counts, options, channels)),
    )


def _plane(image: Image, channel: int, channels: int) -> Image:
    """One channel of an image, or its colours as BGR."""
    if channels > 1:
        return np.asarray(image[channel])
    if image.ndim == 3 and image.shape[2] == 1:
        return np.asarray(image[..., 0])
    return np.asarray(image[..., ::-1]) if image.ndim == 3 else image


def _channel(path: Path, options: ReadOptions, n: int) -> int:
    if options.channel is not None and n == 1:
        raise DroptrackError(f"{path}: has no channels; leave out --channel")
    if options.channel is not None and options.channel >= n:
        raise DroptrackError(f"{path}: --channel {options.channel}: has channels 0 to {n - 1}")
    return options.channel or 0


def _notes(
    path: Path, counts: Mapping[str, int], options: ReadOptions, channels: int
) -> tuple[str, ...]:
    notes = []
    if channels > 1 and options.channel is None:
        notes.append(f"{path}: has {channels} channels, of which 0 is read; see --channel")
    if counts.get("Z", 1) > 1 and prod(counts.values()) > counts["Z"]:
        notes.append(f"{path}: has {counts['Z']} planes (Z) at each time, which follow one another")
    others = [f"{n} {axis}" for axis, n in counts.items() if axis not in "TZ" and n > 1]
    if others:
        raise DroptrackError(
            f"{path}: holds several recordings ({', '.join(others)}); of one of them, {BIOFORMATS}"
        )
    return tuple(notes)
