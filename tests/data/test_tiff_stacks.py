"""Stacks of images in TIFF files, as other programs write them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from droptrack.data.video import ReadOptions, Video
from droptrack.errors import DroptrackError

STACK = np.random.default_rng(0).integers(0, 256, (6, 20, 30)).astype(np.uint8)


def frames(path: Path, **options: object) -> np.ndarray:
    """All frames' grey levels; every number is there."""
    video = Video(str(path), ReadOptions(**options))  # type: ignore[arg-type]
    numbers, images = zip(*video.numbered(), strict=True)
    assert list(numbers) == list(range(video.info.n_frames))
    return np.array(images)[..., 0]


def write_with_pillow(path: Path, compression: str | None) -> None:
    first, *rest = (Image.fromarray(image) for image in STACK)
    first.save(path, save_all=True, append_images=rest, compression=compression)


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_deflate", "packbits"])
def test_all_pages_of_a_plain_file_are_frames(tmp_path: Path, compression: str | None) -> None:
    write_with_pillow(tmp_path / "v.tif", compression)
    np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)


def test_pages_written_by_opencv_are_frames(tmp_path: Path) -> None:
    """With LZW, in 12 bits."""
    pages = [image.astype(np.uint16) * 16 for image in STACK]
    assert cv2.imwritemulti(str(tmp_path / "v.tif"), pages)
    np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)


def test_big_tiff_is_read(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.btf", STACK, bigtiff=True, photometric="minisblack")
    np.testing.assert_array_equal(frames(tmp_path / "v.btf"), STACK)


def test_imagej_hyperstacks_have_times_channels_and_units(tmp_path: Path) -> None:
    """3 times, 2 channels; ImageJ's file has one page's description only, and pixels after it."""
    path = tmp_path / "v.tif"
    tifffile.imwrite(
        path,
        STACK.reshape(3, 2, 20, 30),
        imagej=True,
        resolution=(1 / 0.65, 1 / 0.65),
        metadata={"axes": "TCYX", "unit": "um", "finterval": 0.002},
    )
    np.testing.assert_array_equal(frames(path, channel=0), STACK[::2])
    np.testing.assert_array_equal(frames(path, channel=1), STACK[1::2])
    video = Video(str(path))
    assert "has 2 channels, of which 0 is read" in video.notes[0]
    assert video.info.fps == pytest.approx(500)
    assert video.pixel_size_um == pytest.approx(0.65, rel=1e-5)
    with pytest.raises(DroptrackError, match="has channels 0 to 1"):
        Video(str(path), ReadOptions(channel=2))


def test_times_come_before_planes_and_channels(tmp_path: Path) -> None:
    """OME stores channel, then time, then plane here."""
    path = tmp_path / "v.ome.tif"
    stack = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)  # C, T, Z
    images = np.broadcast_to(stack[..., None, None], (2, 3, 4, 5, 6))
    about = {
        "axes": "CTZYX",
        "PhysicalSizeX": 325.0,
        "PhysicalSizeXUnit": "nm",
        "TimeIncrement": 20.0,
        "TimeIncrementUnit": "ms",
    }
    tifffile.imwrite(path, images, ome=True, metadata=about, photometric="minisblack")
    levels = frames(path, channel=1)[:, 0, 0]
    np.testing.assert_array_equal(levels, stack[1].ravel())
    video = Video(str(path), ReadOptions(channel=1))
    assert "4 planes (Z) at each time" in video.notes[0]
    assert video.info.fps == pytest.approx(50)
    assert video.pixel_size_um == pytest.approx(0.325)


def test_planes_alone_are_times(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", STACK, imagej=True, metadata={"axes": "ZYX"})
    np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)


