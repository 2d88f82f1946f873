"""Stacks of images in TIFF files, as other programs write them."""

import struct
from importlib.util import find_spec
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


@pytest.mark.parametrize("tile", [None, (16, 16)])
@pytest.mark.parametrize("byteorder", ["<", ">"])
def test_compressed_pages_after_the_first_are_frames(
    tmp_path: Path, tile: tuple[int, int] | None, byteorder: str
) -> None:
    """Of these, tifffile has a description of the first page only."""
    tifffile.imwrite(
        tmp_path / "v.tif",
        STACK.astype(np.uint16) * 16,
        byteorder=byteorder,  # type: ignore[arg-type]
        compression="zlib",
        tile=tile,
        photometric="minisblack",
    )
    np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)


def write_packed(path: Path, image: np.ndarray, bits: int) -> None:
    """A page without unused bits between its levels, the highest first; TIFF 6.0, page 29."""
    rows = ["".join(f"{level:0{bits}b}" for level in row) for row in image.tolist()]
    text = "".join(row + "0" * (-len(row) % 8) for row in rows)
    data = int(text, 2).to_bytes(len(text) // 8, "big")
    height, width = image.shape
    tags = [(256, width), (257, height), (258, bits), (259, 1), (262, 1), (273, 8), (277, 1)]
    tags += [(278, height), (279, len(data))]
    head = b"II*\0" + struct.pack("<I", 8 + len(data)) + data + struct.pack("<H", len(tags))
    path.write_bytes(head + b"".join(struct.pack("<HHII", k, 4, 1, v) for k, v in tags) + bytes(4))


@pytest.mark.parametrize("bits", [2, 4, 6, 10, 12, 14])
def test_levels_without_bits_between_them_are_unpacked(tmp_path: Path, bits: int) -> None:
    image = np.random.default_rng(bits).integers(0, 2**bits, (5, 7))
    write_packed(tmp_path / "v.tif", image, bits)
    expected = image >> (bits - 8) if bits > 8 else image * 255 // (2**bits - 1)
    np.testing.assert_array_equal(frames(tmp_path / "v.tif")[0], expected)


@pytest.mark.parametrize("kind", ["int8", "int16", "int32", "uint32", "float16", "float64"])
def test_values_of_any_type_show_the_same(tmp_path: Path, kind: str) -> None:
    stack = STACK.astype(np.int64) - 128 if kind == "int8" else STACK.astype(np.int64)
    tifffile.imwrite(tmp_path / "v.tif", stack.astype(kind), photometric="minisblack")
    np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)


def test_inks_become_light_as_pillow_has_it(tmp_path: Path) -> None:
    inks = Image.fromarray(np.random.default_rng(1).integers(0, 256, (8, 9, 4)).astype(np.uint8))
    cmyk = Image.frombytes("CMYK", inks.size, inks.tobytes())
    cmyk.save(tmp_path / "v.tif")
    (frame,) = Video(str(tmp_path / "v.tif"))
    assert np.abs(frame[..., ::-1].astype(int) - np.asarray(cmyk.convert("RGB"))).max() <= 1


def test_colours_that_are_not_read_here_are_named(tmp_path: Path) -> None:
    lab = Image.frombytes("LAB", (4, 4), bytes(range(48)))
    lab.save(tmp_path / "v.tif")
    with pytest.raises(DroptrackError, match="its colours are CIELAB, which is not read here"):
        Video(str(tmp_path / "v.tif"))


def test_a_compression_that_needs_a_package_names_it(tmp_path: Path) -> None:
    if find_spec("imagecodecs") is not None:
        pytest.skip("imagecodecs reads it")
    try:
        write_with_pillow(tmp_path / "v.tif", "zstd")
    except OSError:
        pytest.skip("this Pillow writes none")
    try:
        np.testing.assert_array_equal(frames(tmp_path / "v.tif"), STACK)  # Python 3.14 has it
    except DroptrackError as error:
        assert "is compressed as ZSTD: pip install imagecodecs" in str(error)  # noqa: PT017


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