def test_a_folder_of_stacks_is_one_sequence(tmp_path: Path) -> None:
    for i in range(3):
        tifffile.imwrite(tmp_path / f"s_{i + 9}.tif", STACK[2 * i : 2 * i + 2])
    np.testing.assert_array_equal(frames(tmp_path), STACK)
    (tmp_path / "s_10.tif").unlink()
    with pytest.raises(DroptrackError, match="the first is 10: how many frames had it"):
        Video(str(tmp_path))


@pytest.mark.parametrize("colours", [3, 4])
@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_colours_are_bgr(tmp_path: Path, colours: int, planar: str) -> None:
    image = np.zeros((2, 8, 9, colours), np.uint8)
    image[:] = (30, 20, 10, 255)[:colours]
    data = image if planar == "contig" else np.moveaxis(image, -1, 1)
    extra = {"extrasamples": ["unassalpha"]} if colours == 4 else {}
    tifffile.imwrite(
        tmp_path / "v.tif", np.ascontiguousarray(data), photometric="rgb", planarconfig=planar,
        **extra,  # type: ignore[arg-type]
    )  # fmt: skip
    for frame in Video(str(tmp_path / "v.tif")):
        assert frame[0, 0].tolist() == [10, 20, 30]


def test_white_is_bright_where_zero_is_white(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", 255 - STACK, photometric="miniswhite")
    np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)


def test_pages_of_another_size_are_refused(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "v.tif") as file:
        for shape in ((20, 30), (20, 30), (20, 31)):
            file.write(np.zeros(shape, np.uint8), contiguous=False)
    with pytest.raises(DroptrackError, match="page 3 is 31 x 20 px of uint8, those before it 30 x"):
        Video(str(tmp_path / "v.tif"))


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
def test_a_cut_file_gives_whole_frames_or_is_refused(tmp_path: Path, share: float) -> None:
    for name, imagej in (("plain.tif", False), ("imagej.tif", True)):
        path = tmp_path / name
        tifffile.imwrite(path, STACK, imagej=imagej, photometric="minisblack")
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * share)])
        try:
            video = Video(str(path))
            for number, frame in video.numbered():
                np.testing.assert_array_equal(frame[..., 0], STACK[number])
        except DroptrackError as error:
            assert name in str(error)  # noqa: PT017


def test_what_is_no_tiff_is_refused(tmp_path: Path) -> None:
    for content in (b"", b"II*\0", b"II*\0\xff\xff\xff\xff", b"MM\0+" + b"\xff" * 60):
        (tmp_path / "v.tif").write_bytes(content)
        with pytest.raises(DroptrackError, match=r"v\.tif"):
            Video(str(tmp_path / "v.tif"))


def test_pages_are_read_when_they_are_due(tmp_path: Path) -> None:
    """A file larger than what may be allocated."""
    path = tmp_path / "v.tif"
    with tifffile.TiffWriter(path, bigtiff=True) as file:
        for t in range(20):
            file.write(np.full((300, 400), t, np.uint8), contiguous=False, compression="zlib")
    video = iter(Video(str(path)).numbered())
    assert [int(next(video)[1][5, 5, 0]) for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("bigtiff", [False, True])
@pytest.mark.parametrize("to", ["itself", "many tags"])
def test_a_chain_of_pages_that_leads_nowhere_is_refused(
    tmp_path: Path, bigtiff: bool, to: str
) -> None:
    """Found by random bytes: it took for ever."""
    path = tmp_path / "v.tif"
    tifffile.imwrite(path, STACK[0], bigtiff=bigtiff)
    data = bytearray(path.read_bytes())
    first = int.from_bytes(data[8:16] if bigtiff else data[4:8], "little")
    n_tags = int.from_bytes(data[first : first + (8 if bigtiff else 2)], "little")
    end = first + (8 + 20 * n_tags if bigtiff else 2 + 12 * n_tags)
    place = first if to == "itself" else len(data)
    data[end : end + (8 if bigtiff else 4)] = place.to_bytes(8 if bigtiff else 4, "little")
    data += (4000).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(DroptrackError, match="page 2 is damaged"):
        Video(str(path))
